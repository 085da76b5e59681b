"""The page's part on Wang's paper: Tables 1 to 3 and figures 4, 6 and 7 beside what `fits.papers.micromotion_paper` computed."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from fits.papers import micromotion_printed as printed
from fits.papers.micromotion_paper import EVALUATIONS, Study, spread, study, verdict
from fits.papers.micromotion_smoothing import find_resonance
from fits.papers.micromotion_twin import MICRO, ROWS, SAMPLING_TIME, SEED, motion
from fits.papers.paper_page import (
    MEASURED,
    MODELS,
    Say,
    beside,
    docs_folder,
    legend,
    markdown,
    picture,
    progress,
    rms_log,
    save,
    write_section,
)
from greybox.comparison.blackbox.rounding import to_continuous


def write(s: Study, spread: tuple[np.ndarray, np.ndarray], folder: Path) -> None:
    """The part and its figures; ``spread``: distances of Table 1 and of the D-E row from print for other seeds."""
    first, direct = spread
    text = [
        "## 1. Micro-motion actuator (Wang)",
        f"One step of 1 V, {ROWS} rows at 4 kHz, generated with seed {SEED}, not measured. Errors are mean squares of the free run in"
        " um^2 (equation 1) from rest over the whole record.",
        "### Table 1, ARX",
        _table(printed.TABLE_1, s.table_1, ""),
        f"Typical distance from print {100 * rms_log(s.table_1, printed.TABLE_1):.1f} % (rms of the logarithm); over"
        f" {len(first)} other seeds {100 * np.median(first):.1f} % in the median, {100 * first.max():.1f} % at most.",
        "### Table 2, ARMAX",
        _table(printed.TABLE_2, s.table_2, ", nb = nc = 1"),
        f"Typical distance {100 * rms_log(s.table_2, printed.TABLE_2):.0f} %. As printed: better than ARX in every"
        " cell, better with more delay, best at na = 4, nk = 3. Single cells are not reproduced: with one noise coefficient the"
        " structure does not fit the noise, and the minimum depends on where a search starts.",
        "### Monte-Carlo smoothing (equation 17)",
        _smoothing_table(s),
        _smoothing_words(s),
        "### Table 3, least squares on the raw (D-E) and on the smoothed response (S-E)",
        _structures_table(s),
        f"D-E: typical distance {100 * rms_log([r.direct for r in s.structures], printed.TABLE_3_DIRECT):.1f} %, over other seeds"
        f" {100 * np.median(direct):.1f} %. S-E with `b0 b1 b2` is J itself (errata 1.17). S-E with fewer coefficients"
        " grows with the square of the jump that unlucky `r` and `theta` leave at the edge: the"
        " printed constants of equation 17 give nearly the printed numbers, other draws do not.",
        "### s-domain",
        _s_domain_table(s),
        "![Figure 4: best ARX and ARMAX](figures/micromotion_figure_4.png)",
        "![Figure 6: power spectral density](figures/micromotion_figure_6.png)",
        f"The peak besides the one at zero lies at {find_resonance(s.frequencies, s.density):.4f} rad/s, printed {printed.SPECTRAL_PEAK}:"
        " bin 31 of 1024 (errata 1.15).",
        "![Figure 7: smoothed and direct estimate](figures/micromotion_figure_7.png)",
    ]
    write_section(folder, "1", "\n\n".join(text))
    draw(s, folder)


def _table(print_: np.ndarray, ours: np.ndarray, more: str) -> str:
    rows = [
        [f"nk = {nk}", *(beside(p, o) for p, o in zip(print_[i], ours[i], strict=True))]
        for i, nk in enumerate(printed.DELAYS)
    ]
    return markdown([f"printed / generated{more}", *(f"na = {na}" for na in printed.ORDERS)], rows)


def _smoothing_table(s: Study) -> str:
    names = {
        "amplitude": "A, um",
        "ratio": "r",
        "phase": "theta, rad",
        "frequency": "w, rad/s",
        "decay": "sigma, 1/s",
        "error": "J, um^2",
    }
    rows = []
    for axis, name in names.items():
        values = [getattr(c, axis) for c in (printed.SMOOTHED, s.smoothing.best, s.from_data.best)]
        rows.append([name, *(f"{v:.5g}" for v in values)])
    rows.append(["jump at 0, um", *(f"{m.jump:.3g}" for m in (printed.smoothing(ROWS), s.smoothing, s.from_data))])
    rows.append(
        [
            "delay that the phase shows, samples",
            *(f"{m.delay / SAMPLING_TIME:.2f}" for m in (printed.smoothing(ROWS), s.smoothing, s.from_data)),
        ]
    )
    return markdown(["", "printed", "generated, the paper's intervals", "generated, intervals from the data"], rows)


def _smoothing_words(s: Study) -> str:
    draws = np.array([c.error for c in s.smoothing.rounds[0].candidates])
    return (
        f"Best of {len(draws)} evaluations of {s.smoothing.draws.combinations:,} combinations; single evaluations give J from"
        f" {draws.min():.2f} to {draws.max():.2f}, {np.median(draws):.2f} in the median. The least-squares optimum without intervals is"
        f" {s.optimum:.3f}: what lies between is the coarseness of ten draws of `r` and `theta`, and intervals that exclude the right"
        " ones (errata 1.9)."
    )


def _structures_table(s: Study) -> str:
    rows = [
        [
            f"`{r.label}`",
            beside(d, r.direct),
            beside(se, r.smoothed),
            "x" if q.smoothed is None else f"{q.smoothed:.4g}",
        ]
        for r, q, d, se in zip(
            s.structures, s.printed_structures, printed.TABLE_3_DIRECT, printed.TABLE_3_SMOOTHED, strict=True
        )
    ]
    return markdown(
        ["printed / generated", "D-E", "S-E", "S-E with the printed constants of equation 17 on the generated record"],
        rows,
    )


def _s_domain_table(s: Study) -> str:
    model = s.structures[4].smoothed_model
    assert model is not None
    back = to_continuous(model)
    rows = [
        ["numerator", *(", ".join(f"{v:.8g}" for v in n) for n in (printed.S_NUMERATOR, back.numerator))],
        ["denominator", *(", ".join(f"{v:.8g}" for v in d) for d in (printed.S_DENOMINATOR, back.denominator))],
        ["b0, b1, b2", *(", ".join(f"{v:.6f}" for v in b) for b in (printed.DISCRETE_B, model.b[0]))],
        ["a1, a2", *(", ".join(f"{v:.6f}" for v in a[1:]) for a in (printed.DISCRETE_A, model.a))],
    ]
    return markdown(["", "printed", "generated"], rows)


def draw(s: Study, folder: Path) -> None:
    """Figures 4, 6 and 7."""
    t, y = 1e3 * s.record.time, s.record.outputs["x"]
    best = {"ARX": s.arx[2][3], "ARMAX": s.armax[2][2]}
    figure, (axis,) = picture()
    axis.plot(t, y, color=MEASURED, lw=1.4, label="generated record")
    for colour, model in zip(MODELS, best.values(), strict=False):
        axis.plot(t, model.simulate(s.record, initial="zero")["x"], color=colour, lw=0.9, label=model.label)
    legend(axis, "time [ms]", "displacement [µm]", "Figure 4: best ARX and ARMAX, free run")
    save(figure, folder, "micromotion_figure_4")

    figure, (axis,) = picture()
    axis.semilogy(s.frequencies, s.density, color=MODELS[1], lw=1)
    axis.axvline(
        printed.SPECTRAL_PEAK, color=MODELS[0], lw=0.8, ls="--", label=f"printed, {printed.SPECTRAL_PEAK} rad/s"
    )
    axis.set_xlim(0, 3000)
    legend(axis, "frequency [rad/s]", "density [µm² s/rad]", "Figure 6: power spectral density, 1024 points")
    save(figure, folder, "micromotion_figure_6")

    figure, axes = picture(2, height=2.8)
    truth = MICRO * motion(np.ones(ROWS))
    direct = s.structures[4].direct_model
    assert direct is not None
    for axis, rows in zip(axes, (slice(0, 400), slice(0, 24)), strict=True):
        axis.plot(
            t[rows], y[rows], color=MEASURED, lw=1.4, marker="." if rows.stop < 100 else "", label="generated record"
        )
        runs = {"S-E, smoothed": s.smoothing.model, "D-E, direct": direct}
        for colour, (name, model) in zip(MODELS, runs.items(), strict=False):
            axis.plot(t[rows], model.simulate(s.record, initial="zero")["x"][rows], color=colour, lw=0.9, label=name)
    axes[1].plot(t[:24], truth[:24], color="black", lw=0.7, ls=":", label="motion without noise")
    legend(axes[0], "", "displacement [µm]", "Figure 7: second order from the smoothed and from the raw response")
    legend(axes[1], "time [ms]", "displacement [µm]", "its first 6 ms: the smoothed model jumps at the edge")
    save(figure, folder, "micromotion_figure_7")


def main(folder: Path, say: Say = sys.stdout.write) -> None:
    """The whole study."""
    with progress("random jumping", EVALUATIONS) as step:
        result = study(report=lambda _: step())
    say(f"{result.smoothing}\n\nsmoothing and Table 3: {result.seconds:.2f} s\n")
    verdict(result)
    write(result, spread(), folder)
    say(f"written to {folder}\n")


if __name__ == "__main__":
    main(docs_folder("papers.micromotion_page"))
