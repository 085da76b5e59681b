"""From a study to what the library takes: the model, the records, the options. Every check runs before the computation."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from greybox.base import DataError, ExitCode, Finding, GreyboxError, ModelError, nearest
from greybox.base.texts import to_word
from greybox.shell.plants import find_plant_kind
from greybox.shell.study import Idle, Study
from greybox.shell.terminal import CommandCode, exit_with_error, print_findings, print_note

if TYPE_CHECKING:
    from greybox.data.experiment import Experiment
    from greybox.data.signals import SignalLimit
    from greybox.estimation import Fit, FitOptions
    from greybox.model import Model
    from greybox.model.equations import Statements
    from greybox.simulation.simulate import Simulation


def build_model(study: Study) -> Model:
    """The model of a study: with its schedules, effects and process noise, parameters freed, started and fixed; without
    priors and ties. Raises GreyboxError.
    """
    kind = find_plant_kind(study.model)
    if kind is not None and (objection := Idle(kind.unused, kind.closed).objection(study)):
        raise GreyboxError(objection)
    model = _apply_schedules(find_plain_model(study), study)
    model = add_effects(model, study.effects)
    if study.process_noise:
        known = {state: value for state, value in study.process_noise.items() if value is not None}
        model = model.with_process_noise(*(state for state in study.process_noise if state not in known), **known)
    model = model.with_parts(has=study.has, lacks=study.lacks)
    return kind.set_parameters(model, study) if kind else set_parameters(model, study)


def find_plain_model(study: Study, holder: str = "model") -> Model:
    """The model of a study as it is declared: the one for which the study was written; or as it was fitted, where a fit names it.

    ``holder``: the option that names it.

    Raises
    ------
    DataError
        For a model that was edited since, with both lines, unless the user names it beside the file.
    ModelError
        Where there is no such model.
    """
    from greybox.shell.project import find_model

    if result := find_result(getattr(study, holder)):
        return load_fitted_model(result, study.command)
    model = find_model(getattr(study, holder))
    insist = "" if holder not in study.from_file else f"insist on this one (--model {to_word(getattr(study, holder))})"
    if lines := hold_against(model, study.definition, _list_given(study), str(study.file), insist):
        print_findings(
            [Finding(CommandCode.OTHER_MODEL_IN_STUDY, subject=str(study.file), values={"lines": list(lines)})]
        )
    return model


def hold_against(
    model: Model, stated: Statements, given: Iterable[str], written: str, insist: str = ""
) -> tuple[str, ...]:
    """What ``model`` states otherwise than it did when a study or a program was ``written``, but for constants that are ``given`` there.

    Raises DataError with both lines of each, where it can be said how to ``insist`` on the model.
    """
    from greybox.model.equations import compare_statements, state_whole

    equations, declared = stated
    values = {f"value {name}" for name in given}
    stored = {key: line for key, line in declared.items() if key not in values}
    differences = compare_statements((equations, stored), state_whole(model, {*given})) if equations else ()
    if differences and insist:
        lines = "".join(f"\n  written for: {d.stored or '-'}\n  now:         {d.present or '-'}" for d in differences)
        raise DataError(
            f"{written}: the model {model.title} is not the one that it was written for: write it again, give the model as it was, or"
            f" {insist}{lines}"
        )
    return tuple(map(str, differences))


def state_in_study(model: Model, study: Study) -> Statements:
    """What a model states, with the values of the constants to which the study gives none."""
    from greybox.model.equations import state_whole

    return state_whole(model, _list_given(study))


def _list_given(study: Study) -> set[str]:
    """The constants to which a study gives values."""
    return {*study.fixed, *study.start, *study.free}


def add_effects(model: Model, names: Iterable[str]) -> Model:
    """``model`` with these effects of the catalogue or of the project. Raises GreyboxError."""
    from greybox.shell.own_effects import find_effect

    for name in names:
        model = model + find_effect(name)
    return model


def with_delays_of_records(model: Model, records: Sequence[Experiment], study: Study) -> Model:
    """``model`` whose delays may be as long as these records can show, where the user did not bound them, and start as ``study`` says."""
    from greybox.data.experiment import find_usual_interval
    from greybox.model.effects.scales import bound_delays, list_untailored_delays

    waiting = list_untailored_delays(model)
    model = bound_delays(model, find_usual_interval(records))
    known = {n: v for n, v in study.fixed.items() if n in waiting and v is not None}
    return model.start(**{n: v for n, v in study.start.items() if n in waiting}).fix(**known)


def set_parameters(model: Model, study: Study) -> Model:
    """``model`` with parameters freed, started and fixed as the study has it. Raises ModelError."""
    from greybox.model.effects.scales import list_untailored_delays

    known = {name: value for name, value in study.fixed.items() if value is not None}
    as_declared = [name for name, value in study.fixed.items() if value is None]
    for other, names in (("start", known.keys() & study.start.keys()), ("free", study.fixed.keys() & set(study.free))):
        if names:
            raise ModelError(
                f"{', '.join(sorted(names))}: {study.label('fixed')} and {study.label(other)} contradict each other; keep one"
            )
    model = model.free(*study.free)
    # A delay that only the records bound has its value when they are read.
    waiting = list_untailored_delays(model) if study.estimation else ()
    start, known = ({n: v for n, v in values.items() if n not in waiting} for values in (study.start, known))
    return model.start(**start).fix(*as_declared, **known)


def _apply_schedules(model: Model, study: Study) -> Model:
    for name, (by, at) in study.schedules.items():
        if at is None and by in [i.name for i in model.inputs]:
            label = study.label("schedules")
            raise GreyboxError(
                f"{label} {name}={by}: {by} is an input; give the value at which {name} is valid, as in {label} {name}={by}@2"
            )
        model = model.schedule(name, by=by, about=at)
    return model


def constrain(model: Model, study: Study) -> Model:
    """``model`` with the priors and ties of a study. Raises GreyboxError."""
    both = sorted(q.name for q in model.all_parameters if q.fixed and q.name in study.priors)
    if both:
        raise ModelError(
            f"{study.label('priors')} {', '.join(both)}: fixed in the model or by {study.label('fixed')}, so a prior has no"
            " effect; free it, or leave out one of the two"
        )
    return model.prior(**study.priors).with_ties(dict(study.ties))


def fit_options(study: Study) -> FitOptions:
    """The options of the estimation: those that a study has under the same name."""
    from greybox.estimation.options import FitOptions

    return FitOptions(**{f.name: getattr(study, f.name) for f in fields(FitOptions) if f.name in study.table()})


class Records(NamedTuple):
    """The records of a study by what they are for."""

    estimation: tuple[Experiment, ...]
    validation: tuple[Experiment, ...]
    test: tuple[Experiment, ...]


def read_records(study: Study, model: Model) -> Records:
    """The records, each with its conditions, from its file or from the study.

    Records are split where their time starts anew and at its gaps if the study says so; otherwise a long gap in which the
    input is unknown is refused. Raises GreyboxError.
    """
    from greybox.data.identity import mark_fitted, refuse_repeated

    from_files = {name: None for name, values in study.conditions.items() if values is None}
    given = {name: values for name, values in study.conditions.items() if values is not None}
    files = (study.estimation, study.validation, study.test)
    estimation = read_files(study, study.estimation, model, conditions=from_files)
    # What was found of an input in the records that are fitted holds of those that judge.
    hold = estimation[0].courses if study.hold == "auto" and estimation else study.hold
    judges = [read_files(study, each, model, conditions=from_files, hold=hold) for each in files[1:]]
    refuse_repeated(estimation)
    records = _with_conditions(given, study, Records(estimation, *(mark_fitted(each, estimation) for each in judges)))
    return Records(*split_as_told(study, records, files))


def split_as_told(
    study: Study, records: Sequence[Sequence[Experiment]], files: Sequence[Sequence[Path]]
) -> Sequence[tuple[Experiment, ...]]:
    """Each group of records, read from a group of ``files``, split at the gaps in time if the study says so.

    Raises GreyboxError for a gap that is not split and in which the input is unknown.
    """
    from greybox.data.experiment import refuse_unknown_input

    if not study.split_holes:
        refuse_unknown_input(record for group in records for record in group)
        return [tuple(group) for group in records]
    runs = sum(map(len, records)) - sum(map(len, files))
    pieces, findings = split_records(records, at_rest=study.at_rest, runs=runs)
    print_findings(findings)
    return pieces


def read_files(study: Study, files: Sequence[Path], model: Model, **other: Any) -> tuple[Experiment, ...]:
    """The records in ``files`` as the study says that they are laid out and held, or as ``other`` does. Raises GreyboxError."""
    from greybox.data.read import read_experiments

    if not files:
        return ()
    layout = {"split": study.split_holes, "hold": study.hold, "allow_constant_input": study.free_decay}
    return read_experiments(files, model, **{**layout, **layout_of(study), **other})


def read_quiet_records(study: Study, model: Model) -> tuple[Experiment, ...]:
    """The records with the input at rest, from which the noise is estimated. Raises GreyboxError."""
    from greybox.data.read import WHOLE

    return read_files(study, study.quiet, model, split=False, allow_constant_input=True, window=WHOLE)


def layout_of(study: Study) -> dict[str, Any]:
    """How the files of the records are laid out, and how large they may be, as the readers take it."""
    from greybox.data.policy import READING_POLICY

    layout: dict[str, Any] = {"columns": study.headers or dict(study.columns) or None}
    if study.sampling_time:
        layout["sampling_time"] = study.sampling_time
    if study.interpolation:
        layout["interpolation"] = dict(study.interpolation)
    if study.before:
        layout["before"] = dict(study.before)
    if study.first_time or study.last_time:
        layout["window"] = (study.first_time or None, study.last_time or None)
    if study.read_limit:
        layout["reading"] = READING_POLICY.times(study.read_limit)
    return layout


def _with_conditions(given: Mapping[str, tuple[float, ...]], study: Study, records: Records) -> Records:
    """The records, each with its value of the conditions that the study gives."""
    everything = [record for group in records for record in group]
    fitted, judged, _ = map(len, records)
    for name, values in given.items():
        if len(values) not in (fitted, fitted + judged, len(everything)):
            others = [
                f" and {len(group)} for {role}"
                for role, group in records._asdict().items()
                if role != "estimation" and group
            ]
            raise GreyboxError(
                f"{study.label('conditions')} {name}: {len(values)} values for {fitted} record{'s' * (fitted != 1)}"
                f"{''.join(others)}; give one for each, in their order, separated by commas"
            )
        for k, value in enumerate(values):
            everything[k] = replace(everything[k], conditions={**everything[k].conditions, name: value})
    rest = iter(everything)
    return Records(*(tuple(next(rest) for _ in group) for group in records))


def split_records(
    groups: Sequence[Sequence[Experiment]], *, at_rest: bool, runs: int = 0
) -> tuple[list[tuple[Experiment, ...]], list[Finding]]:
    """Each group with its records split at the gaps in their time, and what is to be said about it.

    ``runs``: splits that were made while the files were read.
    """
    split = [[(record, record.split_at_time_gaps()) for record in group] for group in groups]
    findings = [
        Finding(CommandCode.RECORD_SPLIT, subject=record.source or record.name, values={"pieces": len(pieces)})
        for group in split
        for record, pieces in group
        if pieces != (record,)
    ]
    if findings and at_rest:
        findings.append(Finding(CommandCode.PIECES_AT_REST))
    if not findings and not runs:
        findings.append(Finding(CommandCode.SPLIT_WITHOUT_EFFECT))
    return [tuple(piece for _, pieces in group for piece in pieces) for group in split], findings


def print_record_notes(*groups: Iterable[Experiment], loss: str = "squares") -> None:
    """The findings of records as lines on stderr; records that share a finding share its line.

    A robust ``loss`` is what is to be done about spikes.
    """
    from greybox.data.experiment import collect_record_findings

    records = (record for group in groups for record in group)
    for finding in collect_record_findings(records, is_robust=loss != "squares"):
        print_note(f"note: {finding}")


# Rows of a validation record that must be left after ``--skip``: fewer give no meaningful error.
MINIMUM_VALIDATION_ROWS = 10


def check_skip(study: Study, validation: Sequence[Experiment]) -> None:
    """Refuse to leave out so many rows that a validation record has too few left. Raises GreyboxError."""
    skip, least = study.uncounted, MINIMUM_VALIDATION_ROWS
    if not (skip and validation):
        return
    shortest = min(r.rows for r in validation)
    if shortest - skip < least:
        label = study.label("beginning" if study.beginning > study.skip else "skip")
        raise GreyboxError(
            f"{label} {skip}: the shortest validation record has {shortest} rows, and at least {least} must be left;"
            " leave out fewer"
        )


def check_substeps(study: Study, model: Model) -> None:
    """Say so where the automatic choice may be a method without substeps."""
    if study.substeps and study.method == "automatic" and model.system.linear:
        print_findings([Finding(CommandCode.SUBSTEPS_WITHOUT_EFFECT, values={"substeps": study.substeps})])


def check_prediction_steps(study: Study, *groups: Sequence[Experiment]) -> None:
    """Refuse predictions so far ahead that the records hold nothing to compare with."""
    longest = min((max(e.rows for e in group) for group in groups if group), default=0)
    for k in study.predict:
        if k >= longest > 0:
            raise GreyboxError(
                f"{study.label('predict')} {k}: the longest record has {longest} rows, and the first {k} of each have no"
                " measurement to predict from; predict fewer samples ahead"
            )


# Replicates of a bootstrap: with fewer, each end of a 95 % interval rests on two or three of them.
MINIMUM_REPLICATES = 100


def check_intervals(study: Study, model: Model) -> tuple[str, ...]:
    """The parameters to be profiled, two together as ``A:B``.

    Raises GreyboxError for a parameter that is not fitted, for more than two of them together and for too few replicates.
    """
    free = [q.name for q in model.free_parameters]
    names = tuple(dict.fromkeys(study.profiles))
    for asked in names:
        constants, label = asked.split(":"), f"{study.label('profiles')} {asked}"
        for name in constants:
            if name not in free:
                raise GreyboxError(
                    f"{study.label('profiles')} {name}: no parameter that is fitted; {nearest(name, free)}"
                )
        if len(constants) > 2 or len({*constants}) < len(constants):
            raise GreyboxError(f"{label}: give one parameter, or two different ones as A:B")
        if len(constants) == 2 and (separate := {*constants}.intersection(study.per_experiment)):
            raise GreyboxError(f"{label}: each record has its own {min(separate)}; give two that all records share")
    if 0 < study.bootstrap < MINIMUM_REPLICATES:
        raise GreyboxError(
            f"{study.label('bootstrap')} {study.bootstrap}: too few replicates for a 95 % interval;"
            f" give {MINIMUM_REPLICATES} or more"
        )
    return names


def load_fit_with_model(path: Path, model: str = "") -> Fit:
    """The fit in ``path``. ``model`` names its model or model file ("": the name that the file holds).

    Effects of the catalogue that the fit has and the model lacks are added. Raises DataError for a file that is no fit or whose
    model was edited since, unless the user names that model; ModelError where it cannot be found.
    """
    from greybox.base import read_json
    from greybox.estimation.result import Fit, ResultCode, restore_fit

    if describes_discovery(path):
        raise DataError(
            f"{path}: a discovery, which holds no fit; fit the model that it has written beside it, as in"
            f" greybox fit {to_word(str(path.with_name('model.py')))} train.csv, and give the fit.json of that"
        )
    data = read_json(path, Fit)
    fit = restore_fit(data, find_model_of(path, data["model"], model, data["effects"]), str(path), insist=bool(model))
    print_findings([f for f in fit.findings if f.code in (ResultCode.OTHER_MODEL, ResultCode.OTHER_CONSTANT)])
    return fit


def find_result(named: str) -> Path | None:
    """The fit.json that stands in the place of a model, itself or by its folder; None for anything else."""
    path = Path(named)
    if path.suffix == ".json" and path.is_file():
        return path
    return path / "fit.json" if named and (path / "fit.json").is_file() and not [*path.glob("*.py")] else None


def load_fitted_model(path: Path, command: str) -> Model:
    """The model of the fit in ``path`` with the fitted values. Raises ModelError, with what to type, where it is not found by its name."""
    from greybox.base import read_json
    from greybox.estimation.result import Fit

    if describes_discovery(path):
        return load_fit_with_model(path).model  # refused, with what to type
    data = read_json(path, Fit)
    try:
        find_model_of(path, data["model"], "", data["effects"])
    except ModelError:
        effects = [f"--effect {name}" for name in data["effects"]]
        estimates = data["parameters"].items()
        values = [f"--{'fix' if e['fixed'] else 'start'} {name}={e['value']:.9g}" for name, e in estimates]
        typed = " ".join(("greybox", command, f"{data['model']}.py", *effects, *values))
        raise ModelError(
            f"{path}: its model {data['model']!r} is not found by its name (greybox models); give its file, and these values: {typed}"
        ) from None
    # What else speaks against it (a model that was edited since) is said as it is.
    return load_fit_with_model(path).model


def describes_discovery(path: Path) -> bool:
    """Whether a file is a discovery, which has a verdict. What else is wrong with it is said by whoever reads it."""
    from greybox.base.json_file import parse_json

    if not path.is_file():  # a pipe would be waited for
        return False
    try:
        data: Any = parse_json(path.read_bytes())
    except (OSError, ValueError):
        return False
    return isinstance(data, dict) and "verdict" in data and "effects" in data


def find_model_of(path: Path, named: str, model: str, effects: Iterable[str] = ()) -> Model:
    """The model that the result in ``path`` has ``named``, or ``model``, which the user has named; with ``effects`` of the catalogue.

    A file that a result names in place of a model is not run: only the user may name one. Raises DataError for that, ModelError where
    the model cannot be found.
    """
    from greybox.model.effects.catalogue import effect
    from greybox.shell.project import find_model, runs_code

    if not model and runs_code(named):
        raise DataError(
            f"{path}: its model {named!r} is a file, and a result names its model without a path; give --model MODEL"
        )
    try:
        plant = find_model(model or named)
    except ModelError as error:
        raise ModelError(f"{path}: its model cannot be found: {error}; name its file with --model my/rig.py") from None
    present = [e.name for e in plant.effects]
    for name in effects:
        try:
            plant = plant if name in present else plant + effect(name)
        except ModelError as error:
            # An effect of one's own is in no catalogue: a file has to add it, and a model of that file to be named.
            raise ModelError(
                f"{path}: effect {name!r} of its model is neither in {plant.title} nor in the catalogue ({error}); --model takes a file"
                f" that adds it, such as rig = {plant.name} + {name}"
            ) from None
    return plant


def limits_of(study: Study) -> dict[str, SignalLimit]:
    """Limits and largest rates by signal. Raises GreyboxError."""
    from greybox.data.signals import SignalLimit

    result = {}
    for name in dict.fromkeys([*study.limits, *study.rates]):
        ends = study.limits.get(name, (-math.inf, math.inf))
        try:
            result[name] = SignalLimit(ends[0], ends[1], study.rates.get(name, math.inf))
        except DataError as error:
            raise GreyboxError(f"{name}: {error}") from None
    return result


def refuse_broken_limits(run: Simulation, limits: Mapping[str, SignalLimit]) -> None:
    """End with exit code 1 where a signal of a run leaves its limits. Raises GreyboxError for a signal that the run does not have."""
    import numpy as np

    signals = {**run.states, **run.outputs, **run.inputs}
    for name, limit in limits.items():
        if name not in signals:
            raise GreyboxError(f"--limit {name}: the model has no such signal; {nearest(name, signals)}")
        values = signals[name]
        outside = np.flatnonzero((values < limit.low) | (values > limit.high))
        if len(outside):
            k = outside[0]
            exit_with_error(
                f"{name} = {values[k]:.4g} leaves its limits of {limit.low:g} to {limit.high:g} after {run.time[k]:.4g} s; nothing was"
                " written",
                ExitCode.UNSUCCESSFUL,
            )


# Where results go.

# Finished starts of a command that was interrupted, in its output folder.
STARTS_FILE = "starts.jsonl"


def result_folder(study: Study, model: str) -> Path:
    """The folder of the results: the one that was given, or one called like the model and the command. Raises GreyboxError."""
    return check_writable(study.output or Path("results") / f"{model}-{study.command}")


def check_writable(path: Path, given: str = "--output") -> Path:
    """``path``, if results can be written there; checked before the computation, and not changed. Raises GreyboxError.

    ``given``: the option or argument that names it.
    """
    try:
        present = next(folder for folder in (path, *path.absolute().parents) if folder.exists())
        if not present.is_dir():
            what = "it is a file" if present == path else f"{present} is a file"
            raise GreyboxError(f"{given} {path}: {what}; give a folder")
        # Another process may be about to make the folder, or to write into it: nothing is made that must be removed.
        with tempfile.TemporaryFile(dir=present):
            pass
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise GreyboxError(f"{given} {path}: cannot be written to ({reason}); give another folder") from error
    return path
