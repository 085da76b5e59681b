"""`greybox compare`."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from greybox.shell import inputs, options
from greybox.shell.progress import ShowProgress, report_fit, report_starts, show_progress
from greybox.shell.study import Answer, Command, NextCommand, Study
from greybox.shell.terminal import write_report

if TYPE_CHECKING:
    from greybox.base import Finding
    from greybox.comparison.compare import NamedModel
    from greybox.comparison.result import Comparison
    from greybox.data.experiment import Experiment
    from greybox.estimation.result import Fit
    from greybox.model import Model


def compare(study: Study) -> Answer:
    """Fit MODEL and black-box models to the same records, and compare their errors on validation records.

    The black boxes are ARX, ARMAX, output error, Box-Jenkins and Hammerstein models, each chosen by a scan over orders, delays
    and its beginning; and a state-space model by subspace projection where there are several inputs or outputs. Prints the errors
    of the free run and one sample ahead, best fit, number of parameters, BIC, stability, feed-through and time, and the best model
    with its margin. Writes DIR/compare.json and DIR/report.html, a report for the browser.

    greybox compare study.toml runs a study file; --write-study writes one from these options.

    Exit code 0: there is a comparison. 2: bad input, nothing was written. 130: Ctrl-C, nothing was written.
    """
    from greybox.base.parallel.jobs import open_workers
    from greybox.comparison.black_box_candidates import check_sampling_times
    from greybox.comparison.compare import NamedModel
    from greybox.comparison.compare import compare as compare_models

    plain = inputs.build_model(study)
    extensions = [tuple(name.strip() for name in text.split("+")) for text in study.candidates]
    models = [inputs.constrain(inputs.add_effects(plain, names), study) for names in ((), *extensions)]
    inputs.check_substeps(study, models[0])
    folder = inputs.result_folder(study, plain.name)
    records, validation, _ = inputs.read_records(study, plain)
    models = [inputs.with_delays_of_records(model, records, study) for model in models]
    quiet = inputs.read_quiet_records(study, plain)
    inputs.check_skip(study, validation)
    inputs.check_prediction_steps(study, records, validation)
    check_sampling_times(records, validation, [q.name for q in plain.outputs])
    if not study.silent:
        inputs.print_record_notes(records, validation, loss=study.loss)
    fitting = inputs.fit_options(study)
    given = {"noise": dict(study.noise), "quiet": quiet, "options": fitting}
    journal = folder / inputs.STARTS_FILE
    with open_workers(study.workers, study.cluster) as executor, show_progress(study.silent) as show:
        if study.starts > 1:
            given |= {
                "starts": study.starts,
                "seed": study.seed or 0,
                "executor": executor,
                "workers": study.workers,
                "journal": journal,
            }
        fits = [_fit(models[0], records, show, given)]
        for names, model in zip(extensions, models[1:], strict=True):
            grown = _grown(fits[0][0], names, models[0], show) if study.starts == 1 else None
            fits.append(grown or _fit(model, records, show, given))
        black, findings = _black_boxes(plain, records, study.at_rest, show)
        show("judging")
        grey = [NamedModel(fit.model.title, fit, seconds) for fit, seconds in fits]
        compared = compare_models(
            [*grey, *black],
            validation,
            training=records,
            skip=study.skip,
            beginning=study.beginning,
            steps=[k for k in study.predict if k],
            options=fitting,
        )
        result = replace(compared, findings=findings)
    journal.unlink(missing_ok=True)
    by_title = {fit.model.title: fit for fit, _ in fits}
    added = dict(zip((fit.model.title for fit, _ in fits), ((), *extensions), strict=True))
    return _answer(result, folder, records, validation, by_title, _next(study, result, added))


def _next(study: Study, result: Comparison, added: Mapping[str, tuple[str, ...]]) -> NextCommand:
    """The best physical model is fitted for itself; where a black box is better, what it lacks is looked for.

    ``added``: title of each physical model -> the effects that this command has added to it.
    """
    from greybox.show.documents.comparison import best_model

    best = best_model(result)
    if best is None or best.name not in added:
        return study.but(candidates=()).then("discover", study.model, *study.estimation)
    effects = (*study.effects, *added[best.name])
    return study.but(effects=effects).then("fit", study.model, *study.estimation)


def _grown(first: Fit, names: Sequence[str], plain: Model, show: ShowProgress) -> tuple[Fit, float] | None:
    """``first`` refitted with these effects, each from where the records would show it, and the seconds it took.

    An effect's own values leave it absent, and a search from there may end anywhere. None where a refit of free runs is not what
    was asked for, or the extended model overflows from every start.
    """
    from greybox.base import DataError
    from greybox.discovery.effect_test import try_effect

    automatic = first.provenance.options.get("transcription") == "automatic" and first.solver.statistics.get(
        "free_run", True
    )
    if (
        not (first.success and automatic)
        or first.prediction.process_noise
        or first.constraints.per_experiment
        or first.robust.name
    ):
        return None
    began, fit = time.perf_counter(), first
    for name in names:
        show(f"{fit.model.title} + {name}")
        try:
            fit = try_effect(fit, name, nominal=plain).larger
        except DataError:
            return None
    return fit, time.perf_counter() - began


# Relative time that the scan of each kind of black box usually takes.
SCAN_TIMES: Mapping[str, float] = {"arx": 8, "armax": 40, "output error": 33, "box-jenkins": 6, "hammerstein": 13}


def scan_share(what: str, share: float, outputs: Sequence[str]) -> float:
    """Share of all scans that is done, when ``share`` of ``what`` ("armax of x") is, by the time that each kind takes as a rule."""
    kind, _, output = what.rpartition(" of ")
    times = SCAN_TIMES
    kinds = list(times)
    before = sum(times[k] for k in kinds[: kinds.index(kind)])
    return (outputs.index(output) + (before + share * times[kind]) / sum(times.values())) / len(outputs)


def _fit(
    plant: Model, records: Sequence[Experiment], show: ShowProgress, given: Mapping[str, Any]
) -> tuple[Fit, float]:
    """The fit, from several starts where they are ``given``, and the seconds it took."""
    from greybox.estimation.fit import fit
    from greybox.estimation.multistart import multistart

    began = time.perf_counter()
    if "starts" in given:
        many = multistart(plant, records, report=report_starts(plant.title, show), **given)
        if many.interrupted:
            raise KeyboardInterrupt
        result = many.best
    else:
        result = fit(plant, records, report=report_fit(plant.title, show), **given)
    return result, time.perf_counter() - began


def _black_boxes(
    plain: Model, records: Sequence[Experiment], at_rest: bool, show: ShowProgress
) -> tuple[tuple[NamedModel, ...], tuple[Finding, ...]]:
    """The black boxes of every output of ``plain`` that the records measure, and what is to be said about them."""
    from greybox.comparison.black_box_candidates import fit_black_boxes

    measured = [q for q in plain.outputs if any(q.name in e.outputs for e in records)]
    outputs = [q.name for q in measured]
    return fit_black_boxes(
        records,
        outputs,
        [i.name for i in plain.inputs],
        at_rest=at_rest,
        units={i.name: i.unit for i in plain.inputs} | {q.name: q.unit for q in measured},
        report=lambda what, done, of: show(f"{what}: structure {done} of {of}", scan_share(what, done / of, outputs)),
    )


def _answer(
    result: Comparison,
    folder: Path,
    records: Sequence[Experiment],
    validation: Sequence[Experiment],
    fits: Mapping[str, Fit],
    following: NextCommand,
) -> Answer:
    from greybox.base import read_versions, write_json
    from greybox.data.experiment import collect_record_findings
    from greybox.shell.printed import ComparisonAnswer
    from greybox.show.sentences import sentences

    known = sentences(
        collect_record_findings([*records, *validation], is_robust=any(f.robust.name for f in fits.values()))
    )
    fingerprints = {e.name: e.fingerprint for e in (*records, *validation)}
    constants = {title: fit.parameters for title, fit in fits.items()}
    answer = ComparisonAnswer(result, fingerprints, known, constants, read_versions())
    saved = write_json(folder / "compare.json", answer)
    return Answer(
        result,
        files=[saved],
        page=lambda: write_report(result, folder / "report.html", fits=fits, data=fingerprints, known=known),
        pictures=lambda: _draw_pictures(result, folder),
        kept=f"the comparison is in {saved}",
        next=following,
    )


def _draw_pictures(result: Comparison, folder: Path) -> list[Path]:
    from greybox.show.figures.pictures import draw_comparison

    return draw_comparison(result, folder)


COMPARE = Command(
    compare,
    "Compare a physical model with black-box models.",
    (
        *(*options.FITTING, Study.estimation.but(usage="TRAIN", required=True)),
        Study.candidates.but(
            help="Also fit MODEL with each of these effects of the catalogue; A+B adds both effects to one model."
        ),
        Study.output.but(help="Folder for compare.json and the report. [default: results/MODEL-compare]"),
        *(*options.SHARING, *options.SHOWING, Study.silent, Study.figures),
    ),
    (
        "greybox compare micro_actuator step.csv --validate chirp.csv --fix M=0.01 --at-rest",
        "greybox compare silverbox train.csv --validate test.csv --skip 50 --effects cubic_stiffness,cubic_stiffness+input_offset",
    ),
    (*options.FITTING_RULES, *options.sharing(Study.starts)),
)
