"""Effects at the inputs and outputs of an FMU: looked for on its local model, and fitted with the FMU itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

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
from greybox.extensions.fmu.description import FmuPlant
from greybox.extensions.fmu.fit_fmu import FMU_FIT_FILE, FmuFit, FmuObjective, choose_sizes, compute_misfits
from greybox.extensions.fmu.local_model import (
    LocalModel,
    build_local_model,
    collect_runs,
    estimate_linear_response,
    extend_record,
    name_arriving,
)
from greybox.extensions.fmu.simulator import FmuRunError, FmuSimulator
from greybox.model.effect import Effect
from greybox.model.model import Model
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
    """

    fit: FmuFit
    local: LocalModel
    estimation: tuple[Experiment, ...]
    validation: tuple[Experiment, ...]
    records: tuple[Experiment, ...]
    others: tuple[Experiment, ...]
    runs: int
    failures: int


@dataclass(frozen=True, eq=False)
class FmuEffectFit(Printable, StoredResult):
    """Effects and parameters fitted with the FMU itself.

    Parameters
    ----------
    plant
        The FMU.
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

    plant: FmuPlant
    effects: tuple[str, ...]
    fit: Fit
    misfits: Mapping[str, Misfit]
    validation: Mapping[str, Misfit]
    rounds: int
    agrees: bool
    prepared: PreparedFmu

    FILE: ClassVar[FileKind] = FMU_FIT_FILE
    KEYS: ClassVar[str] = """
        fmu!=plant.file_name effects status! parameters! misfit=misfits validation runs! failures=prepared.failures rounds
        """

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
    with_effects: FmuEffectFit | None
    runs: int


def prepare_fmu(
    result: FmuFit,
    estimation: Experiment | Sequence[Experiment],
    validation: Experiment | Sequence[Experiment] = (),
) -> PreparedFmu:
    """A fitted FMU as a model that can be checked, compared and searched for effects like any other.

    Parameters
    ----------
    result
        The fit, see `fit_fmu`.
    estimation, validation
        The records.

    Returns
    -------
    PreparedFmu
        The model, and the records extended by what it takes from runs of the FMU.

    Raises
    ------
    FmuRunError
        Where the FMU does not run over a validation record.
    """
    records, others = as_records(estimation), as_records(validation)
    with FmuSimulator(result.plant) as simulator:
        objective, z = _restore_objective(result, simulator, records)
        longest = max(records, key=lambda record: record.rows)
        answer = estimate_linear_response(simulator, objective.settings(z), longest)
        local = build_local_model(objective, z, answer)
        groups = [_extend(objective.over(group), z, local) if group else () for group in (records, others)]
        runs, failures = simulator.runs, simulator.failures
    return PreparedFmu(result, local, groups[0], groups[1], records, others, runs, failures)


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
) -> FmuEffectFit:
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
    FmuEffectFit
        Parameters with intervals, and the misfit of the FMU with the effects.

    Raises
    ------
    FmuRunError
        Where the FMU does not run with the effects.
    """
    result, local, records = prepared.fit, prepared.local, prepared.estimation
    values = dict(start or {})
    std = dict(noise) if noise else None
    with FmuSimulator(result.plant) as simulator:
        objective, z = _restore_objective(result, simulator, prepared.records)
        agrees, rounds = False, 0
        while not agrees and rounds < FMU_RESPONSE_ROUNDS:
            rounds += 1
            model = _add(local.model, effects).start(**values)
            fitted = fit(model, records, noise=std, options=AT_REST)
            names, plain = [v.label for v in objective.unknowns], {q.name for q in local.model.parameters}
            # The next round begins where this one ended; constants of the FMU go into its own run.
            values = {name: e.value for name, e in fitted.parameters.items() if name not in plain}
            z = np.array([fitted.parameters[name].value for name in names]) / objective.sizes
            with_inputs = _add(build_local_model(objective, z, local.response, show_inputs=True).model, effects)
            with_inputs = with_inputs.start(**values)
            behind = _apply(prepared.records, records, with_inputs, result.plant)
            # The response belongs to the parameters: that of others would leave part of what an effect with memory does to an average.
            longest = max(behind, key=lambda record: record.rows)
            answer = estimate_linear_response(simulator, objective.settings(z), longest) or local.response
            local = build_local_model(objective, z, answer)
            # Runs of the FMU with the inputs as they arrive behind the effects: the local model is exact there, not
            # only near by.
            records = _extend(objective.over(behind), z, local, prepared.records)
            model = _add(local.model, effects).start(**values)
            errors = _measure(model, prepared.records, records, result)
            expected = {name: misfit.rmse for name, misfit in fitted.misfit.items()}
            # The FMU itself errs as much as its local model: then what was fitted on that holds for the FMU.
            agrees = all(abs(errors[n].rmse - expected[n]) <= FMU_RESPONSE_SETTLED * expected[n] for n in errors)
        checked: dict[str, Misfit] = {}
        validation: tuple[Experiment, ...] = ()
        if prepared.others:
            behind = _apply(prepared.others, prepared.validation, with_inputs, result.plant)
            validation = _extend(objective.over(behind), z, local, prepared.others)
            checked = _measure(model, prepared.others, validation, result)
        runs, failures = simulator.runs, simulator.failures
    about = replace(prepared, local=local, estimation=records, validation=validation, runs=runs, failures=failures)
    return FmuEffectFit(result.plant, tuple(e.name for e in effects), fitted, errors, checked, rounds, agrees, about)


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

    def search(about: PreparedFmu) -> tuple[Discovery, FmuEffectFit | None]:
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
        except FmuRunError:
            return answer, None

    answer, with_effects = search(prepared)
    runs = prepared.fit.runs + prepared.runs + (with_effects.runs if with_effects else 0)
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
    local, plant = prepared.local.model, prepared.fit.plant
    grey = [fit(local, prepared.estimation, noise=noise, options=AT_REST)]
    for text in candidates:
        extended = grey[0]
        for name in text.split("+"):
            extended = try_effect(extended, name.strip(), nominal=local).larger
        grey.append(extended)
    # Black boxes see the record itself: the FMU's own inputs and the outputs that were measured.
    measured = [o for o in plant.outputs if any(o.label in e.outputs for e in prepared.records)]
    black, findings = (
        fit_black_boxes(
            prepared.records,
            [o.label for o in measured],
            [i.label for i in plant.inputs],
            units={s.label: s.unit for s in (*plant.inputs, *measured)},
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


def _restore_objective(
    result: FmuFit, simulator: FmuSimulator, records: Sequence[Experiment]
) -> tuple[FmuObjective, np.ndarray]:
    unknowns = [result.plant.find(name) for name in result.parameters]
    values = np.array([e.value for e in result.parameters.values()])
    sizes = choose_sizes(unknowns, values)
    return FmuObjective(simulator, unknowns, result.given, records, result.std, sizes), values / sizes


def _extend(
    objective: FmuObjective, z: np.ndarray, local: LocalModel, recorded: Sequence[Experiment] | None = None
) -> tuple[Experiment, ...]:
    """The records with runs of the FMU; ``objective`` has them with the inputs that the FMU sees, ``recorded`` as they were measured."""
    runs, slopes = collect_runs(objective, z)
    labels = [i.label for i in local.plant.inputs]
    extended = []
    for seen, record, run, slope in zip(objective.records, recorded or objective.records, runs, slopes, strict=True):
        applied = np.column_stack([seen.inputs[name] for name in labels]) if labels else None
        extended.append(extend_record(record, local, run, slope, applied))
    return tuple(extended)


# Steps a row in which an input that an effect with memory changes is averaged.
FMU_RESPONSE_REFINED = 8


def _apply(
    records: Sequence[Experiment],
    extended: Sequence[Experiment],
    model: Model,
    plant: FmuPlant,
) -> tuple[Experiment, ...]:
    """The records with their inputs as they arrive behind the effects: the mean over each interval where they are held."""
    labels = [i.label for i in plant.inputs]
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


def _measure(
    model: Model, records: Sequence[Experiment], extended: Sequence[Experiment], result: FmuFit
) -> dict[str, Misfit]:
    """Error of the FMU with the effects: that of the model where it is exact."""
    simulated = {r.name: simulate(model, e).outputs for r, e in zip(records, extended, strict=True)}
    return compute_misfits(result.plant, records, simulated, result.std)
