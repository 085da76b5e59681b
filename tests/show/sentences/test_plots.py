"""The words of figures: one golden text for each template."""

from __future__ import annotations

import math

import pytest

from greybox.show.sentences.figures import FigureText
from greybox.show.sentences.registry import sentence
from greybox.show.sentences.wording import phrase

T = FigureText
GOLDEN = [
    (phrase(T.INPUTS, "a"), "Inputs of record a."),
    (phrase(T.OUTPUTS, "a"), "Measured outputs of record a."),
    (phrase(T.SIMULATED_OUTPUTS), "Simulated outputs, without sensor noise."),
    (phrase(T.SIMULATED_INPUTS), "Inputs."),
    (phrase(T.SIMULATED_STATES), "States."),
    (phrase(T.RUN, "a"), "Record a: measured outputs and the model's free run from the first row."),
    (
        phrase(T.RESIDUAL, "a", band=True),
        "Residual (measured minus simulated) of record a; the band is two standard deviations of the noise.",
    ),
    (phrase(T.RESIDUAL, "record 1", band=False), "Residual (measured minus simulated) of record 1."),
    (phrase(T.RESIDUAL, "a", band=False), "Residual (measured minus simulated) of record a."),
    (
        phrase(T.SPECTRUM, "a", line=False),
        "Spectrum of the residual of record a. Zoom into the residual over time to see the spectrum of that interval.",
    ),
    (
        phrase(T.SPECTRUM, "a", line=True),
        "Spectrum of the residual of record a; the dashed line is white noise of the same standard deviation as the sensor noise."
        " Zoom into the residual over time to see the spectrum of that interval.",
    ),
    (
        phrase(T.RESIDUALS_BEFORE_AFTER, "a", band=True),
        "Residual of record a with the plain and with the extended model; the band is two standard deviations of the noise.",
    ),
    (
        phrase(T.SPECTRA_BEFORE_AFTER, "a"),
        "Spectra of both residuals of record a. Zoom into the residuals over time to see the spectra of that interval.",
    ),
    (phrase(T.RUNS_BEFORE_AFTER, "a"), "Record a: measured outputs and the free runs of both models."),
    (phrase(T.RESIDUAL_TESTS, "x"), "Tests of the residual of x."),
    (phrase(T.INTERVALS), "Half width of each 95 % interval: smaller is better."),
    (phrase(T.EXPECTED_INTERVALS), "Expected half width of each 95 % interval: smaller is better."),
    (
        phrase(T.CORRELATION),
        "Correlation of the fitted parameters. Near 1 or -1 the records determine a combination of two parameters, not each of them.",
    ),
    (phrase(T.ERRORS_BEFORE_AFTER), "Rms error of the free run on the validation records, before and after."),
    (
        phrase(T.EFFECT_SIGNAL, "creep", site="force"),
        "The signal that the plain model lacks at the force, estimated from the records, and the signal of creep.",
    ),
    (phrase(T.SURROGATE, "force", tone=False), "A smooth curve represents the unknown effect."),
    (phrase(T.SURROGATE, "force", tone=True), "A tone represents the unknown effect."),
    (
        phrase(T.UNEXPLAINED, "force"),
        "The signal that the fitted plain model does not explain at the force, against each variable. Its parameters have absorbed"
        " part of the effect.",
    ),
    (phrase(T.MISFIT_WINDOWS), "Misfit of the plain model along each record."),
    (
        phrase(T.CANDIDATES, chosen=False, rivals=False),
        "Candidates, best first by Schwarz's criterion. Numbers: difference of the criterion from the best.",
    ),
    (
        phrase(T.CANDIDATES, chosen=True, rivals=True),
        "Candidates, best first by Schwarz's criterion. Green: chosen; orange: explains the records as well. Numbers: difference"
        " of the criterion from the best.",
    ),
    (phrase(T.AVERAGE_SPECTRA), "Averaged spectra of the error on the validation records, before and after."),
    (
        phrase(T.MODEL_ERRORS),
        "Rms error of the free run (filled, with the best fit in percent) and one sample ahead (hollow): smaller is better.",
    ),
    (phrase(T.MODEL_RUNS, "a"), "Record a: measured outputs and the free run of every model."),
    (phrase(T.MODEL_RESIDUALS, "a"), "Record a: measured minus simulated."),
    (phrase(T.GAIN, family=False), "Gain over frequency."),
    (phrase(T.GAIN, family=True), "Gain over frequency; the band contains 95 % of the drawn models."),
    (phrase(T.PHASE), "Phase over frequency."),
    (phrase(T.POLES, sampled=True), "Poles in the complex plane. Modes decay inside the unit circle."),
    (phrase(T.POLES, sampled=False), "Poles in the complex plane. Modes decay left of the imaginary axis."),
    (
        phrase(T.CHANGES, missing=[]),
        "Change of each constant since the fit, with 95 % intervals that hold together. Zero is as before.",
    ),
    (
        phrase(T.CHANGES, missing=["C", "h"]),
        "Change of each constant since the fit, with 95 % intervals that hold together. Zero is as before. Not drawn, as the table tells"
        " why: C and h.",
    ),
    (
        phrase(T.MACHINES),
        "Each machine with its 95 % interval. The line is the mean of those that belong together, the band holds 95 % of such machines.",
    ),
    (phrase(T.COURSE), "Each record with its 95 % interval, in the order of time; record 0 is the fit."),
    (phrase(T.CHANGES_LISTED, percent={"K": 2.0, "B": -0.31}), "K +2 %; B -0.31 %"),
    (phrase(T.FIT_HEADING, "a", model="rig", validation=True), "rig: free run over validation record a"),
    (phrase(T.RESIDUAL_TESTS_HEADING, "x", model="rig"), "rig: residual of x"),
    (phrase(T.RESIDUAL_TESTS_HEADING, "x", model=""), "Residual of x"),
    (phrase(T.COMPARISON_HEADING, "a", validation=False), "Estimation record a: free run of every model"),
    (
        phrase(T.EFFECT_SIGNAL_HEADING, "creep", explained=0.992, record="a"),
        "creep explains 99.2 % of the missing signal in a",
    ),
    (
        phrase(T.SURROGATE_HEADING, "curve over x", explained=0.82),
        "Unknown effect: a curve over x takes 82 % of the error",
    ),
    (
        phrase(T.CANDIDATES_HEADING, verdict="named", chosen=True, rivals=False),
        "Candidates (named). Green: chosen. Numbers: difference of the criterion from the best",
    ),
    (
        phrase(T.BEFORE_AFTER_HEADING, "rig", extended="rig + creep"),
        "rig: error on the validation records; extended: rig + creep",
    ),
    (phrase(T.HOLDOUT_HEADING), "Rms error of the free run on the validation records"),
    (phrase(T.GAP_HEADING, "x"), "Error of the model in x, without and with the effect"),
    (
        phrase(T.MISFIT_TITLE, "x", noise_ratio=0.989, best_fit_percent=99.5),
        "x: misfit 0.989 × noise, best fit 99.50 %",
    ),
    (phrase(T.MISFIT_TITLE, "x", noise_ratio=None, best_fit_percent=99.5), "x: best fit 99.50 %"),
    (phrase(T.CLOSER_LOOK), "detail"),
    (phrase(T.FREE_RUN), "free run"),
    (phrase(T.ERROR_BARS), "filled: free run, with best fit"),
    (phrase(T.EXPLAINED_TITLE, "x", explained=0.5), "x: 50 % of the error taken away"),
    (phrase(T.EXPLAINED_TITLE, "x", explained=None), "x: the residual of the plain model is noise"),
    (phrase(T.UNSEEN_RUN, "x"), "x: free run on a record not used for the fit"),
    (phrase(T.WHAT_IS_LEFT), "residual"),
    (phrase(T.MISFIT_OF_EACH), "misfit / noise (1: noise only)"),
    (
        phrase(T.RESIDUAL_TEST, "x", test="normality", p_value=0.012345, statement="heavy tails"),
        "normality (p = 0.012): heavy tails",
    ),
    (
        phrase(T.SIGNAL_RANGE, "u", low=-1.0, high=2.5, unit="V", missing=3),
        "u ranges from -1 to 2.5 V; 3 values are missing",
    ),
    (
        phrase(T.SIGNAL_RANGE, "u", low=math.nan, high=math.nan, unit="V", missing=9),
        "u has no values; 9 values are missing",
    ),
    (
        phrase(
            T.RUN_RANGE,
            "x",
            duration=2.0,
            low=0.0,
            high=1.0,
            simulated_low=-1.0,
            simulated_high=1.0,
            unit="mm",
            missing=4,
            rows=9,
        ),
        "x over 2 s: measured 0 to 1 mm, simulated -1 to 1 mm; 4 of 9 values are missing",
    ),
    (
        phrase(T.RESIDUAL_SIZE, "x", rms=0.2, unit="µm", inside=0.95, band=0.4),
        "Residual of x: rms 0.2 µm, 95 % of it within two standard deviations of the noise, 0.4 µm",
    ),
    (phrase(T.RESIDUAL_SIZE, "x", rms=0.2, unit="µm", inside=None, band=0.0), "Residual of x: rms 0.2 µm"),
    (
        phrase(T.RESIDUAL_BEFORE_AFTER, "x", before=2.0, after=0.2, unit="µm"),
        "Residual of x: rms 2 µm before, 0.2 µm after",
    ),
    (phrase(T.SPECTRUM_PEAK, "x", frequency=50.0), "The residual of x is strongest at 50 Hz"),
    (phrase(T.INTERVAL_WIDTHS, percent={"K": 0.1, "B": 12.345}), "K 0.1 %; B 12.3 %"),
    (
        phrase(T.CORRELATED, first="K", second="B", correlation=0.987),
        "K and B have a correlation of 0.987: the records determine their ratio better than either",
    ),
    (
        phrase(T.CORRELATED, first="K", second="B", correlation=-0.987),
        "K and B have a correlation of -0.987: the records determine their product better than either",
    ),
    (phrase(T.NO_CORRELATION, limit=0.95), "No correlation exceeds 0.95"),
    (
        phrase(T.ERROR_BEFORE_AFTER, "x", before=0.012, after=0.001, unit="m", explained=0.917),
        "x: the error falls from 12 to 1 mm (92 % less)",
    ),
    (
        phrase(T.EFFECT_SIGNAL_SIZE, "drag", site="force", rms=2.0, unit="mN", explained=0.9, dependence=None),
        "Beside the other constants of the extended model a signal of 2 mN rms is missing at the force."
        " drag explains 90.0 % of its variance. The signal is a function of no"
        " single variable",
    ),
    (
        phrase(T.EFFECT_SIGNAL_SIZE, "creep", site="force", rms=2.0, unit="mN", explained=0.9, dependence="odd"),
        "Beside the other constants of the extended model a signal of 2 mN rms is missing at the force."
        " creep explains 90.0 % of its variance. The signal is odd",
    ),
    (phrase(T.SURROGATE_STATEMENT, statement="A curve over x."), "A curve over x."),
    (phrase(T.DEPENDENCES, statements=["odd", "even"]), "The signal is odd; even"),
    (phrase(T.DEPENDENCES, statements=[]), "The signal is a function of no single variable"),
    (
        phrase(T.WORST_WINDOW, "a", share=0.4, start=0.1, end=0.2),
        "40 % of the misfit lies between 0.1 s and 0.2 s of a",
    ),
    (phrase(T.CANDIDATE_MISFITS, misfits={"a + b": 1.0, "a": 3.0}), "Misfit over noise: a + b 1; a 3"),
    (
        phrase(T.MODEL_ERROR_RANKING, "x", errors={"rig": 1.0, "arx": math.nan}, unit="µm"),
        "x, free run, best first: rig 1 µm, arx diverges",
    ),
    (phrase(T.MODEL_RESIDUAL_SIZES, "x", errors={"rig": 1.0}, unit="µm"), "Rms error of x: rig 1 µm"),
    (
        phrase(T.GAIN_RANGE, "u → x", unit="m/V", gain=2.0, frequency=0.1, largest=5.0, peak=122.0),
        "u → x: gain 2 m/V at 0.1 Hz, largest 5 m/V at 122 Hz",
    ),
    (phrase(T.POLE_PLACES, real=[-1.0, -2.0], imaginary=[3.0, -3.0]), "Poles at -1 + 3 j; -2 - 3 j"),
]


@pytest.mark.parametrize(("item", "text"), GOLDEN, ids=[item.code for item, _ in GOLDEN])
def test_a_figure_says(item, text: str) -> None:
    assert sentence(item) == text


def test_every_text_of_figures_is_here() -> None:
    assert {item.code for item, _ in GOLDEN} == set(FigureText)
