"""What can be chosen about a fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from enum import StrEnum
from functools import lru_cache
from typing import Any

from greybox.base.errors import ModelError
from greybox.data.experiment import Experiment
from greybox.data.noise.noise_model import NoiseModel
from greybox.estimation.policy import DEFAULT_POLICY, EstimationPolicy
from greybox.estimation.result_parts import to_json_data
from greybox.estimation.transcription.options import SolverOptions
from greybox.estimation.transcription.problem import EstimationProblem, prepare_problem
from greybox.estimation.transcription.simulation_error import RobustLoss, parse_loss
from greybox.model.model import Model


class ColourTreatment(StrEnum):
    """Which coloured noise a fit is whitened with."""

    KNOWN = "known"
    RESIDUAL = "residual"
    WHITE = "white"


@dataclass(frozen=True)
class FitOptions(SolverOptions):
    """Choices of a fit, kept with its result.

    Parameters
    ----------
    at_rest
        Every record starts at the states the model declares, instead of estimated ones (but for states with `State.free_start`).
    method
        Discretisation: ``automatic``, ``exact``, ``rk4``, ``midpoint``, ``radau`` ...
    substeps
        Substeps of a sample, 0 to choose.
    progressive
        Fit a growing part of the record first, so that a start far off does not lock onto a wrong oscillation.
    iterations
        Iterations at most in each stage. As a rule the search ends earlier, when a further step would change nothing that matters.
    tolerance
        Tolerance of IPOPT.
    thorough
        Where the cost has a kink (dry friction) and its gradient misleads, search on without it; that takes many passes.
    transcription
        ``single`` shooting runs the model freely from each record's initial state. ``multiple`` shooting runs it in segments that meet
        at the optimum, for unstable plants. ``collocation-radau`` and ``collocation-legendre`` solve the equations at points of each
        interval together with the fit: for smooth equations, with the states' bounds as path constraints. ``arcs`` have an initial
        state each and need not meet: short ones show the structure of the fast motion, long ones what drifts. ``automatic`` chooses by
        the model and by the record's length (arcs where ``arc_length`` is given); the result states what, and why.
    arc_length
        Length of the arcs in seconds, 0 for none.
    hessian
        Curvature that collocation uses: ``gauss-newton`` or ``exact``.
    loss
        ``squares``, or a robust one that outliers cannot pull: ``huber`` or ``student``, with a threshold if need be (``huber:2`` noise
        standard deviations, ``student:3`` degrees of freedom), see `greybox.transcription.loss.Loss`.
    per_experiment
        Parameters of which each experiment has a value of its own.
    common_noise
        Outputs whose noise nothing tells have one level in common, which the residual of all of them says: they are weighed alike, as
        a plain sum of squares does. They must have one unit.
    other_starts
        How many other starts are searched where the fit from the model's own explains nothing; 0 for none.
    policy
        The numbers that steer decisions, see `greybox.estimation.policy.EstimationPolicy`.

    Raises
    ------
    ModelError
        For a choice that does not exist, or one that contradicts another.

    Examples
    --------
    >>> FitOptions(at_rest=True, loss="huber").transcription
    'automatic'
    """

    policy: EstimationPolicy = DEFAULT_POLICY
    at_rest: bool = False
    loss: str = "squares"
    per_experiment: tuple[str, ...] = ()
    common_noise: bool = False
    other_starts: int = 6

    def __post_init__(self) -> None:
        object.__setattr__(
            self,
            "per_experiment",
            (self.per_experiment,) if isinstance(self.per_experiment, str) else tuple(self.per_experiment),
        )
        self.to_loss()
        if self.other_starts < 0:
            raise ModelError(
                f"other_starts {self.other_starts}: give how many other starts are searched, or 0 for none"
            )
        super().__post_init__()

    @classmethod
    def from_data(cls, data: Mapping[str, Any]) -> FitOptions:
        """The options that a result has stored (`Fit.provenance`); what an older result lacks is the default."""
        known = {name: data[name] for name in cls.__dataclass_fields__ if name in data and name != "policy"}
        return cls(**known, policy=EstimationPolicy.from_data(data.get("policy", {})))

    def to_data(self) -> dict[str, Any]:
        """The options as plain values, for a result to store."""
        choices = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "policy"}
        return {**to_json_data(choices), "policy": _to_policy_data(self.policy)}

    @property
    def robust(self) -> bool:
        """Whether the loss is a robust one."""
        return self.to_loss() is not None

    def to_loss(self) -> RobustLoss | None:
        """The robust loss; None for least squares. Raises ModelError for text that names none."""
        return parse_loss(self.loss, self.policy.transcription.robust_loss)


@lru_cache(maxsize=8)
def _to_policy_data(policy: EstimationPolicy) -> dict[str, Any]:
    """A policy as plain values; nearly every fit has the same."""
    return dict(to_json_data(policy))


def resolve_options(options: Any) -> FitOptions:
    """``options``, or the usual ones for None. Raises ModelError for anything that is not `FitOptions`."""
    if options is None:
        return FitOptions()
    if not isinstance(options, FitOptions):
        shown = ", ".join(f"{k}={v!r}" for k, v in options.items()) if isinstance(options, dict) else "at_rest=True"
        raise ModelError(f"options: {options!r} is not a FitOptions; write options=FitOptions({shown})")
    return options


def prepare_estimation(
    model: Model,
    experiments: Experiment | Sequence[Experiment],
    noise: Mapping[str, float] | NoiseModel | None,
    options: FitOptions,
    *,
    quiet: Experiment | Sequence[Experiment] = (),
    initial: Sequence[Mapping[str, float]] = (),
) -> EstimationProblem:
    """`prepare_problem` as ``options`` say."""
    return prepare_problem(
        model,
        experiments,
        noise,
        at_rest=options.at_rest,
        method=options.method,
        substeps=options.substeps,
        quiet=quiet,
        per_experiment=options.per_experiment,
        robust=options.robust,
        common_noise=options.common_noise,
        initial=initial,
        policy=options.policy,
    )
