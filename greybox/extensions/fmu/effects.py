"""Effects at the inputs and outputs of an FMU: looked for on its local model, and fitted with the FMU itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from greybox.base.errors import ModelError
from greybox.base.json_file import StoredResult
from greybox.base.json_shape import FileKind
from greybox.base.values import Printable
from greybox.comparison.black_box_candidates import fit_black_boxes
from greybox.comparison.compare import NamedModel, compare_named
from greybox.comparison.result import Comparison
from greybox.data.experiment import Experiment, as_records
from greybox.discovery.decision import Verdict
from greybox.discovery.effect_test import try_effect
from greybox.discovery.pipeline import discover
from greybox.discovery.policy import DiscoveryPolicy
from greybox.discovery.result import Discovery
from greybox.estimation.fit import fit
from greybox.estimation.optim.minimisation import TerminationStatus
from greybox.estimation.options import FitOptions
from greybox.estimation.result import Fit
from greybox.estimation.result_parts import Estimate, Misfit
from greybox.estimation.validate import validate
from greybox.extensions.fmu.local_model import (
    LocalModel,
    build_local_model,
    estimate_linear_response,
    extend_record,
    name_arriving,
)
from greybox.model.effect import Effect
from greybox.model.model import Model
from greybox.simulation.plant import PlantKernel, PlantModel, PlantRunError
from greybox.simulation.simulate import simulate

AT_REST = FitOptions(at_rest=True)
"""The added states begin at zero: a record starts as the FMU starts."""


@dataclass(frozen=True, eq=False)
class PreparedFmu:
    """A fitted FMU as a model, with the records that it needs.

    Parameters
    ----------
    fit
        Of the FMU alone.
    local
        The model about it.
    estimation, validation
        The records with what the model takes from runs of the FMU.
    records, others
        The records as they were.
    runs, failures
        Runs that this took, and those of them that failed.
    equivalents
        What these runs cost: their rows over those of all records.
    """

    fit: Fit
    local: LocalModel
    estimation: tuple[Experiment, ...]
    validation: tuple[Experiment, ...]
    records: tuple[Experiment, ...]
    others: tuple[Experiment, ...]
    runs: int
    failures: int
    equivalents: float


@dataclass(frozen=True, eq=False)
class FmuWithEffects(Printable, StoredResult):
    """Effects and parameters fitted with the FMU itself.

    Parameters
    ----------
    plant
        The FMU at these parameters.
    effects
        Their names.
    fit
        Parameters of the FMU and of the effects, of the local model where it agrees with the FMU.
    misfits, validation
        Output -> error of the FMU with its effects.
    rounds
        Times that the local model was fitted.
    agrees
        Whether the FMU errs as much as its local model does.
    prepared
        The local model about this point, with its records.
    """

    plant: PlantModel
    effects: tuple[str, ...]
    fit: Fit
    misfits: Mapping[str, Misfit]
    validation: Mapping[str, Misfit]
    rounds: int
    agrees: bool
    prepared: PreparedFmu

    FILE: ClassVar[FileKind] = FileKind("a fit of an FMU", "fmu_fit.json that greybox fit has written")
    # Earlier versions wrote fits without effects so, too: without effects and rounds, and with what the runs cost.
    KEYS: ClassVar[str] = """
        fmu! effects? status! parameters! misfit=misfits validation runs! failures=prepared.failures rounds?
        simulation_equivalents?=prepared.equivalents
        """

    @property
    def fmu(self) -> str:
        """Name of the FMU's file."""
        return str(self.plant.plant.fmu.path.name)

    @property
    def status(self) -> TerminationStatus:
        """How the search ended: an FMU that errs more than its local model was not reached."""
        return TerminationStatus.CONVERGED if self.agrees else TerminationStatus.ITERATION_LIMIT

    @property
    def runs(self) -> int:
        """Runs of one record."""
        return self.prepared.runs

    @property
    def parameters(self) -> dict[str, Estimate]:
        """Those of the FMU that were fitted, and those of the effects."""
        local = self.prepared.local.model
        added = {q.name for q in local.parameters} - {q.name for q in local.free_parameters}
        return {name: e for name, e in self.fit.parameters.items() if name not in added}


