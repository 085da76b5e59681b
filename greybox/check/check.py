"""`check`: are the equations right, how would they be integrated, and what can the records tell."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from greybox.check.generic import generic_record
from greybox.experiment import Experiment
from greybox.fitting.notes import describe
from greybox.fitting.options import FitOptions
from greybox.fitting.problem import Problem, prepare
from greybox.fitting.uncertainty import estimates, uncertainty
from greybox.model import Model
from greybox.transcription import Evaluation

# Beyond this relative standard deviation a constant is called weakly determined.
WEAK = 0.5


@dataclass(frozen=True)
class Expected:
    """What the records can say about a constant: start ``value``, and ``std`` to expect there (None: undetermined)."""

    value: float
    unit: str
    std: float | None


@dataclass(frozen=True)
class Check:
    """The findings. ``assumed`` describes the simulated record that stood in for data, "" where records were given.

    ``constants``: free constants by name; ``open_directions``: combinations that the records do not determine, in
    words; ``noise``: standard deviation by output, ``noise_source`` where it comes from; ``kernel`` and
    ``kernel_reason``: what runs the model, and why.
    """

    model: Model
    linear: bool
    discretisation: str
    kernel: str
    kernel_reason: str
    experiments: tuple[Experiment, ...]
    assumed: str
    noise: Mapping[str, float]
    noise_source: str
    constants: Mapping[str, Expected]
    open_directions: tuple[str, ...]
    failure: str = ""

    def __str__(self) -> str:
        from greybox.check.summary import summary

        return summary(self)


def check(
    model: Model,
    experiments: Experiment | Sequence[Experiment] = (),
    *,
    noise: Mapping[str, float] | None = None,
    options: FitOptions | None = None,
) -> Check:
    """What is known about ``model`` before a fit, and which constants the records determine near the start values.

    Units and names were checked when the model was made. Without ``experiments`` a simulated record stands in for them,
    see `greybox.check.generic`. ``noise``: standard deviation by output, estimated from the records if left out. The
    standard deviations to expect hold if the model is right and the start values are near: a fit says more.

    Raises DataError and ModelError for records that do not go with the model.
    """
    options = options or FitOptions()
    group = (experiments,) if isinstance(experiments, Experiment) else tuple(experiments)
    assumed = ""
    if not group:
        record, assumed = generic_record(model)
        group = (record,)
    problem = prepare(model, group, noise, at_rest=options.at_rest, method=options.method, substeps=options.substeps)
    constants, directions, failure = _determined(problem)
    measured = {name for e in group for name in e.outputs}
    return Check(
        model, model.system.linear, problem.step.label, problem.kernel.description, problem.kernel.reason,
        group, assumed,
        {o.name: float(problem.noise.std[j]) for j, o in enumerate(model.outputs) if o.name in measured},
        problem.noise.source, constants, directions, failure,
    )  # fmt: skip


def _determined(problem: Problem) -> tuple[dict[str, Expected], tuple[str, ...], str]:
    """Constants with their expected standard deviation, open directions in words, and why there are none."""
    variables = problem.variables
    if not variables.names:
        return {}, (), "no constant is free: nothing to determine"
    evaluation = problem.shooting(variables).evaluate(np.zeros(variables.size))
    if not np.isfinite(evaluation.cost):
        record, sample = evaluation.failed or (0, 0)
        time = float(problem.records[record].h[:sample].sum())
        name = problem.experiments[record].name
        return {}, (), f"the model overflows on {name} after {time:.3g} s at the start values; give others with --start"
    found = uncertainty(variables, _at_noise(evaluation, variables.size), noise_given=True)
    expected = estimates(variables, found)
    constants = {
        name: Expected(expected[name].value, expected[name].unit, expected[name].std) for name in variables.names
    }
    return constants, tuple(describe(d) for d in found.open_directions), ""


def _at_noise(evaluation: Evaluation, size: int) -> Evaluation:
    """The same curvature with the cost that noise alone would leave."""
    return replace(evaluation, cost=float(max(evaluation.count - size, 1)))
