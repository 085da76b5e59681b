"""Captions, titles and descriptions of figures."""

from __future__ import annotations

import math
from collections.abc import Mapping
from enum import StrEnum

from greybox.base.findings import Finding
from greybox.show.sentences.registry import Template, register
from greybox.show.sentences.wording import capitalise, change_text, join_names, phrase, record_text

__all__ = ["TEMPLATES", "FigureText", "phrase"]


class FigureText(StrEnum):
    """What is said of figures. Captions and headings first, then titles of panels, then descriptions."""

    INPUTS = "figure_inputs"
    OUTPUTS = "figure_outputs"
    SIMULATED_OUTPUTS = "figure_simulated_outputs"
    SIMULATED_INPUTS = "figure_simulated_inputs"
    SIMULATED_STATES = "figure_simulated_states"
    RUN = "figure_run"
    RESIDUAL = "figure_residual"
    SPECTRUM = "figure_spectrum"
    RESIDUALS_BEFORE_AFTER = "figure_residuals_before_after"
    SPECTRA_BEFORE_AFTER = "figure_spectra_before_after"
    RUNS_BEFORE_AFTER = "figure_runs_before_after"
    RESIDUAL_TESTS = "figure_residual_tests"
    INTERVALS = "figure_intervals"
    EXPECTED_INTERVALS = "figure_expected_intervals"
    CORRELATION = "figure_correlation"
    ERRORS_BEFORE_AFTER = "figure_errors_before_after"
    EFFECT_SIGNAL = "figure_effect_signal"
    SURROGATE = "figure_surrogate"
    UNEXPLAINED = "figure_unexplained"
    MISFIT_WINDOWS = "figure_misfit_windows"
    CANDIDATES = "figure_candidates"
    AVERAGE_SPECTRA = "figure_average_spectra"
    MODEL_ERRORS = "figure_model_errors"
    MODEL_RUNS = "figure_model_runs"
    MODEL_RESIDUALS = "figure_model_residuals"
    GAIN = "figure_gain"
    PHASE = "figure_phase"
    POLES = "figure_poles"
    CHANGES = "figure_changes"
    MACHINES = "figure_machines"
    COURSE = "figure_course"

    FIT_HEADING = "figure_fit_heading"
    RESIDUAL_TESTS_HEADING = "figure_residual_tests_heading"
    COMPARISON_HEADING = "figure_comparison_heading"
    EFFECT_SIGNAL_HEADING = "figure_effect_signal_heading"
    SURROGATE_HEADING = "figure_surrogate_heading"
    CANDIDATES_HEADING = "figure_candidates_heading"
    BEFORE_AFTER_HEADING = "figure_before_after_heading"
    HOLDOUT_HEADING = "figure_holdout_heading"
    GAP_HEADING = "figure_gap_heading"

    MISFIT_TITLE = "panel_misfit"
    CLOSER_LOOK = "panel_closer_look"
    FREE_RUN = "panel_free_run"
    ERROR_BARS = "panel_error_bars"
    EXPLAINED_TITLE = "panel_explained"
    UNSEEN_RUN = "panel_unseen_run"
    WHAT_IS_LEFT = "panel_what_is_left"
    MISFIT_OF_EACH = "panel_misfit_of_each"
    RESIDUAL_TEST = "panel_residual_test"

    SIGNAL_RANGE = "described_signal_range"
    RUN_RANGE = "described_run_range"
    RESIDUAL_SIZE = "described_residual_size"
    RESIDUAL_BEFORE_AFTER = "described_residual_before_after"
    SPECTRUM_PEAK = "described_spectrum_peak"
    INTERVAL_WIDTHS = "described_interval_widths"
    CHANGES_LISTED = "described_changes"
    CORRELATED = "described_correlated_parameters"
    NO_CORRELATION = "described_no_correlation"
    ERROR_BEFORE_AFTER = "described_error_before_after"
    EFFECT_SIGNAL_SIZE = "described_effect_signal"
    SURROGATE_STATEMENT = "described_surrogate"
    DEPENDENCES = "described_dependences"
    WORST_WINDOW = "described_worst_window"
    CANDIDATE_MISFITS = "described_candidate_misfits"
    MODEL_ERROR_RANKING = "described_model_errors"
    MODEL_RESIDUAL_SIZES = "described_model_residuals"
    GAIN_RANGE = "described_gain"
    POLE_PLACES = "described_poles"


