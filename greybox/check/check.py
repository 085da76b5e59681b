"""`check`: are the equations right, how would they be integrated, and what can the records tell."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from greybox.errors import DataError, ModelError, nearest
from greybox.estimation.fit_issues import find_excluded_outputs
from greybox.estimation.options import FitOptions
from greybox.estimation.problem import prepare_problem
from greybox.experiment import Experiment
from greybox.identifiability.generic_experiment import simulate_generic_record
from greybox.identifiability.practical import (
    ExpectedPrecision,
    PracticalIdentifiability,
    analyse_problem,
    list_measured_outputs,
)
from greybox.identifiability.structural import StructuralIdentifiability, analyse_structural_identifiability
from greybox.model import Model


@dataclass(frozen=True)
class ModelCheck:
    """The findings. ``assumed`` describes the simulated record that stood in for data, "" where records were given.

    ``structure``: what the measured outputs can tell at best; None where the model could not be run, then ``doubt`` says
    why. ``practical``: what these records tell. ``noise``: standard deviation by output, ``noise_source`` where it comes
    from; ``kernel`` and ``kernel_reason``: what runs the model, and why.
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
    structure: StructuralIdentifiability | None
    practical: PracticalIdentifiability
    doubt: str = ""

    @property
    def constants(self) -> Mapping[str, ExpectedPrecision]:
        """What to expect of each free constant."""
        return self.practical.constants

    @property
    def open_directions(self) -> tuple[str, ...]:
        """Combinations that no record of the measured outputs determines, in words."""
        return tuple(str(d) for d in self.structure.directions) if self.structure else ()

    @property
    def failure(self) -> str:
        """Why nothing can be said of the records, "" where something can."""
        return self.practical.failure

    @property
    def complete(self) -> bool:
        """Whether every free constant is determined, by the structure and by the records."""
        done = self.structure is None or self.structure.complete
        return done and not self.failure and all(c.determined for c in self.constants.values())

    def as_dict(self) -> dict[str, Any]:
        """The findings as numbers, texts, lists and dictionaries, ready for JSON."""
        from greybox.check.plain import to_plain_values

        return to_plain_values(self)

    def __str__(self) -> str:
        from greybox.check.summary import summary

        return summary(self)


def check(
    model: Model,
    experiments: Experiment | Sequence[Experiment] = (),
    *,
    noise: Mapping[str, float] | None = None,
    outputs: Sequence[str] | None = None,
    options: FitOptions | None = None,
) -> ModelCheck:
    """What is known about ``model`` before a fit, and which constants the records determine near the start values.

    Units and names were checked when the model was made. Without ``experiments`` a simulated record stands in for them,
    see `greybox.identifiability.generic_experiment`. ``noise``: standard deviation by output, estimated from the records if left
    out. ``outputs``: what if only these were measured? None for all that the records have. The standard deviations to
    expect hold if the model is right and the start values are near: a fit says more.

    Raises DataError and ModelError for records that do not go with the model, ModelError for unknown outputs.
    """
    options = options or FitOptions()
    group = (experiments,) if isinstance(experiments, Experiment) else tuple(experiments)
    _check_outputs(model, outputs)
    assumed = ""
    if not group:
        record, assumed = simulate_generic_record(model)
        group = (record,)
    if outputs is not None:
        group = tuple(_only(e, outputs) for e in group)
        noise = {name: std for name, std in (noise or {}).items() if name in outputs}
    problem = prepare_problem(
        model, group, noise, at_rest=options.at_rest, method=options.method, substeps=options.substeps
    )
    measured = list_measured_outputs(problem)
    structure, doubt = _structure(model, measured, options.at_rest)
    return ModelCheck(
        model, model.system.linear, problem.step.label, problem.kernel.description, problem.kernel.reason,
        group, assumed,
        {o.name: float(problem.noise.std[j]) for j, o in enumerate(model.outputs) if o.name in measured},
        "; ".join([str(problem.noise), *map(str, find_excluded_outputs(problem))]), structure, analyse_problem(problem, structure), doubt,
    )  # fmt: skip


def _structure(model: Model, measured: Sequence[str], at_rest: bool) -> tuple[StructuralIdentifiability | None, str]:
    """The structural finding, or why there is none: a model that overflows is told, and the records are still looked at."""
    try:
        return analyse_structural_identifiability(model, measured, at_rest=at_rest), ""
    except DataError as error:
        return None, str(error)


def _check_outputs(model: Model, outputs: Sequence[str] | None) -> None:
    known = [o.name for o in model.outputs]
    for name in outputs or ():
        if name not in known:
            raise ModelError(f"model {model.title!r} has no output {name!r}; {nearest(name, known)}")


def _only(experiment: Experiment, outputs: Sequence[str]) -> Experiment:
    kept = {name: values for name, values in experiment.outputs.items() if name in outputs}
    if not kept:
        raise DataError(
            f"experiment {experiment.name!r} has none of the outputs {', '.join(outputs)};"
            f" it has {', '.join(experiment.outputs) or 'none'}"
        )
    return replace(experiment, outputs=kept)
