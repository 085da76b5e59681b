"""`compare`: physical and black-box models on the same rows of the same records."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np

from greybox.base.errors import DataError
from greybox.base.numerics import INTEGRATING_POLE
from greybox.base.values import Finding, Severity, with_code
from greybox.comparison import result
from greybox.comparison.blackbox.polynomial import InitialChoice
from greybox.comparison.blackbox.resample import match_sampling_time
from greybox.data.data_frame import Frame
from greybox.data.experiment import Experiment, name_records
from greybox.data.read import as_experiments
from greybox.estimation.errors import OutputRun, PredictionsAhead
from greybox.estimation.optimum import has_free_run
from greybox.estimation.options import FitOptions, explain_unknown
from greybox.estimation.predictor import PredictionCorrection, Predictor, predictor
from greybox.estimation.result import Fit
from greybox.estimation.result_parts import Trace
from greybox.estimation.score import check_steps_ahead, colour_correction, run_model
from greybox.estimation.validate import FIRST_ROWS
from greybox.model.model import Model
from greybox.simulation.free_run import linearise_along
from greybox.simulation.plant import PlantModel, as_model
from greybox.simulation.simulate import declared_initial_state

# What a comparison comes to: the best model of each output, and what to keep in mind of the others.

MEASURES = {"free_run": "rmse", "one_step": "one_step_rmse"}  # what is compared -> the field of a score


def judge_comparison(comparison: result.Comparison) -> tuple[Finding, ...]:
    """Best model of each output in the free run and one sample ahead, by how much, and what to keep in mind.

    Parameters
    ----------
    comparison
        Models with their scores.

    Returns
    -------
    tuple of Finding
        One `ComparisonFinding.BEST_MODEL` for each output and measure, then the remarks.
    """
    findings = [
        finding
        for output in comparison.outputs
        for measure in MEASURES
        if (finding := _find_best(comparison, output, measure)) is not None
    ]
    # What to keep in mind of the others.
    entries = comparison.standing
    outputs = {e.name: sorted(e.training) for e in entries if np.isfinite(e.bic)}
    failed = [e.name for e in entries if with_code(e.findings, result.ComparisonFinding.FIT_FAILED)]
    remarks: list[tuple[result.ComparisonFinding, dict[str, Any]]] = [
        (result.ComparisonFinding.UNSTABLE_MODELS, {"models": [e.name for e in entries if not e.stable]}),
        (result.ComparisonFinding.FEEDTHROUGH_MODELS, {"models": [e.name for e in entries if e.feedthrough]}),
        (
            result.ComparisonFinding.BIC_OF_DIFFERENT_OUTPUTS,
            {"outputs": outputs if len({*map(tuple, outputs.values())}) > 1 else {}},
        ),
        (result.ComparisonFinding.FAILED_FITS, {"models": failed}),
        (result.ComparisonFinding.FAILED_MODELS, {"models": [e.name for e in comparison.entries if e.failed_outputs]}),
    ]
    return (
        *findings,
        *(Finding(code, Severity.WARNING, values=values) for code, values in remarks if any(values.values())),
    )


# Relative difference of two errors that counts as none.
EQUALLY_GOOD = 0.02


def _find_best(comparison: result.Comparison, output: str, measure: str) -> Finding | None:
    ranked = []
    for entry in comparison.standing:
        scores = comparison.deciding_scores(entry)
        if output in scores and np.isfinite(error := getattr(scores[output], MEASURES[measure])):
            ranked.append((error, entry))
    if not ranked:
        return None
    ranked.sort(key=lambda pair: pair[0])
    least, best = ranked[0]
    # The rival that matters: the best model of the other kind.
    other_kind = result.BoxKind.BLACK if best.kind == result.BoxKind.GREY else result.BoxKind.GREY
    values = {
        "measure": measure,
        "records": "validation" if comparison.validation else "training",
        "unit": comparison.outputs[output],
        "model": _identify(best),
        "error": least,
        "other_kind": str(other_kind),
    }
    rivals = [(error, entry) for error, entry in ranked if entry.kind == other_kind]
    if rivals:
        error, rival = rivals[0]
        equal = bool(error <= (1 + EQUALLY_GOOD) * least)
        values |= {"rival": _identify(rival), "rival_error": error, "equally_good": equal, "tolerance": EQUALLY_GOOD}
    return Finding(result.ComparisonFinding.BEST_MODEL, subject=output, values=values)


def _identify(entry: result.ComparisonEntry) -> dict[str, str | int]:
    return {"name": entry.name, "kind": str(entry.kind), "parameters": entry.parameters}


ComparedModel = Model | Fit | result.BlackBoxModel | Sequence[result.BlackBoxModel]


@dataclass(frozen=True, eq=False)
class NamedModel:
    """A model with its name, the seconds that its fit took, and what one should know of it."""

    name: str
    model: ComparedModel
    seconds: float = 0.0
    findings: tuple[Finding, ...] = ()


# Rows of a validation record that must be left after ``skip``.
COMPARISON_FEWEST_ROWS = 2


@explain_unknown
def compare(
    models: Sequence[ComparedModel | NamedModel] | Mapping[str, ComparedModel],
    experiments: Experiment | Frame | Sequence[Experiment | Frame] = (),
    *,
    training: Experiment | Frame | Sequence[Experiment | Frame] = (),
    skip: int = 0,
    beginning: int = 0,
    steps: Sequence[int] = (),
    options: FitOptions | None = None,
    units: Mapping[str, str] | None = None,
) -> result.Comparison:
    """Compare models by their free run and their prediction one sample ahead.

    Parameters
    ----------
    models
        Physical models and fits, black-box models (`greybox.blackbox`), and lists of black-box models that stand for one output
        each; as a list, with names of their own or not, or by name.
    experiments
        The validation records.
    training
        The estimation records: their errors are kept apart and give BIC. None: those of the fits among ``models``.
    skip
        Rows at the start of each validation record that do not count. The initial state of each is estimated from these (0: from
        the first 50), that of a physical model from more where these do not determine it.
    beginning
        Rows from which the initial state is estimated instead, not counted either.
    steps
        Further samples ahead at which predictions are compared.
    options
        How physical models are simulated; None: the options of each fit. With ``at_rest`` the initial state is rest; a black box
        is at rest where any fit is.
    units
        Output -> unit; those of the physical models are known.

    Returns
    -------
    Comparison
        Scores, stability and feed-through of each model, and the verdict.

    Raises
    ------
    DataError
        Where there is nothing to compare or to compare on, and for names given twice.

    Examples
    --------
    >>> comparison = gb.compare({"physics": fit, "arx": arx}, validation, training=record)  # doctest: +SKIP
    >>> print(comparison)  # doctest: +SKIP
    >>> comparison["physics"].validation["x"].rmse  # doctest: +SKIP
    """

    def name_of(model: ComparedModel) -> str:
        """Its title, or the kind of a black box."""
        if isinstance(model, (Fit, Model)):
            return as_model(model).title
        return (model[0] if isinstance(model, Sequence) else model).kind.replace(" ", "_").replace("-", "_")

    if isinstance(models, Mapping):
        entered = [NamedModel(name, model) for name, model in models.items()]
    else:
        entered = [m if isinstance(m, NamedModel) else NamedModel(name_of(m), m) for m in models]
    # A table has the columns of the physical model.
    plant = next((as_model(named.model) for named in entered if isinstance(named.model, (Fit, Model))), None)
    judges, learnt = (
        name_records(as_experiments(records, plant) if plant else records)  # type: ignore[arg-type]  # which refuses a table
        for records in (experiments, training)
    )
    if not entered:
        raise DataError("no model to compare; give at least one")
    names = [named.name for named in entered]
    duplicates = sorted({n for n in names if names.count(n) > 1})
    if duplicates:
        raise DataError(f"models of the same name: {', '.join(duplicates)}; give a dictionary of names and models")
    fits = [named.model for named in entered if isinstance(named.model, Fit)]
    learnt = learnt or (tuple(t.experiment for t in fits[0].traces) if fits else ())
    if not judges and not learnt:
        raise DataError("no record to compare on; give experiments, or the training records")
    # Rows that determine the initial state are not judged as well.
    skip = max(skip, beginning)
    shortest = min((e.rows for e in judges), default=skip + COMPARISON_FEWEST_ROWS)
    if skip < 0 or shortest - skip < COMPARISON_FEWEST_ROWS:
        raise DataError(f"skip: {skip} rows, but the shortest record has {shortest}; leave out fewer rows")
    for group in (judges, learnt):
        check_steps_ahead(steps, group)
    # The same beginning for all models: a difference in it would look like one of the models.
    at_rest = (
        options.at_rest
        if options is not None
        else any(FitOptions.from_data(f.provenance.options).at_rest for f in fits)
    )
    stated = [as_model(named.model) for named in entered if isinstance(named.model, (Model, Fit))]
    known_units = {o.name: o.unit for model in stated for o in model.outputs} | dict(units or {})
    setup = _Setup(
        judges,
        learnt,
        skip,
        beginning,
        tuple(sorted({int(k) for k in steps} - {1})),
        options,
        at_rest,
        known_units,
    )
    entries = tuple(
        _black_box_entry(named, setup)
        if not isinstance(named.model, (Model, Fit))
        else _grey_box_entry(named, named.model, setup)
        for named in entered
    )
    outputs = dict.fromkeys(name for e in entries for name in (*e.training, *e.validation))
    comparison = result.Comparison(
        entries,
        {name: known_units.get(name, "") for name in outputs},
        tuple(e.name for e in learnt),
        tuple(e.name for e in judges),
        skip,
        options=options,
    )
    return replace(comparison, verdict=judge_comparison(comparison))


@dataclass(frozen=True, eq=False)
class _Setup:
    """What every model is compared under."""

    validation: tuple[Experiment, ...]
    training: tuple[Experiment, ...]
    skip: int
    beginning: int
    steps: tuple[int, ...]
    options: FitOptions | None
    at_rest: bool
    units: Mapping[str, str]


# Rows of all records up to which the best prediction filter is searched for; the search takes longer with more.
FILTERED_ROWS = 50000


def _grey_box_entry(named: NamedModel, model: Model | Fit, setup: _Setup) -> result.ComparisonEntry:
    """A physical model: a record that a fit was made of keeps the initial state of that fit, others are run as by `validate`."""
    plant, findings = as_model(model), list(named.findings)
    correction: Predictor | PredictionCorrection | None = None
    known: Sequence[Trace] = ()
    if isinstance(model, Fit):
        known = model.traces if has_free_run(model) else ()
        rows = sum(e.rows for e in (*setup.training, *setup.validation)) + sum(len(t.time) for t in model.traces)
        # Corrections are learnt on the estimation records: the one judged has no part in it.
        filtered = model.success and not model.constraints.per_experiment and not isinstance(plant, PlantModel)
        correction = predictor(model) if filtered and rows <= FILTERED_ROWS else colour_correction(model)
        if not model.success:
            values = {"status": str(model.status)}
            findings.append(Finding(result.ComparisonFinding.FIT_FAILED, Severity.ERROR, named.name, values))
    if isinstance(correction, Predictor):
        values = {"filter": str(correction.correction)}
        findings.append(Finding(result.ComparisonFinding.PREDICTION_FILTER, subject=named.name, values=values))
    steps, begin = (1, *setup.steps), setup.beginning
    fitted = run_model(model, setup.training, steps, correction, known, initial_rows=begin, options=setup.options)
    validated = run_model(
        model, setup.validation, steps, correction, skip=setup.skip, initial_rows=begin, options=setup.options
    )
    stable, feedthrough = all(np.isfinite(run.simulated).all() for run in (*fitted, *validated)), {}
    if not isinstance(plant, PlantModel):
        p, u = np.array(list(plant.values.values())), np.zeros((1, len(plant.inputs)))
        a, _, _, (direct, *_) = linearise_along(plant.system, declared_initial_state(plant)[None], u, p)
        if plant.system.linear:
            eigenvalues = np.linalg.eigvals(a[0])
            # An integrator's eigenvalue is zero but for rounding: it counts as stable.
            stable = bool((eigenvalues.real <= INTEGRATING_POLE * np.abs(eigenvalues).max(initial=0.0)).all())
        feedthrough = {
            f"{o.name}/{i.name}": float(direct[j, k])
            for j, o in enumerate(plant.outputs)
            for k, i in enumerate(plant.inputs)
            if direct[j, k]
        }
    return _assemble_entry(
        named,
        result.BoxKind.GREY,
        structure={o.name: plant.title for o in plant.outputs},
        parameters=len(plant.free_parameters),
        stable=stable,
        feedthrough=feedthrough,
        findings=findings,
        runs=(fitted, validated),
        units=setup.units,
    )


def _black_box_entry(named: NamedModel, setup: _Setup) -> result.ComparisonEntry:
    """Black boxes of one output each, every record on the time grid that each was identified at.

    The initial state comes from all rows of an estimation record, and from the first rows of another, or it is rest.
    """
    model = named.model
    boxes: tuple[result.BlackBoxModel, ...] = tuple(model) if isinstance(model, Sequence) else (model,)  # type: ignore[assignment]
    runs: tuple[list[OutputRun], list[OutputRun]] = ([], [])
    for group, records, training in zip(runs, (setup.training, setup.validation), (True, False), strict=True):
        for box, experiment in product(boxes, records):
            if box.output not in experiment.outputs or not np.isfinite(experiment.outputs[box.output]).any():
                continue
            record = match_sampling_time(experiment, box.output, box.sampling_time, box.label)
            # Rows count in the record as it was given: one resampled has others for the same time.
            rows = setup.beginning or setup.skip or FIRST_ROWS
            begin = {
                "initial": _choose_beginning(box, record, setup.at_rest),
                "rows": None if training else max(1, round(record.rows / experiment.rows * rows)),
            }
            first_time = experiment.time[min(setup.skip, experiment.rows - 1)]
            skip = 0 if training else int(np.searchsorted(record.time, first_time))
            # Neither run nor predictions are kept: as many of them as there are models would be larger than the record.
            ahead = PredictionsAhead((1, *setup.steps), partial(_predict_box, box, record, begin))
            free = partial(_run_box, box, record, begin)
            measured = record.outputs[box.output]
            group.append(OutputRun(record.name, box.output, record.time, measured, free, skip, ahead))
    return _assemble_entry(
        named,
        result.BoxKind.BLACK,
        structure={b.output: b.label for b in boxes},
        parameters=sum(b.parameters for b in boxes),
        stable=all(b.stable for b in boxes),
        feedthrough={f"{b.output}/{name}": share for b in boxes for name, share in b.feedthrough.items() if share},
        findings=[*named.findings, *(finding for b in boxes for finding in b.findings)],
        runs=runs,
        units=setup.units,
    )


# Share of its range by which an output may begin away from where a model rests.
REST_SHARE = 0.1


def _choose_beginning(box: result.BlackBoxModel, record: Experiment, at_rest: bool) -> InitialChoice:
    """Rest is a statement about states, not about zero: a box that was fitted from rest begins there if the record does."""
    if not at_rest or box.history != "zero":
        return "estimated"
    y = record.outputs[box.output]
    away = y[np.argmax(np.isfinite(y))] - getattr(box, "rest", 0.0)
    return "zero" if abs(away) <= REST_SHARE * (np.nanmax(y) - np.nanmin(y)) else "estimated"


def _run_box(box: result.BlackBoxModel, record: Experiment, begin: Mapping[str, Any]) -> np.ndarray:
    return box.simulate(record, **begin)[box.output]


def _predict_box(box: result.BlackBoxModel, record: Experiment, begin: Mapping[str, Any], steps: int) -> np.ndarray:
    return box.predict(record, steps=steps, **begin)[box.output]


# A free run over a record for validation that errs by so many times the output's movement has left it: no error worth a comparison.
DIVERGING_ERROR = 10.0


def find_failures(
    training: Mapping[str, result.ComparisonScore], validation: Mapping[str, result.ComparisonScore]
) -> list[Finding]:
    """A finding for each output that a constant follows better on the estimation records, or from which a validation run goes away."""
    groups = (
        (result.ComparisonFinding.WORSE_THAN_CONSTANT, training, 1 + EQUALLY_GOOD),
        (result.ComparisonFinding.DIVERGED, validation, DIVERGING_ERROR),
    )
    return [
        Finding(code, Severity.WARNING, output, {"error": s.rmse, "movement": s.movement, "unit": s.unit})
        for code, scores, limit in groups
        for output, s in scores.items()
        if s.samples and not s.rmse <= limit * s.movement
    ]


def _assemble_entry(
    named: NamedModel,
    kind: result.BoxKind,
    *,
    structure: Mapping[str, str],
    parameters: int,
    stable: bool,
    feedthrough: Mapping[str, float],
    findings: Sequence[Finding],
    runs: tuple[Sequence[OutputRun], Sequence[OutputRun]],
    units: Mapping[str, str],
) -> result.ComparisonEntry:
    """A model with the scores of its runs over the estimation and the validation records."""

    records: dict[str, dict[str, result.ComparisonScore]] = {}

    def score_outputs(runs: Sequence[OutputRun]) -> dict[str, result.ComparisonScore]:
        scores = {}
        for name in dict.fromkeys(run.output for run in runs):
            of_output, unit = [run for run in runs if run.output == name], units.get(name, "")
            scores[name] = result.ComparisonScore.of(of_output, unit)
            for run in of_output:
                # That of a single record is that of them all.
                alone = scores[name] if len(of_output) == 1 else result.ComparisonScore.of([run], unit)
                records.setdefault(run.record, {})[name] = alone
        return scores

    training, validation = map(score_outputs, runs)
    count, bic = sum(s.samples for s in training.values()), np.nan
    if count:
        with np.errstate(divide="ignore"):
            # Outputs have their own noise: N ln V each, one price p ln N for all parameters.
            misfit = sum(s.samples * np.log(s.rmse**2) for s in training.values() if s.samples)
        bic = float(misfit + parameters * np.log(count))
    findings = [*findings, *find_failures(training, validation)]
    return result.ComparisonEntry(
        named.name,
        kind,
        structure,
        parameters,
        training,
        validation,
        records,
        bic,
        stable,
        feedthrough,
        named.seconds,
        tuple(findings),
        tuple(runs[0]),
        tuple(runs[1]),
    )