def _quantity(value: float, unit: str, digits: int = 3) -> str:
    return f"{value:.{digits}g} {unit}".rstrip()


def _interval(low: float, high: float, unit: str) -> str:
    return f"{low:.4g} to {high:.4g} {unit}".rstrip() if math.isfinite(low) else "no values"


def _signal_range(f: Finding) -> str:
    v = f.values
    missing = f"; {v['missing']} values are missing" if v["missing"] else ""
    verb = "ranges from" if math.isfinite(v["low"]) else "has"
    return f"{f.subject} {verb} {_interval(v['low'], v['high'], v['unit'])}{missing}"


def _run_range(f: Finding) -> str:
    v = f.values
    missing = f"; {v['missing']} of {v['rows']} values are missing" if v["missing"] else ""
    return (
        f"{f.subject} over {v['duration']:.4g} s: measured {_interval(v['low'], v['high'], v['unit'])}, simulated"
        f" {_interval(v['simulated_low'], v['simulated_high'], v['unit'])}{missing}"
    )


def _residual_size(f: Finding) -> str:
    v = f.values
    text = f"Residual of {f.subject}: rms {_quantity(v['rms'], v['unit'])}"
    if v["inside"] is None:
        return text
    return f"{text}, {100 * v['inside']:.0f} % of it within two standard deviations of the noise, {_quantity(v['band'], v['unit'])}"


def _model_list(errors: Mapping[str, float], unit: str) -> str:
    return ", ".join(
        f"{name} {_quantity(error, unit)}" if math.isfinite(error) else f"{name} diverges"
        for name, error in errors.items()
    )


def _poles(f: Finding) -> str:
    pairs = zip(f.values["real"], f.values["imaginary"], strict=True)
    places = (f"{re:.5g} {'+' if im >= 0 else '-'} {abs(im):.5g} j" for re, im in pairs)
    return f"Poles at {'; '.join(places)}"


def _colours(f: Finding) -> str:
    named = {"chosen": "green: chosen", "rivals": "orange: explains the records as well"}
    shown = "; ".join(text for key, text in named.items() if f.values[key])
    return f" {shown[0].upper()}{shown[1:]}." if shown else ""


def _explained(f: Finding) -> str:
    v = f.values
    if v["explained"] is None:
        return f"{f.subject}: the residual of the plain model is noise"
    return f"{f.subject}: {100 * v['explained']:.0f} % of the error taken away"