@dataclass(frozen=True, eq=False)
class FmuDiscovery(Printable):
    """Which effect an FMU lacks at its inputs and outputs.

    Parameters
    ----------
    prepared
        The FMU alone, and its local model.
    discovery
        The answer on the local model.
    with_effects
        The effects of the answer fitted with the FMU itself; None where there are none, or the FMU does not run with them.
    runs
        Runs of one record in all.
    """

    prepared: PreparedFmu
    discovery: Discovery
    with_effects: FmuWithEffects | None
    runs: int


def prepare_fmu(
    result: Fit,
    estimation: Experiment | Sequence[Experiment],
    validation: Experiment | Sequence[Experiment] = (),
) -> PreparedFmu:
    """A fitted FMU as a model that can be checked, compared and searched for effects like any other.

    Parameters
    ----------
    result
        The fit of the FMU alone (`greybox.fit`).
    estimation, validation
        The records.

    Returns
    -------
    PreparedFmu
        The model, and the records extended by what it takes from runs of the FMU.

    Raises
    ------
    PlantRunError
        Where the FMU does not run over a validation record.
    """
    local, groups, kernel = prepare_plant(result.model, as_records(estimation), as_records(validation))
    records, others = as_records(estimation), as_records(validation)
    return PreparedFmu(result, local, *groups, records, others, **_sum_costs([kernel], records))


def prepare_plant(
    plant: Model, records: tuple[Experiment, ...], others: tuple[Experiment, ...] = ()
) -> tuple[LocalModel, tuple[tuple[Experiment, ...], tuple[Experiment, ...]], PlantKernel]:
    """The local model of any plant without equations about its present values, both groups of records as it reads them, and what ran it.

    Raises ModelError for a model that has equations, and PlantRunError where the plant does not run.
    """
    if not isinstance(plant, PlantModel):
        raise ModelError(f"{plant.title} has equations: check, compare and search it as it is")
    kernel = PlantKernel(plant)
    longest = max(records, key=lambda record: record.rows)
    local = build_local_model(plant, records[0].hold, estimate_linear_response(kernel, longest))
    return local, (_extend(kernel, records, local), _extend(kernel, others, local)), kernel


# Most rounds of a fit of the local model and a run of the FMU there.
FMU_RESPONSE_ROUNDS = 6
# Change of the misfit, over its size, below which the FMU agrees with its local model.
FMU_RESPONSE_SETTLED = 0.01


def fit_fmu_effects(
    prepared: PreparedFmu,
    effects: Sequence[Effect],
    *,
    start: Mapping[str, float] | None = None,
    noise: Mapping[str, float] | None = None,
) -> FmuWithEffects:
    """Fit effects together with the parameters of the FMU, which is run with them.

    The local model with the effects is fitted, the FMU is run at the parameters and inputs that it says, and the local model is
    made anew there, until both err alike.

    Parameters
    ----------
    prepared
        The FMU, see `prepare_fmu`.
    effects
        At its inputs and outputs, among ``prepared.local.candidates``.
    start
        Start values of the effects' parameters.
    noise
        Output -> standard deviation of its sensor.

    Returns
    -------
    FmuWithEffects
        Parameters with intervals, and the misfit of the FMU with the effects.

    Raises
    ------
    PlantRunError
        Where the FMU does not run with the effects.
    """
    plant, local, records = prepared.local.plant, prepared.local, prepared.estimation
    names, hold = [q.name for q in plant.free_parameters], prepared.records[0].hold
    values = dict(start or {})
    std = dict(noise) if noise else None
    agrees, rounds, kernels = False, 0, list[PlantKernel]()
    while not agrees and rounds < FMU_RESPONSE_ROUNDS:
        rounds += 1
        model = _add(local.model, effects).start(**values)
        fitted = fit(model, records, noise=std, options=AT_REST)
        plain = {q.name for q in local.model.parameters}
        # The next round begins where this one ended; constants of the FMU go into its own run.
        values = {name: e.value for name, e in fitted.parameters.items() if name not in plain}
        moved = plant.start(**{name: fitted.parameters[name].value for name in names})
        assert isinstance(moved, PlantModel)
        plant = moved
        kernel = PlantKernel(plant)
        kernels.append(kernel)
        with_inputs = _add(build_local_model(plant, hold, local.response, show_inputs=True).model, effects)
        with_inputs = with_inputs.start(**values)
        behind = _apply(prepared.records, records, with_inputs, plant)
        # The response belongs to the parameters: that of others would leave part of what an effect with memory does to an average.
        longest = max(behind, key=lambda record: record.rows)
        answer = estimate_linear_response(kernel, longest) or local.response
        local = build_local_model(plant, hold, answer)
        # Runs of the FMU with the inputs as they arrive behind the effects: the local model is exact there, not only near by.
        records = _extend(kernel, behind, local, prepared.records)
        model = _add(local.model, effects).start(**values)
        errors = validate(model, records, noise=prepared.fit.noise.std, options=AT_REST).misfit
        expected = {name: misfit.rmse for name, misfit in fitted.misfit.items()}
        # The FMU itself errs as much as its local model: then what was fitted on that holds for the FMU.
        agrees = all(abs(errors[n].rmse - expected[n]) <= FMU_RESPONSE_SETTLED * expected[n] for n in errors)
    checked: Mapping[str, Misfit] = {}
    validation: tuple[Experiment, ...] = ()
    if prepared.others:
        behind = _apply(prepared.others, prepared.validation, with_inputs, plant)
        validation = _extend(kernel, behind, local, prepared.others)
        checked = validate(model, validation, noise=prepared.fit.noise.std, options=AT_REST).misfit
    costs = _sum_costs(kernels, prepared.records)
    about = replace(prepared, local=local, estimation=records, validation=validation, **costs)
    return FmuWithEffects(plant, tuple(e.name for e in effects), fitted, errors, checked, rounds, agrees, about)


