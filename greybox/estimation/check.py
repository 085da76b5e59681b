"""`check`: are the equations right, how would they be integrated, and what can the records determine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar, TypedDict

from greybox.base import DataError, FileKind, Finding, ModelError, Printable, StoredResult, nearest
from greybox.data.experiment import Experiment
from greybox.data.noise.noise_model import NoiseModel, NoiseSource
from greybox.data.read import as_experiments
from greybox.estimation.findings import find_excluded_outputs
from greybox.estimation.identifiability.combinations import OpenDirection
from greybox.estimation.identifiability.practical import (
    ExpectedPrecision,
    PracticalIdentifiability,
    analyse_problem,
    list_measured_outputs,
)
from greybox.estimation.identifiability.sensitivity import simulate_generic_record
from greybox.estimation.identifiability.structural import StructuralIdentifiability, analyse_structural_identifiability
from greybox.estimation.identifiability.twins import find_other_answers, find_twins, move_apart
from greybox.estimation.options import FitOptions
from greybox.estimation.transcription.preparation import prepare_problem
from greybox.model import Input, Model, Parameter, State
from greybox.model.effects import Placement, all_effects, find_placements
from greybox.simulation.kernel.interpreted import InterpretedKernel
from greybox.simulation.plant import Plant, as_model


class CheckedNoise(TypedDict):
    """Noise of the outputs.

    Attributes
    ----------
    std
        Output -> standard deviation.
    source
        Where it is known from, in a line.
    sources
        Output -> where it is known from.
    """

    std: Mapping[str, float]
    source: str
    sources: Mapping[str, NoiseSource]


class Doubt(TypedDict):
    """Why nothing can be said of a structure.

    Attributes
    ----------
    doubt
        In a sentence.
    """

    doubt: str


class FoundPlace(TypedDict):
    """An effect that finds a place in a model.

    Attributes
    ----------
    name, site
        The effect there, and the balance, input or output.
    """

    name: str
    site: str


class MissingPlace(TypedDict):
    """An effect that finds no place in a model.

    Attributes
    ----------
    name, reason
        The effect, and the reason in a sentence.
    missing
        Kind (site, state, input, parameter, unit) and name or role of what the model lacks; null for another reason.
    """

    name: str
    reason: str
    missing: Mapping[str, str] | None


@dataclass(frozen=True)
class ModelCheck(Printable, StoredResult):
    """What is known of a model, and of records for it, before a fit.

    Parameters
    ----------
    model
        The model as it was given.
    linear
        Whether it is linear in states and inputs.
    discretisation
        How it would be integrated.
    kernel, kernel_reason, compiled
        What runs it, why, and whether that is compiled code (CasADi's virtual machine is not).
    experiments
        The records, or a simulated one.
    assumed
        What was assumed for the simulated record that stood in for data; None where records were given.
    noise
        Standard deviation by measured output.
    noise_model
        The same with where it is known from.
    excluded
        What is left out of the outputs, and why.
    structure
        What the measured outputs determine at best; None where the model could not be run or has no equations, then ``doubt`` says why.
    practical
        What these records determine.
    other_answers
        Other values of the constants than these that make the same run, such as two that change places.
    placements
        Where the effects of the catalogue find a place in it, and what the others lack.
    options
        What it was steered by.
    """

    model: Model
    linear: bool
    discretisation: str
    kernel: str
    kernel_reason: str
    compiled: bool
    experiments: tuple[Experiment, ...]
    assumed: Finding | None
    noise: Mapping[str, float]
    noise_model: NoiseModel
    excluded: tuple[Finding, ...]
    structure: StructuralIdentifiability | None
    practical: PracticalIdentifiability
    other_answers: tuple[Finding, ...] = ()
    doubt: str = ""
    placements: tuple[Placement, ...] = ()
    options: FitOptions = field(default_factory=FitOptions, repr=False)

    FILE: ClassVar[FileKind] = FileKind("a check", "check.json that greybox check has written")
    KEYS: ClassVar[str] = """
        model!=model.title linear discretisation kernel records=experiments assumed=str(assumed) noise=noise_outline
        structure!=structure_or_doubt data=practical other_answers? complete roles effects=placed without_place options
        """

    @property
    def constants(self) -> Mapping[str, ExpectedPrecision]:
        """What to expect of each free constant."""
        return self.practical.constants

    @property
    def open_directions(self) -> tuple[OpenDirection, ...]:
        """Combinations that no record of the measured outputs determines."""
        return self.structure.directions if self.structure else ()

    @property
    def roles(self) -> dict[str, dict[str, str]]:
        """``states``, ``inputs`` and ``parameters`` of the plant that have a role, by name."""
        model, roles = self.model, self.model.roles
        groups: dict[str, Sequence[State | Input | Parameter]] = {
            "states": model.states,
            "inputs": model.inputs,
            "parameters": model.parameters,
        }
        return {group: {i.name: roles[i.name] for i in items if i.name in roles} for group, items in groups.items()}

    @property
    def failure(self) -> Finding | None:
        """Why nothing can be said of the records, None where something can."""
        return self.practical.failure

    @property
    def complete(self) -> bool:
        """Whether every free constant is determined, by the structure or what is known beforehand, and by the records."""
        has_prior = any(q.prior is not None for q in self.model.free_parameters)
        structure_complete = self.structure is None or self.structure.complete or has_prior
        return structure_complete and not self.failure and all(c.determined for c in self.constants.values())

    @property
    def noise_outline(self) -> CheckedNoise:
        """Noise of the outputs."""
        source = "; ".join(map(str, (self.noise_model, *self.excluded)))
        return {"std": self.noise, "source": source, "sources": self.noise_model.sources}

    @property
    def structure_or_doubt(self) -> StructuralIdentifiability | Doubt:
        """What any record can determine; why nothing can be said, where the model could not be run."""
        return {"doubt": self.doubt} if self.structure is None else self.structure

    @property
    def placed(self) -> tuple[FoundPlace, ...]:
        """Effects of the catalogue that find a place in the model, and where."""
        return tuple({"name": p.name, "site": p.site} for p in self.placements if p.effect is not None)

    @property
    def without_place(self) -> tuple[MissingPlace, ...]:
        """Effects of the catalogue that find none, and what the model lacks for each."""
        return tuple(
            {
                "name": p.name,
                "reason": p.reason,
                "missing": None if p.missing is None else dict(zip(("kind", "name"), p.missing, strict=True)),
            }
            for p in self.placements
            if p.effect is None
        )


def check(
    model: Model | Plant,
    experiments: Experiment | Sequence[Experiment] = (),
    *,
    noise: Mapping[str, float] | None = None,
    outputs: Sequence[str] | None = None,
    options: FitOptions | None = None,
) -> ModelCheck:
    """What is known about a model before a fit, and which constants the records determine near the start values.

    Units and names were checked when the model was made. The standard deviations to expect hold if the model is right and the
    start values are near: a fit says more.

    Parameters
    ----------
    model
        The model with its start values, or a plant, of which no equations are known: then the records alone say what they determine.
    experiments
        The records; without them a simulated record stands in, see `greybox.estimation.identifiability.sensitivity`.
    noise
        Standard deviation by output, estimated from the records if left out.
    outputs
        What if only these were measured? None for all that the records have.
    options
        How the model is integrated, and whether records begin at rest.

    Returns
    -------
    ModelCheck
        Integration, structural and practical identifiability.

    Raises
    ------
    DataError, ModelError
        For records that do not go with the model, and for unknown outputs.

    Examples
    --------
    >>> [str(d) for d in check(micro_actuator).open_directions]  # doctest: +SKIP
    ['M, B, K, Kf scale together']
    """
    model, options = as_model(model), options or FitOptions()
    group = as_experiments(experiments, model)
    if not (group or model.has_equations):
        raise DataError(
            f"{model.title} is run from outside: what it needs of a record is not known; give one to check it with"
        )
    known = [o.name for o in model.outputs]
    unknown = [name for name in outputs or () if name not in known]
    if unknown:
        raise ModelError(f"model {model.title!r} has no output {unknown[0]!r}; {nearest(unknown[0], known)}")
    assumed = None
    if not group:
        record, assumed = simulate_generic_record(model)
        group = (record,)
    if outputs is not None:
        blind = next((e for e in group if not set(outputs) & set(e.outputs)), None)
        if blind:
            raise DataError(
                f"experiment {blind.name!r} has none of the outputs {', '.join(outputs)};"
                f" it has {', '.join(blind.outputs) or 'none'}"
            )
        group = tuple(e.with_outputs({n: y for n, y in e.outputs.items() if n in outputs}) for e in group)
        noise = {name: std for name, std in (noise or {}).items() if name in outputs}
    problem = prepare_problem(model, group, noise, options.integration)
    measured = list_measured_outputs(problem)
    structure, doubt = None, "" if model.has_equations else "not known, as it is run from outside"
    try:
        # What outputs could tell at best is read off the equations: without them every constant would seem to have no influence.
        if model.has_equations:
            structure = analyse_structural_identifiability(model, measured, at_rest=options.at_rest)
    except DataError as error:  # of a model that overflows; the records are still looked at
        doubt = str(error)
    practical = analyse_problem(problem, structure, options.integration)
    twins = () if practical.failure else find_twins(problem)
    # Where constants that may change places start equal no slope tells them apart: what to expect of them is asked where they differ.
    apart = move_apart(problem, twins)
    if apart is not problem:
        practical = analyse_problem(apart, structure, options.integration)
    return ModelCheck(
        model,
        model.has_equations and model.system.linear,
        problem.step.label,
        problem.kernel.description,
        problem.kernel.reason,
        problem.kernel.name != InterpretedKernel.name,
        group,
        assumed,
        {o.name: float(problem.noise.std[j]) for j, o in enumerate(model.outputs) if o.name in measured},
        problem.noise,
        tuple(find_excluded_outputs(problem)),
        structure,
        practical,
        tuple(find_other_answers(twins)),
        doubt,
        tuple(find_placements(model, all_effects())),
        options,
    )