TEMPLATES: Mapping[str, Template] = {
    FigureText.INPUTS: lambda f: f"Inputs of {record_text(f.subject)}.",
    FigureText.OUTPUTS: lambda f: f"Measured outputs of {record_text(f.subject)}.",
    FigureText.SIMULATED_OUTPUTS: "Simulated outputs, without sensor noise.",
    FigureText.SIMULATED_INPUTS: "Inputs.",
    FigureText.SIMULATED_STATES: "States.",
    FigureText.RUN: lambda f: (
        f"{capitalise(record_text(f.subject))}: measured outputs and the model's free run from the first row."
    ),
    FigureText.RESIDUAL: lambda f: (
        f"Residual (measured minus simulated) of {record_text(f.subject)}"
        + ("; the band is two standard deviations of the noise." if f.values["band"] else ".")
    ),
    FigureText.SPECTRUM: lambda f: (
        f"Spectrum of the residual of {record_text(f.subject)}"
        + (
            "; the dashed line is white noise of the same standard deviation as the sensor noise."
            if f.values["line"]
            else "."
        )
        + " Zoom into the residual over time to see the spectrum of that interval."
    ),
    FigureText.RESIDUALS_BEFORE_AFTER: lambda f: (
        f"Residual of {record_text(f.subject)} with the plain and with the extended model"
        + ("; the band is two standard deviations of the noise." if f.values["band"] else ".")
    ),
    FigureText.SPECTRA_BEFORE_AFTER: lambda f: (
        f"Spectra of both residuals of {record_text(f.subject)}. Zoom into the residuals over time to see the spectra of that interval."
    ),
    FigureText.RUNS_BEFORE_AFTER: lambda f: (
        f"{capitalise(record_text(f.subject))}: measured outputs and the free runs of both models."
    ),
    FigureText.RESIDUAL_TESTS: "Tests of the residual of {subject}.",
    FigureText.CHANGES: lambda f: (
        "Change of each constant since the fit, with 95 % intervals that hold together. Zero is as before."
        + (f" Not drawn, as the table tells why: {join_names(f.values['missing'])}." if f.values["missing"] else "")
    ),
    FigureText.MACHINES: (
        "Each machine with its 95 % interval. The line is the mean of those that belong together, the band holds 95 % of such machines."
    ),
    FigureText.COURSE: "Each record with its 95 % interval, in the order of time; record 0 is the fit.",
    FigureText.INTERVALS: "Half width of each 95 % interval: smaller is better.",
    FigureText.EXPECTED_INTERVALS: "Expected half width of each 95 % interval: smaller is better.",
    FigureText.CORRELATION: (
        "Correlation of the fitted parameters. Near 1 or -1 the records determine a combination of two parameters, not each of them."
    ),
    FigureText.ERRORS_BEFORE_AFTER: "Rms error of the free run on the validation records, before and after.",
    FigureText.EFFECT_SIGNAL: (
        "The signal that the plain model lacks at the {site}, estimated from the records, and the signal of {subject}."
    ),
    FigureText.SURROGATE: lambda f: (
        "A tone represents the unknown effect." if f.values["tone"] else "A smooth curve represents the unknown effect."
    ),
    FigureText.UNEXPLAINED: (
        "The signal that the fitted plain model does not explain at the {subject}, against each variable. Its parameters have absorbed"
        " part of the effect."
    ),
    FigureText.MISFIT_WINDOWS: "Misfit of the plain model along each record.",
    FigureText.CANDIDATES: lambda f: (
        f"Candidates, best first by Schwarz's criterion.{_colours(f)} Numbers: difference of the criterion from the best."
    ),
    FigureText.AVERAGE_SPECTRA: "Averaged spectra of the error on the validation records, before and after.",
    FigureText.MODEL_ERRORS: (
        "Rms error of the free run (filled, with the best fit in percent) and one sample ahead (hollow): smaller is better."
    ),
    FigureText.MODEL_RUNS: lambda f: (
        f"{capitalise(record_text(f.subject))}: measured outputs and the free run of every model."
    ),
    FigureText.MODEL_RESIDUALS: lambda f: f"{capitalise(record_text(f.subject))}: measured minus simulated.",
    FigureText.GAIN: lambda f: (
        "Gain over frequency" + ("; the band contains 95 % of the drawn models." if f.values["family"] else ".")
    ),
    FigureText.PHASE: "Phase over frequency.",
    FigureText.POLES: lambda f: (
        f"Poles in the complex plane. Modes decay {'inside the unit circle' if f.values['sampled'] else 'left of the imaginary axis'}."
    ),
    FigureText.FIT_HEADING: lambda f: (
        f"{f.values['model']}: free run over {'validation' if f.values['validation'] else 'estimation'} {record_text(f.subject)}"
    ),
    FigureText.RESIDUAL_TESTS_HEADING: lambda f: (
        f"{f.values['model']}: residual of {f.subject}" if f.values["model"] else f"Residual of {f.subject}"
    ),
    FigureText.COMPARISON_HEADING: lambda f: (
        f"{'Validation' if f.values['validation'] else 'Estimation'} {record_text(f.subject)}: free run of every model"
    ),
    FigureText.EFFECT_SIGNAL_HEADING: lambda f: (
        f"{f.subject} explains {100 * f.values['explained']:.1f} % of the missing signal in {f.values['record']}"
    ),
    FigureText.SURROGATE_HEADING: lambda f: (
        f"Unknown effect: a {f.subject} takes {100 * min(f.values['explained'], 1.0):.0f} % of the error"
    ),
    FigureText.CANDIDATES_HEADING: lambda f: (
        f"Candidates ({f.values['verdict']}).{_colours(f)} Numbers: difference of the criterion from the best"
    ),
    FigureText.BEFORE_AFTER_HEADING: "{subject}: error on the validation records; extended: {extended}",
    FigureText.HOLDOUT_HEADING: "Rms error of the free run on the validation records",
    FigureText.GAP_HEADING: "Error of the model in {subject}, without and with the effect",
    FigureText.MISFIT_TITLE: lambda f: (
        f"{f.subject}: "
        + (f"misfit {f.values['noise_ratio']:.3g} × noise, " if f.values["noise_ratio"] is not None else "")
        + f"best fit {f.values['best_fit_percent']:.2f} %"
    ),
    FigureText.CLOSER_LOOK: "detail",
    FigureText.FREE_RUN: "free run",
    FigureText.ERROR_BARS: "filled: free run, with best fit",
    FigureText.EXPLAINED_TITLE: _explained,
    FigureText.UNSEEN_RUN: "{subject}: free run on a record not used for the fit",
    FigureText.WHAT_IS_LEFT: "residual",
    FigureText.MISFIT_OF_EACH: "misfit / noise (1: noise only)",
    FigureText.RESIDUAL_TEST: "{test} (p = {p_value:.2g}): {statement}",
    FigureText.SIGNAL_RANGE: _signal_range,
    FigureText.RUN_RANGE: _run_range,
    FigureText.RESIDUAL_SIZE: _residual_size,
    FigureText.RESIDUAL_BEFORE_AFTER: lambda f: (
        f"Residual of {f.subject}: rms {_quantity(f.values['before'], f.values['unit'])} before,"
        f" {_quantity(f.values['after'], f.values['unit'])} after"
    ),
    FigureText.SPECTRUM_PEAK: "The residual of {subject} is strongest at {frequency:.4g} Hz",
    FigureText.INTERVAL_WIDTHS: lambda f: "; ".join(
        f"{name} {percent:.3g} %" for name, percent in f.values["percent"].items()
    ),
    FigureText.CHANGES_LISTED: lambda f: "; ".join(
        f"{name} {percent:+.3g} %" for name, percent in f.values["percent"].items()
    ),
    FigureText.CORRELATED: lambda f: (
        f"{f.values['first']} and {f.values['second']} have a correlation of {f.values['correlation']:.3f}: the records determine their"
        f" {'ratio' if f.values['correlation'] > 0 else 'product'} better than either"
    ),
    FigureText.NO_CORRELATION: "No correlation exceeds {limit}",
    FigureText.ERROR_BEFORE_AFTER: lambda f: (
        f"{f.subject}: the error falls from {change_text(f.values['before'], f.values['after'], f.values['unit'])}"
        f" ({100 * f.values['explained']:.0f} % less)"
    ),
    FigureText.EFFECT_SIGNAL_SIZE: lambda f: (
        f"Beside the other constants of the extended model a signal of {_quantity(f.values['rms'], f.values['unit'])} rms is missing at the"
        f" {f.values['site']}. {f.subject}"
        f" explains {100 * f.values['explained']:.1f} % of its variance. The signal is"
        f" {f.values['dependence'] or 'a function of no single variable'}"
    ),
    FigureText.SURROGATE_STATEMENT: "{statement}",
    FigureText.DEPENDENCES: lambda f: (
        "The signal is " + "; ".join(f.values["statements"])
        if f.values["statements"]
        else "The signal is a function of no single variable"
    ),
    FigureText.WORST_WINDOW: lambda f: (
        f"{100 * f.values['share']:.0f} % of the misfit lies between {f.values['start']:.4g} s and {f.values['end']:.4g} s of {f.subject}"
    ),
    FigureText.CANDIDATE_MISFITS: lambda f: (
        "Misfit over noise: " + "; ".join(f"{name} {misfit:.3g}" for name, misfit in f.values["misfits"].items())
    ),
    FigureText.MODEL_ERROR_RANKING: lambda f: (
        f"{f.subject}, free run, best first: {_model_list(f.values['errors'], f.values['unit'])}"
    ),
    FigureText.MODEL_RESIDUAL_SIZES: lambda f: (
        f"Rms error of {f.subject}: {_model_list(f.values['errors'], f.values['unit'])}"
    ),
    FigureText.GAIN_RANGE: lambda f: (
        f"{f.subject}: gain {_quantity(f.values['gain'], f.values['unit'], 4)} at {f.values['frequency']:.3g} Hz, largest"
        f" {_quantity(f.values['largest'], f.values['unit'], 4)} at {f.values['peak']:.4g} Hz"
    ),
    FigureText.POLE_PLACES: _poles,
}

register(TEMPLATES)