def discover_fmu(
    prepared: PreparedFmu,
    *,
    noise: Mapping[str, float] | None = None,
    effects: Sequence[Effect] | None = None,
    discovery: DiscoveryPolicy | None = None,
    **options: Any,
) -> FmuDiscovery:
    """Find which effect an FMU lacks at its inputs and outputs.

    Parameters
    ----------
    prepared
        The FMU with its records, see `prepare_fmu`.
    noise
        Output -> standard deviation of its sensor.
    effects
        The only candidates, instead of those of the catalogue.
    discovery
        The decision numbers of the search.
    options
        As of `greybox.discover`: ``skip``, ``without``, ``further``, ``workers`` and the like.

    Returns
    -------
    FmuDiscovery
        The answer, and its effects fitted with the FMU itself.

    Raises
    ------
    DataError
        Without a validation record.
    """

    def search(about: PreparedFmu) -> tuple[Discovery, FmuWithEffects | None]:
        answer = discover(
            about.local.model,
            about.estimation,
            validation=about.validation,
            noise=noise,
            effects=list(effects) if effects else about.local.candidates,
            options=AT_REST,
            policy=discovery,
            **options,
        )
        chosen = answer.best.model.effects
        if not chosen:
            return answer, None
        plain = {q.name for q in about.local.model.parameters}
        start = {name: value for name, value in answer.best.model.values.items() if name not in plain}
        try:
            return answer, fit_fmu_effects(about, chosen, start=start, noise=noise)
        except PlantRunError:
            return answer, None

    answer, with_effects = search(prepared)
    runs = int(prepared.fit.solver.statistics["runs"]) + prepared.runs + (with_effects.runs if with_effects else 0)
    if with_effects is not None and with_effects.rounds > 1 and answer.verdict is not Verdict.NAMED:
        # About the parameters of the FMU alone the local model was not exact enough to tell what is left.
        answer, again = search(with_effects.prepared)
        with_effects = again or with_effects
        runs += again.runs if again else 0
    return FmuDiscovery(prepared, answer, with_effects, runs)


