"""Results as picture files: which panels stand on one sheet, and the functions that write the sheets as PNG, SVG and PDF."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from greybox.base.figure import Axis, Curve, Dash, Panel, Reference, Role, Scale
from greybox.comparison.result import Comparison
from greybox.estimation import Fit, Misfit, Trace
from greybox.estimation.errors import compute_record_misfits
from greybox.estimation.residuals import ResidualTests
from greybox.show.figures import discovery as search_figures
from greybox.show.figures import records as record_figures
from greybox.show.figures.comparison import judging_records, plot_model_errors, plot_model_residuals, plot_model_runs
from greybox.show.figures.figure import Cell, Sheet, draw_sizes
from greybox.show.figures.fit import plot_residual_tests
from greybox.show.sentences.discovery import surrogate_title
from greybox.show.sentences.wording import ratio_text, record_text

if TYPE_CHECKING:
    from greybox.discovery import Discovery, EffectSignal


def draw_fit(fit: Fit, directory: str | Path, *, skip: int = 0) -> list[Path]:
    """Draw each record of a fit: measured and simulated, the residual below, and a closer look at the liveliest stretch.

    Parameters
    ----------
    fit
        The result of `greybox.fit`.
    directory
        Where ``fit-<record>.png`` and ``validation-<record>.png`` are written, each with an SVG and a PDF beside it.
    skip
        Rows at the start of validation records that do not count in the misfit above the panels.

    Returns
    -------
    list of Path
        The PNG files, in the order of the records.
    """
    return save_sheets(fit_sheets(fit, skip), directory)


def draw_residual_tests(tests: ResidualTests, directory: str | Path, *, title: str = "") -> list[Path]:
    """Draw the tests of each output as ``residual-<output>.png``, each with an SVG and a PDF beside it; returns the PNG files.

    ``title`` stands above, as a rule the name of the model. The panels are those of `plot_residual_tests`.
    """
    sheets = []
    for output in tests.residuals:
        panels = plot_residual_tests(tests, output, "residual").panels
        rows = (len(panels) + 1) // 2
        cells = tuple(Cell(panel, k // 2, k % 2) for k, panel in enumerate(panels))
        heading = f"{title}: residual of {output}" if title else f"Residual of {output}"
        size = (11.0, 3.4 * rows)
        sheets.append(Sheet(f"residual-{output}", cells, heading, size, widths=(1.0, 1.0), heights=(1.0,) * rows))
    return save_sheets(sheets, directory)


def draw_comparison(comparison: Comparison, directory: str | Path) -> list[Path]:
    """Draw each judging record as ``comparison-<record>.png``, each with an SVG and a PDF beside it; returns the PNG files.

    For each output: measured and every model's free run around its liveliest stretch, the errors over the whole record, and bars of
    the free-run and the one-step error, best first.
    """
    sheets = (comparison_sheet(comparison, record) for record in judging_records(comparison))
    return save_sheets(sheets, directory)


def draw_discovery(discovery: Discovery, directory: str | Path) -> list[Path]:
    """Draw a discovery, each picture as PNG with an SVG and a PDF beside it; returns the PNG files.

    ``missing-<effect>`` (or ``missing-unknown``): the signal that the plain model lacks, with the effect's (the surrogate's) through it.
    ``residuals``: the error on the first validation record in time, and its averaged spectrum, before and after. ``candidates``: misfit
    of the refitted candidates. ``gap``: rms error before and after beside the noise.
    """
    sheets = [_effect_signal_sheet(signal) for signal in discovery.effect_signals]
    if discovery.surrogate is not None:
        figure = search_figures.plot_surrogate(discovery.surrogate)
        shape, share = surrogate_title(discovery.surrogate), min(discovery.surrogate.share, 1.0)
        heading = f"Unknown effect: a {shape.removeprefix('a ')} takes {100 * share:.0f} % of the error"
        sheets.append(Sheet("missing-unknown", (Cell(figure.panels[0], 0),), heading, (7.0, 4.2)))
    sheets.append(_before_after_sheet(discovery))
    candidates = search_figures.plot_candidates(discovery)
    if candidates is not None:
        heading = f"Candidates ({discovery.verdict}). {search_figures.describe_candidates(discovery)}"
        height = 1.5 + 0.3 * len(candidates.panels[0].categories)
        sheets.append(Sheet("candidates", (Cell(candidates.panels[0], 0),), heading, (8.5, height)))
    return save_sheets([*sheets, _holdout_error_sheet(discovery)], directory)


def draw_gap(
    before: Trace,
    after: Trace,
    *,
    output: str,
    unit: str,
    noise: float,
    ratios: Mapping[str, float],
    names: tuple[str, str],
    path: str | Path,
) -> list[Path]:
    """Draw how far a record is from its model before and after an effect was added; returns the PNG file.

    Parameters
    ----------
    before, after
        The model's run over a record that was not used for the fit, without and with the effect.
    output, unit
        Of which output, and its unit.
    noise
        Its standard deviation.
    ratios
        Misfit over noise of every model that is to stand in the bars, in their order.
    names
        Of the two models.
    path
        Of the files, without suffix.
    """
    pair, units = (_only(before, output), _only(after, output)), {output: unit}
    run = record_figures.plot_runs_before_after(*pair, units, "run", names)[output]
    residual = record_figures.plot_residuals_before_after(*pair, units, {output: noise}, "residual", names[1])[output]
    roles = {names[0]: Role.BASELINE, names[1]: Role.EXTENDED}
    values = np.array(list(ratios.values()))
    x = Axis("misfit / noise", "", Scale.LOG, (0.7, 3.0 * float(values.max())))
    texts = [f"{ratio:.3g}" for ratio in values]
    marks = draw_sizes(list(ratios), values, [roles.get(n, Role.OTHER) for n in ratios], x, texts=texts)
    series = (*marks, Reference(1.0, upright=True, dash=Dash.DOTTED))
    ratio_marks = Panel("misfit", series, x, Axis(scale=Scale.CATEGORY, reversed=True))
    cells = (
        Cell(run, 0, titles=(f"{output}: free run on a record not used for the fit",), above_another=True),
        Cell(_without_labels(residual), 1, titles=("residual",)),
        Cell(ratio_marks, 0, 1, rows=2, titles=("misfit / noise (1: noise only)",)),
    )
    heading = f"Error of the model in {output}, without and with the effect"
    target = Path(path)
    sheet = Sheet(target.name, cells, heading, (10.5, 4.6), widths=(1.6, 1.0), heights=(1.0, 1.25))
    return save_sheets([sheet], target.parent)


def save_sheets(sheets: Iterable[Sheet], directory: str | Path) -> list[Path]:
    """Write each sheet as PNG, SVG and PDF into a folder, which is made; returns the PNG files."""
    from greybox.show.figures.matplotlib_backend import save_sheet

    folder = Path(directory)
    files: list[Path] = []
    for sheet in sheets:
        file = folder / f"{re.sub(r'[^A-Za-z0-9_.-]+', '_', sheet.name)}.png"
        if file in files:
            file = file.with_stem(f"{file.stem}-{len(files) + 1}")
        save_sheet(sheet, file)
        files.append(file)
    return files


def fit_sheets(fit: Fit, skip: int = 0) -> list[Sheet]:
    """A sheet for each record of a fit, those for validation last."""
    return [
        _fit_sheet(fit, trace, kind, skip if kind == "validation" else 0)
        for kind, traces in (("fit", fit.traces), ("validation", fit.validation.traces))
        for trace in traces
    ]


def _fit_sheet(fit: Fit, trace: Trace, kind: str, skip: int) -> Sheet:
    units = {o.name: o.unit for o in fit.model.outputs}
    run, residual = (
        record_figures.plot_run(trace, units, "run"),
        record_figures.plot_residual(trace, units, fit.noise.levels, "residual"),
    )
    misfit = compute_record_misfits(fit, trace, skip)
    window = record_figures.liveliest_window(trace.time, next(iter(trace.measured.values())))
    cells = []
    for k, (top, bottom) in enumerate(zip(run.panels, residual.panels, strict=True)):
        bottom = _named_by_title(bottom, "residual")
        cells += [
            Cell(top, 2 * k, titles=(_misfit_title(top.name, misfit[top.name]),), above_another=True),
            Cell(bottom, 2 * k + 1),
        ]
        if window is not None:
            closer = ("detail",)
            cells += [
                Cell(top, 2 * k, 1, window=window, titles=closer, above_another=True),
                Cell(bottom, 2 * k + 1, 1, window=window),
            ]
    heading = f"{fit.model.title}: free run over {('validation' if kind == 'validation' else 'estimation')} {record_text(trace.name)}"
    return Sheet(
        f"{kind}-{trace.name}",
        tuple(cells),
        heading,
        size=(11.0 if window else 8.0, 1.0 + 3.4 * len(run.panels)),
        widths=(1.7, 1.0) if window else (1.0,),
        heights=(2.2, 1.0) * len(run.panels),
    )


def _misfit_title(output: str, m: Misfit) -> str:
    outliers = ", outliers excluded" * m.without_outliers
    misfit = f"misfit {ratio_text(m)} × noise{outliers}, " if np.isfinite(m.noise_ratio) else ""
    return f"{output}: {misfit}best fit {m.best_fit_percent:.2f} %"


def comparison_sheet(comparison: Comparison, record: str) -> Sheet:
    """Runs, errors and bars of every model over one record."""
    runs, residuals = (plot(comparison, record, "runs") for plot in (plot_model_runs, plot_model_residuals))
    errors = plot_model_errors(comparison, record)
    cells = []
    for k, (run, residual) in enumerate(zip(runs.panels, residuals.panels, strict=True)):
        measured = run.series[0]
        window = record_figures.liveliest_window(measured.x, measured.y) if isinstance(measured, Curve) else None
        title = "detail" if window else "free run"
        cells += [
            Cell(run, 2 * k, window=window, titles=(title,)),
            Cell(_named_by_title(residual, "error"), 2 * k + 1),
            Cell(errors[run.name], 2 * k, 1, rows=2, titles=("filled: free run, with best fit",)),
        ]
    return Sheet(
        f"comparison-{record}",
        tuple(cells),
        f"{('Validation' if bool(comparison.validation) else 'Estimation')} {record_text(record)}: free run of every model",
        size=(12.0, 0.8 + 4.2 * len(runs.panels)),
        widths=(2.1, 1.0),
        heights=(1.6, 1.0) * len(runs.panels),
    )


# Values of an effect's signal that a picture shows over time.
SIGNAL_IN_TIME = 150


def _effect_signal_sheet(signal: EffectSignal) -> Sheet:
    against, in_time = search_figures.plot_effect_signal(signal, "missing").panels
    shown = min(len(signal.time), SIGNAL_IN_TIME)
    window = (float(signal.time[0]), float(signal.time[shown - 1]))
    heading = f"{signal.effect} explains {100 * signal.explained:.1f} % of the missing signal in {signal.record}"
    cells = (Cell(against, 0), Cell(in_time, 0, 1, window=window))
    return Sheet(f"missing-{signal.effect}", cells, heading, (10.0, 4.4), widths=(1.1, 1.0))


def _before_after_sheet(discovery: Discovery) -> Sheet:
    """The error on the first validation record that has each output, and the averaged spectra of all of them."""
    base, extended, spectra = discovery.base, discovery.extended, search_figures.plot_average_spectra(discovery)
    units = {output: error.unit for output, error in discovery.holdout.items()}
    cells = []
    for k, output in enumerate(discovery.holdout):
        before = next(t for t in base.validation.traces if output in t.measured)
        after = next(t for t in extended.validation.traces if output in t.measured)
        run = record_figures.plot_residuals_before_after(
            _only(before, output), _only(after, output), units, base.noise.levels, "residuals", "extended model"
        )
        cells += [Cell(run[output], k), Cell(spectra[output], k, 1)]
    heading = f"{base.model.name}: error on the validation records; extended: {extended.model.title}"
    rows = len(discovery.holdout)
    return Sheet("residuals", tuple(cells), heading, (11.0, 0.8 + 3.0 * rows), widths=(1.5, 1.0), heights=(1.0,) * rows)


def _holdout_error_sheet(discovery: Discovery) -> Sheet:
    figure = search_figures.plot_holdout_error(discovery)
    rows, bars = len(figure.panels), len(figure.panels[0].categories)
    titles = {}
    for output, error in search_figures.errors_to_judge(discovery).items():
        share = error.visible_share
        taken = (
            "the residual of the plain model is noise"
            if share is None
            else f"{100 * share:.0f} % of the error taken away"
        )
        titles[output] = f"{output}: {taken}"
    cells = tuple(Cell(panel, k, titles=(titles[panel.name],)) for k, panel in enumerate(figure.panels))
    size = (8.5, 0.6 + rows * (1.0 + 0.3 * bars))
    return Sheet("gap", cells, "Rms error of the free run on the validation records", size, heights=(1.0,) * rows)


def _named_by_title(panel: Panel, quantity: str) -> Panel:
    """A low panel below one that has the output's name: its own axis need not repeat that."""
    return replace(panel, y=replace(panel.y, name=quantity))


def _only(trace: Trace, output: str) -> Trace:
    return replace(trace, measured={output: trace.measured[output]}, simulated={output: trace.simulated[output]})


def _without_labels(panel: Panel) -> Panel:
    """A panel whose curves another one on the sheet names already."""
    series = tuple(replace(s, label="") if isinstance(s, Curve) else s for s in panel.series)
    return replace(panel, series=series)
