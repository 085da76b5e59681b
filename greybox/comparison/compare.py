"""`compare`: physical and black-box models on the same rows of the same records."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from greybox.comparison.black_box_runs import run_black_box
from greybox.comparison.grey_box_runs import (
    choose_predictor,
    compute_feedthrough,
    is_stable,
    resolve_options,
    run_grey_box,
)
from greybox.comparison.result import (
    BlackBoxModel,
    Comparison,
    ComparisonEntry,
    ComparisonRun,
    ComparisonScore,
    compute_score,
)
from greybox.errors import DataError
from greybox.estimation import FitOptions
from greybox.experiment import Experiment
from greybox.model import Model
from greybox.residuals.scores import check_steps_ahead
from greybox.result import Fit

FEWEST_JUDGED = 2  # rows of a validation record that must be left

ComparedModel = Model | Fit | BlackBoxModel | Sequence[BlackBoxModel]


@dataclass(frozen=True, eq=False)
class NamedModel:
    """A contestant with its name and the seconds it took to fit."""

    name: str
    model: ComparedModel
    seconds: float = 0.0
    notes: tuple[str, ...] = ()


def compare(
    models: Sequence[ComparedModel] | Mapping[str, ComparedModel],
    experiments: Experiment | Sequence[Experiment] = (),
    *,
    training: Experiment | Sequence[Experiment] = (),
    skip: int = 0,
    steps: Sequence[int] = (),
    options: FitOptions | None = None,
    units: Mapping[str, str] | None = None,
) -> Comparison:
    """Judge models by their free run and their prediction one sample ahead over the ``experiments``, without the first ``skip`` rows.

    ``models``: physical models and fits, black-box models (`arx`, `armax`, `output_error`, `box_jenkins`, `hammerstein`,
    `monte_carlo_smoothing`), and lists of black-box models that stand for one output each; as a list, or with names. ``training``:
    the records they were fitted to, which are judged apart and tell BIC; without any those of the fits among ``models``.

    The initial state of each record of ``experiments`` is estimated from its first ``skip`` (or 50) rows, for every model in the same
    way, or is rest with ``options.at_rest`` (None: the options of each fit; a black box is at rest where any fit is). ``units``:
    output -> unit; those of the physical models are known. ``steps``: further samples ahead, at which predictions are judged too.

    Raises DataError where there is nothing to compare or to compare on, and for names given twice.
    """
    entered = [
        NamedModel(name, model)
        for name, model in (models.items() if isinstance(models, Mapping) else ((_name(m), m) for m in models))
    ]
    return compare_named(
        entered, _group(experiments), _group(training), skip=skip, steps=steps, options=options, units=units
    )


def compare_named(
    entered: Sequence[NamedModel],
    judging: Sequence[Experiment],
    training: Sequence[Experiment],
    *,
    skip: int = 0,
    steps: Sequence[int] = (),
    options: FitOptions | None = None,
    units: Mapping[str, str] | None = None,
    notes: tuple[str, ...] = (),
) -> Comparison:
    """`compare` for contestants that have their names."""
    if not entered:
        raise DataError("no model to compare; give at least one")
    names = [named.name for named in entered]
    twice = sorted({n for n in names if names.count(n) > 1})
    if twice:
        raise DataError(f"models of the same name: {', '.join(twice)}; give a dictionary of names and models")
    fits = [named.model for named in entered if isinstance(named.model, Fit)]
    training = training or (tuple(t.experiment for t in fits[0].traces) if fits else ())
    if not judging and not training:
        raise DataError("no record to compare on; give experiments, or the training records")
    shortest = min((e.rows for e in judging), default=skip + FEWEST_JUDGED)
    if skip < 0 or shortest - skip < FEWEST_JUDGED:
        raise DataError(f"skip: {skip} rows, but the shortest record has {shortest}; leave out fewer rows")
    for group in (judging, training):
        check_steps_ahead(steps, group)
    at_rest = options.at_rest if options is not None else any(resolve_options(f, None).at_rest for f in fits)
    known = _units(entered, units or {})
    further = tuple(sorted({int(k) for k in steps} - {1}))
    entries = tuple(_entry(named, judging, training, skip, further, options, at_rest, known) for named in entered)
    outputs = dict.fromkeys(name for e in entries for name in (*e.training, *e.validation))
    return Comparison(
        entries, {name: known.get(name, "") for name in outputs}, tuple(e.name for e in training),
        tuple(e.name for e in judging), skip, notes,
    )  # fmt: skip


def _entry(
    named: NamedModel,
    judging: Sequence[Experiment],
    training: Sequence[Experiment],
    skip: int,
    steps: Sequence[int],
    options: FitOptions | None,
    at_rest: bool,
    units: Mapping[str, str],
) -> ComparisonEntry:
    model = named.model
    if isinstance(model, (Model, Fit)):
        choice, ahead = (
            resolve_options(model, options),
            choose_predictor(model, sum(e.rows for e in (*training, *judging))),
        )
        fitted, judged = (
            run_grey_box(model, group, training=own, skip=0 if own else skip, options=choice, ahead=ahead, steps=steps)
            for group, own in ((training, True), (judging, False))
        )
        plant = model.model if isinstance(model, Fit) else model
        corrected = (f"predictions corrected by: {ahead.correction.words}",) if ahead else ()
        return _scored(
            named, "grey", fitted, judged, units, parameters=len(plant.free_parameters),
            structure={o.name: plant.title for o in plant.outputs}, stable=is_stable(plant, [*fitted, *judged]),
            feedthrough=compute_feedthrough(plant), notes=(*named.notes, *_troubles(model), *corrected),
        )  # fmt: skip
    boxes = tuple(model) if isinstance(model, Sequence) else (model,)
    fitted, judged = (
        [r for box in boxes for r in run_black_box(box, group, training=own, skip=skip, at_rest=at_rest, steps=steps)]
        for group, own in ((training, True), (judging, False))
    )
    direct = {f"{b.output}/{name}": share for b in boxes for name, share in b.feedthrough.items() if share}
    return _scored(
        named, "black", fitted, judged, units, parameters=sum(b.parameters for b in boxes),
        structure={b.output: b.label for b in boxes}, stable=all(b.stable for b in boxes), feedthrough=direct,
        notes=(*named.notes, *(note for b in boxes for note in b.notes)),
    )  # fmt: skip


def _scored(
    named: NamedModel,
    kind: str,
    fitted: Sequence[ComparisonRun],
    judged: Sequence[ComparisonRun],
    units: Mapping[str, str],
    *,
    parameters: int,
    **facts: object,
) -> ComparisonEntry:
    def scores(runs: Sequence[ComparisonRun]) -> dict[str, ComparisonScore]:
        outputs = dict.fromkeys(run.output for run in runs)
        return {name: compute_score([r for r in runs if r.output == name], units.get(name, "")) for name in outputs}

    by_record: dict[str, dict[str, ComparisonScore]] = {}
    for run in (*fitted, *judged):
        by_record.setdefault(run.record, {})[run.output] = compute_score([run], units.get(run.output, ""))
    training = scores(fitted)
    return ComparisonEntry(
        named.name, kind, parameters=parameters, training=training, validation=scores(judged), records=by_record,  # type: ignore[arg-type]
        bic=_bic(training, parameters), seconds=named.seconds, training_runs=tuple(fitted), validation_runs=tuple(judged),
        **facts,  # type: ignore[arg-type]
    )  # fmt: skip


def _bic(training: Mapping[str, ComparisonScore], parameters: int) -> float:
    """``sum N ln(mean square free-run error) + p ln(sum N)``; NaN without training records."""
    count = sum(s.samples for s in training.values())
    if not count:
        return np.nan
    with np.errstate(divide="ignore"):
        fit = sum(s.samples * np.log(s.rmse**2) for s in training.values() if s.samples)
    return float(fit + parameters * np.log(count))


def _troubles(model: Model | Fit) -> tuple[str, ...]:
    return (
        (f"the fit did not succeed: {model.solver.status_message}",)
        if isinstance(model, Fit) and not model.success
        else ()
    )


def _units(entered: Sequence[NamedModel], given: Mapping[str, str]) -> dict[str, str]:
    known: dict[str, str] = {}
    for named in entered:
        plant = named.model.model if isinstance(named.model, Fit) else named.model
        if isinstance(plant, Model):
            known |= {o.name: o.unit for o in plant.outputs}
    return {**known, **given}


def _name(model: ComparedModel) -> str:
    if isinstance(model, Fit):
        return model.model.title
    if isinstance(model, Model):
        return model.title
    return (model[0] if isinstance(model, Sequence) else model).kind.replace(" ", "_").replace("-", "_")


def _group(experiments: Experiment | Sequence[Experiment]) -> tuple[Experiment, ...]:
    return (experiments,) if isinstance(experiments, Experiment) else tuple(experiments)