def compare_fmu(
    prepared: PreparedFmu,
    candidates: Sequence[str] = (),
    *,
    noise: Mapping[str, float] | None = None,
    skip: int = 0,
    beginning: int = 0,
    steps: Sequence[int] = (),
) -> Comparison:
    """An FMU, alone and with effects, beside black boxes on its validation records.

    Parameters
    ----------
    prepared
        A fitted FMU with its records, from `prepare_fmu`.
    candidates
        Effects to add, each a model of its own; ``"a+b"`` adds two.
    noise
        Standard deviation of the sensor noise by output, in its unit; estimated where not given.
    skip, beginning
        Rows that are not compared, and rows from which an initial state is estimated, as in `greybox.compare`.
    steps
        Numbers of samples to predict ahead, besides the free run.

    Returns
    -------
    Comparison
        The errors of each model.

    Raises
    ------
    GreyboxError
        For an unknown effect, or records that no model can be compared on.
    """
    local, plant = prepared.local.model, prepared.local.plant
    grey = [fit(local, prepared.estimation, noise=noise, options=AT_REST)]
    for text in candidates:
        extended = grey[0]
        for name in text.split("+"):
            extended = try_effect(extended, name.strip(), nominal=local).larger
        grey.append(extended)
    # Black boxes see the record itself: the FMU's own inputs and the outputs that were measured.
    measured = [o for o in plant.outputs if any(o.name in e.outputs for e in prepared.records)]
    black, findings = (
        fit_black_boxes(
            prepared.records,
            [o.name for o in measured],
            [i.name for i in plant.inputs],
            units={i.name: i.unit for i in plant.inputs} | {o.name: o.unit for o in measured},
        )
        if plant.inputs
        else ((), ())
    )
    return compare_named(
        [*(NamedModel(each.model.title, each) for each in grey), *black],
        prepared.validation,
        prepared.estimation,
        skip=skip,
        beginning=beginning,
        # One step is always compared.
        steps=[k for k in steps if k],
        findings=findings,
    )


def _sum_costs(kernels: Sequence[PlantKernel], records: Sequence[Experiment]) -> dict[str, Any]:
    """The runs of all of ``kernels``, their failures, and their rows over those of the records."""
    rows = sum(kernel.rows for kernel in kernels) / sum(record.rows for record in records)
    return {
        "runs": sum(kernel.runs for kernel in kernels),
        "failures": sum(kernel.failures for kernel in kernels),
        "equivalents": rows,
    }


def _extend(
    kernel: PlantKernel,
    seen: Sequence[Experiment],
    local: LocalModel,
    recorded: Sequence[Experiment] | None = None,
) -> tuple[Experiment, ...]:
    """The records with runs of the plant; ``seen`` have the inputs that it sees, ``recorded`` those that were measured."""
    labels = [i.name for i in local.plant.inputs]
    extended = []
    for driven, record in zip(seen, recorded or seen, strict=True):
        run, slopes = kernel.run_experiment(driven), kernel.differentiate_experiment(driven)
        applied = np.column_stack([driven.inputs[name] for name in labels]) if labels else None
        extended.append(extend_record(record, local, run, slopes, applied))
    return tuple(extended)


# Steps a row in which an input that an effect with memory changes is averaged.
FMU_RESPONSE_REFINED = 8


def _apply(
    records: Sequence[Experiment],
    extended: Sequence[Experiment],
    model: Model,
    plant: PlantModel,
) -> tuple[Experiment, ...]:
    """The records with their inputs as they arrive behind the effects: the mean over each interval where they are held."""
    labels = [i.name for i in plant.inputs]
    if not labels:
        return tuple(records)
    result = []
    for record, full in zip(records, extended, strict=True):
        # The record with so many rows for each of its own.
        parts, steps = FMU_RESPONSE_REFINED, np.append(full.intervals, full.intervals[-1:])
        time = (full.time[:, None] + steps[:, None] * np.arange(parts) / parts).ravel()
        held = full.hold == "zero"
        inputs = {n: np.repeat(v, parts) if held else np.interp(time, full.time, v) for n, v in full.inputs.items()}
        run = simulate(model, Experiment(full.name, time, inputs, {}, full.hold))
        arriving = {}
        for name in labels:
            values = run.outputs[name_arriving(name)]
            if record.hold == "zero":
                ends = np.append(values[1:], values[-1:])
                # At a row of the record a step belongs to the interval that begins there.
                is_last = np.arange(len(values)) % parts == parts - 1
                means = np.where(is_last, values, (values + ends) / 2)
                arriving[name] = means.reshape(record.rows, -1).mean(axis=1)
            else:
                arriving[name] = values[::parts]
        result.append(replace(record, inputs={**record.inputs, **arriving}))
    return tuple(result)


def _add(model: Model, effects: Sequence[Effect]) -> Model:
    for effect in effects:
        model = model + effect
    return model
