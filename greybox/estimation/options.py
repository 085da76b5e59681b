"""What can be chosen about a fit: options, what a large residual costs, and the numbers that steer decisions.

A decision number changes by ``replace``: ``FitOptions(policy=EstimationPolicy(noise_rounds=3))``. The result keeps it with the options.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from enum import StrEnum
from functools import wraps
from inspect import signature
from typing import Any, ClassVar, ParamSpec, TypeVar

import numpy as np

from greybox.base import ModelError, nearest, to_json_data
from greybox.base.numerics import NORMAL_QUADRATURE_POINTS, NORMAL_QUADRATURE_WIDTH
from greybox.data.noise.noise_model import NoisePolicy
from greybox.data.read import read_csv
from greybox.estimation.optim.minimisation import MinimisationPolicy
from greybox.simulation.integrators.discretisation import DiscretisationPolicy

# What a large residual costs: least squares, or a robust loss that outliers cannot pull (Huber 1964; Student's t).


class LossKind(StrEnum):
    """What a residual costs."""

    SQUARES = "squares"
    HUBER = "huber"
    STUDENT = "student"


# A residual that counts less than this share of its least-squares weight is an outlier.
OUTLIER_WEIGHT = 0.35
# The mean curvature of a loss does not fall below this, however many residuals are outliers.
LEAST_CURVATURE = 0.05


@dataclass(frozen=True)
class RobustLoss:
    """``cost = sum s^2 rho(r / s)`` of the residuals ``r`` in units of their noise, ``s`` (ny,) being their ``scale`` in that unit.

    ``huber`` with threshold ``k``: ``rho(t) = t^2`` up to ``k`` and ``2 k |t| - k^2`` beyond, where a residual pulls no more than one of
    ``k``. ``student`` with ``k`` degrees of freedom: ``rho(t) = (k + 1) log(1 + t^2 / k)``, the likelihood of Student's distribution,
    where a residual far out pulls less and less. For small residuals both are least squares (but for a factor).
    """

    kind: str
    threshold: float
    scale: np.ndarray = field(default_factory=lambda: np.ones(1))

    def __str__(self) -> str:
        unit = " noise standard deviations" if self.kind == LossKind.HUBER else " degrees of freedom"
        return f"{self.kind}, {self.threshold:g}{unit}"

    def terms(self, r: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """For residuals (N, ny): cost ``rho``, half its slope ``psi``, weight ``psi / r`` and half its curvature; NaN stays NaN."""
        t, k = r / self.scale, self.threshold
        if self.kind == LossKind.HUBER:
            # t^2 up to k, a straight line of the same slope beyond; written so that NaN counts as inside and stays.
            inside = ~(np.abs(t) > k)
            size = np.where(inside, 1.0, np.abs(t))
            rho = np.where(inside, t**2, 2 * k * size - k**2)
            weight = np.where(inside, 1.0, k / size)
            curvature = np.where(inside, 1.0, 0.0)
        else:
            # rho = (k + 1) ln(1 + t^2 / k), half its slope over t, and half its second derivative.
            rho = (k + 1) * np.log1p(t**2 / k)
            weight = (k + 1) / (k + t**2)
            curvature = (k + 1) * (k - t**2) / (k + t**2) ** 2
        # cost = s^2 rho(r / s), so that psi = W r and the curvature is free of s.
        return self.scale**2 * rho, weight * r, weight, curvature

    def mean_curvature(self, r: np.ndarray) -> np.ndarray:
        """The mean of ``rho'' / 2`` over the residuals (N, ny) of each output: what the loss leaves of the information."""
        is_measured = np.isfinite(r)
        total = np.where(is_measured, self.terms(np.where(is_measured, r, 0.0))[3], 0.0).sum(axis=0)
        return np.maximum(total / np.maximum(is_measured.sum(axis=0), 1), LEAST_CURVATURE)

    def least(self) -> np.ndarray:
        """Mean of ``psi^2`` over that of the curvature (ny,) for normal noise of variance one: 1 for least squares, less otherwise."""
        t = np.linspace(-NORMAL_QUADRATURE_WIDTH, NORMAL_QUADRATURE_WIDTH, NORMAL_QUADRATURE_POINTS)
        # E[psi^2] / E[psi']: the integrals over the normal density as sums, whose common step cancels.
        w = np.exp(-(t**2) / 2)
        _, psi, _, curvature = self.terms(np.repeat(t[:, None], len(self.scale), axis=1))
        return (w @ psi**2) / (w @ curvature)

    def bulk_size(self) -> float:
        """Root mean square of normal noise of variance one without the samples that count as outliers: a little less than 1."""
        t = np.linspace(-NORMAL_QUADRATURE_WIDTH, NORMAL_QUADRATURE_WIDTH, NORMAL_QUADRATURE_POINTS)
        one = replace(self, scale=np.ones(1))
        weight = np.where(one.outliers(t[:, None])[:, 0], 0.0, np.exp(-(t**2) / 2))
        return float(np.sqrt(weight @ t**2 / weight.sum()))

    def outliers(self, r: np.ndarray) -> np.ndarray:
        """Which residuals (N, ny) count for much less than they would in least squares."""
        is_measured = np.isfinite(r)
        weight = self.terms(np.where(is_measured, r, 0.0))[2]
        return is_measured & (weight < OUTLIER_WEIGHT * self.terms(np.zeros_like(r))[2])


# Degrees of freedom: tails heavier than those of any sensor that is in order.
STUDENT_FREEDOM = 4.0


# Threshold of Huber's loss where none is given, in noise standard deviations: 95 % of the efficiency of least squares on normal noise
# (Huber 1981).
HUBER_THRESHOLD = 1.345


def parse_loss(text: str, huber_threshold: float = HUBER_THRESHOLD) -> RobustLoss | None:
    """``huber``, ``student``, or either with its threshold, ``huber:2``; None for ``squares``. Raises ModelError for other text."""
    kind, colon, value = text.partition(":")
    kinds = [str(known) for known in LossKind]
    if kind not in kinds:
        raise ModelError(f"unknown loss {kind!r}; {nearest(kind, kinds)}")
    if kind == LossKind.SQUARES and not colon:
        return None
    try:
        usual = STUDENT_FREEDOM if kind == LossKind.STUDENT else huber_threshold
        threshold = float(value) if colon else usual
    except ValueError:
        threshold = math.nan
    if kind == LossKind.SQUARES or not (math.isfinite(threshold) and threshold > 0):
        raise ModelError(
            f"loss {text!r}: write huber:K with the threshold K in noise standard deviations, student:K with K degrees of freedom,"
            " K above zero, or squares"
        )
    return RobustLoss(kind, threshold)


# The numbers that somebody turns. Every other one is a constant above the function that it steers.


@dataclass(frozen=True)
class StepRefinementPolicy:
    """How small the integration step has to be at the optimum.

    Parameters
    ----------
    halvings
        Times the step is halved at most.
    max_substeps
        Substeps of a sample from which a step is made no finer.
    """

    halvings: int = 4
    max_substeps: int = 16_000


@dataclass(frozen=True)
class TranscriptionPolicy:
    """Which transcription suits a model and its record, and how long its segments are.

    Parameters
    ----------
    max_error_growth
        Factor by which errors may grow over the record. Beyond it a free run loses the constants.
    max_segments
        Segments of a record, unless the growth of errors asks for more.
    usual_rows
        Fewest samples of a segment, unless the growth of errors asks for shorter ones.
    """

    max_error_growth: float = 20.0
    max_segments: int = 50
    usual_rows: int = 20


@dataclass(frozen=True)
class EstimationPolicy:
    """All decision numbers of an estimation, those of the steps it is made of included; see the class of each group.

    Parameters
    ----------
    huber_threshold
        What Huber's loss takes for an outlier where the options do not say.
    noise_rounds
        Solutions under a new noise model at most. Most fits need none, one with a robust loss three or four.
    """

    noise: NoisePolicy = field(default_factory=NoisePolicy)
    discretisation: DiscretisationPolicy = field(default_factory=DiscretisationPolicy)
    transcription: TranscriptionPolicy = field(default_factory=TranscriptionPolicy)
    minimisation: MinimisationPolicy = field(default_factory=MinimisationPolicy)
    step_refinement: StepRefinementPolicy = field(default_factory=StepRefinementPolicy)

    huber_threshold: float = HUBER_THRESHOLD
    noise_rounds: int = 8

    @classmethod
    def from_data(cls, data: Mapping[str, Any]) -> EstimationPolicy:
        """The policy that a result has stored; what an older result lacks is the default, what this version lacks is left out."""
        return replace(DEFAULT_POLICY, **_restore_fields(DEFAULT_POLICY, data))


def _restore_fields(default: Any, data: Mapping[str, Any]) -> dict[str, Any]:
    """What stored ``data`` say of the fields of ``default``, groups within groups included."""
    restored: dict[str, Any] = {}
    for name in (f.name for f in fields(default) if f.name in data):
        usual, value = getattr(default, name), data[name]
        if is_dataclass(usual) and not isinstance(usual, type):
            restored[name] = replace(usual, **_restore_fields(usual, value))
        else:
            restored[name] = tuple(value) if isinstance(value, list) else value
    return restored


DEFAULT_POLICY = EstimationPolicy()
"""What every estimation uses unless it is given another policy."""


class Transcription(StrEnum):
    """How records become an optimisation problem."""

    AUTOMATIC = "automatic"
    SINGLE = "single"
    MULTIPLE = "multiple"
    COLLOCATION_RADAU = "collocation-radau"
    COLLOCATION_LEGENDRE = "collocation-legendre"
    ARCS = "arcs"


class Hessian(StrEnum):
    """Curvature that a fit by collocation uses."""

    GAUSS_NEWTON = "gauss-newton"
    EXACT = "exact"


class ColourTreatment(StrEnum):
    """Which coloured noise a fit is whitened with."""

    KNOWN = "known"
    RESIDUAL = "residual"
    WHITE = "white"


@dataclass(frozen=True)
class FitOptions:
    """Choices of a fit, kept with its result.

    Parameters
    ----------
    at_rest
        Every record starts at the states the model declares, instead of estimated ones (but for states with `State.free_start`).
    settled
        Every record starts where the model comes to rest from there, under the inputs before the record (its first ones, where it tells
        no others) and its conditions: a rig under a load, a culture before its experiment. The state and its slopes along the constants
        are found anew with them.
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
        Where the cost has a kink (dry friction) and its gradient misleads, search on without it; that takes many passes. False for one of
        many candidates: damped Gauss-Newton steps alone, which end where they gain little.
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
        standard deviations, ``student:3`` degrees of freedom), see `RobustLoss`.
    per_experiment
        Parameters of which each experiment has a value of its own.
    common_noise
        Outputs whose noise nothing tells have one level in common, which the residual of all of them says: they are weighed alike, as
        a plain sum of squares does. They must have one unit.
    other_starts
        How many other starts are searched where the fit from the model's own explains nothing of an output, and how many more about
        the scales that the records show where those do not either; 0 for none.
    exchange
        Look for constants that may change places, by some runs at the optimum; False for one of many fits.
    policy
        The numbers that steer decisions, see `EstimationPolicy`.

    Raises
    ------
    ModelError
        For a choice that does not exist, or one that contradicts another.

    Examples
    --------
    >>> FitOptions(at_rest=True, loss="huber").transcription
    'automatic'
    """

    method: str = "automatic"
    substeps: int = 0
    progressive: bool = True
    iterations: int = 200
    tolerance: float = 1e-12
    thorough: bool = True
    transcription: str = "automatic"
    arc_length: float = 0.0
    hessian: str = "gauss-newton"
    policy: EstimationPolicy = DEFAULT_POLICY
    at_rest: bool = False
    settled: bool = False
    loss: str = "squares"
    per_experiment: tuple[str, ...] = ()
    common_noise: bool = False
    other_starts: int = 6
    exchange: bool = True

    KEYS: ClassVar[str] = """
        method substeps progressive iterations tolerance thorough transcription arc_length hessian at_rest settled loss per_experiment
        common_noise other_starts exchange policy
        """

    def __post_init__(self) -> None:
        object.__setattr__(
            self,
            "per_experiment",
            (self.per_experiment,) if isinstance(self.per_experiment, str) else tuple(self.per_experiment),
        )
        self.to_loss()
        if self.settled:
            if self.arc_length or self.transcription.startswith("collocation"):
                raise ModelError(
                    "settled: collocation, and arcs with an initial state each, do not begin where a run comes to rest; take"
                    " transcription 'single' or 'multiple', or leave settled out"
                )
            object.__setattr__(self, "at_rest", True)
        if self.other_starts < 0:
            raise ModelError(
                f"other_starts {self.other_starts}: give how many other starts are searched, or 0 for none"
            )
        if self.transcription not in list(Transcription):
            raise ModelError(
                f"unknown transcription {self.transcription!r}; {nearest(self.transcription, list(map(str, Transcription)))}"
            )
        if self.hessian not in list(Hessian):
            raise ModelError(f"unknown Hessian {self.hessian!r}; {nearest(self.hessian, list(map(str, Hessian)))}")
        if not (math.isfinite(self.arc_length) and self.arc_length >= 0):
            raise ModelError(f"arc_length {self.arc_length} s: give a positive number of seconds, or 0 for no arcs")
        if self.arc_length and self.transcription not in ("automatic", "arcs"):
            raise ModelError(
                f"arc_length {self.arc_length:g} s: transcription {self.transcription!r} has no arcs; leave out one of the two"
            )
        if self.transcription == "arcs" and not self.arc_length:
            raise ModelError("transcription 'arcs' needs their length: give arc_length, in seconds")
        if self.arc_length and self.at_rest:
            raise ModelError(
                f"arc_length {self.arc_length:g} s: each arc begins at an initial state of its own, and not at rest; leave out at_rest or"
                " arc_length"
            )
        if self.transcription.startswith("collocation") and self.method != "automatic":
            raise ModelError(
                f"method {self.method!r}: transcription {self.transcription!r} integrates by its own polynomials; leave out one of the two"
            )
        if self.hessian == "exact" and not self.transcription.startswith("collocation"):
            raise ModelError(
                f"hessian 'exact': transcription {self.transcription!r} has none; take 'collocation-radau' or"
                " 'collocation-legendre', or 'gauss-newton'"
            )

    @classmethod
    def from_data(cls, data: Mapping[str, Any]) -> FitOptions:
        """The options that a result has stored (`Fit.provenance`); what an older result lacks is the default."""
        known = {name: data[name] for name in cls.__dataclass_fields__ if name in data and name != "policy"}
        return cls(**known, policy=EstimationPolicy.from_data(data.get("policy", {})))

    def to_data(self) -> dict[str, Any]:
        """The options as plain values, for a result to store."""
        data: dict[str, Any] = to_json_data(self)
        return data

    @property
    def integration(self) -> FitOptions:
        """The same choices of how a model is integrated and how records begin; all others are the usual ones."""
        return FitOptions(
            at_rest=self.at_rest, settled=self.settled, method=self.method, substeps=self.substeps, policy=self.policy
        )

    @property
    def robust(self) -> bool:
        """Whether the loss is a robust one."""
        return self.to_loss() is not None

    def to_loss(self) -> RobustLoss | None:
        """The robust loss; None for least squares. Raises ModelError for text that names none."""
        return parse_loss(self.loss, self.policy.huber_threshold)


P = ParamSpec("P")
R = TypeVar("R")


def explain_unknown(verb: Callable[P, R]) -> Callable[P, R]:
    """``verb`` whose error for an argument that it does not have says where that is given: an option, a constant, how a record is read."""
    known = signature(verb).parameters

    @wraps(verb)
    def explained(*args: P.args, **given: P.kwargs) -> R:
        if unknown := {name: value for name, value in given.items() if name not in known}:
            raise TypeError(
                "; ".join(_explain_argument(verb.__name__, name, value, list(known)) for name, value in unknown.items())
            )
        return verb(*args, **given)

    return explained


# Methods of a model that change what a fit does with its constants.
OF_CONSTANTS = ("fix", "free", "start", "bound", "prior", "tie")


def _explain_argument(verb: str, name: str, value: Any, known: Sequence[str]) -> str:
    refused = f"{verb}() has no argument {name!r}"
    if name in {f.name for f in fields(FitOptions)}:
        return f"{refused}: it is an option; write options=gb.FitOptions({name}={value!r})"
    if name in OF_CONSTANTS:
        values = ", ".join(f"{n}={v!r}" for n, v in value.items()) if isinstance(value, Mapping) else "..."
        return f"{refused}: constants are changed in the model, which is given in its place: model.{name}({values})"
    if name in signature(read_csv).parameters:
        return f"{refused}: it says how a record is read; give the record gb.read_csv(frame, model, {name}=...)"
    return f"{refused}; {nearest(name, known)}"


def resolve_options(options: Any) -> FitOptions:
    """``options``, or the usual ones for None. Raises ModelError for anything that is not `FitOptions`."""
    if options is None:
        return FitOptions()
    if not isinstance(options, FitOptions):
        shown = ", ".join(f"{k}={v!r}" for k, v in options.items()) if isinstance(options, dict) else "at_rest=True"
        raise ModelError(f"options: {options!r} is not a FitOptions; write options=FitOptions({shown})")
    return options
