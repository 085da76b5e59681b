"""One record as figures that belong together: the run, the residual and its spectrum, which follow one another's zoom."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from greybox.experiment import Experiment
from greybox.plots.thinning import min_max_envelope
from greybox.plots.units import axis_label, scale_to_prefix
from greybox.reports.axes import (
    amplitude_density,
    axes,
    band,
    format_range,
    line,
    rms,
    thin_spectrum,
    uniform_sampling_time,
)
from greybox.reports.page import Figure, View
from greybox.result import Trace

# Values of a residual that travel whole with the page, for the spectrum of a stretch.
WHOLE = 25_000


def record_figures(
    trace: Trace, units: Mapping[str, str], noise: Mapping[str, float], name: str, most: int, *, whole: bool = True
) -> list[Figure]:
    """Run, residual and spectrum of one record; a button for each output. ``noise``: standard deviation by output, where known.

    ``name`` makes the figures' addresses; ``most`` stretches for each curve; ``whole``: the residual travels with the page, and
    its spectrum is taken anew where one zooms in.
    """
    outputs = list(trace.measured)
    return [
        _run(trace, outputs, units, name, most),
        _residual(trace, outputs, units, noise, name, most, whole),
        _spectrum(trace, outputs, units, noise, name, most),
    ]


def inputs_figure(record: Trace | Experiment, units: Mapping[str, str], name: str, most: int) -> Figure | None:
    """What drove the record, a button for each input; None where nothing did."""
    if not record.inputs:
        return None
    caption = f"What drove record {record.name}."
    return curves_figure(record.time, record.inputs, units, f"inputs-{name}", caption, most, "--fourth", name)


def outputs_figure(record: Experiment, units: Mapping[str, str], name: str, most: int) -> Figure | None:
    """What the sensors show, a button for each output; None where nothing was measured."""
    if not record.outputs:
        return None
    caption = f"Outputs of record {record.name}."
    return curves_figure(record.time, record.outputs, units, f"outputs-{name}", caption, most, "--residual", name)


def curves_figure(
    time: np.ndarray, signals: Mapping[str, np.ndarray], units: Mapping[str, str], name: str, caption: str, most: int, colour: str,
    group: str,
) -> Figure:  # fmt: skip
    """``signals`` (N,) over ``time`` (N,), one at a time, each with its button."""
    data, views, words = [], {}, []
    for k, (own, given) in enumerate(signals.items()):
        values = np.asarray(given)
        factor, text = scale_to_prefix(units[own], values)
        data.append(line(*min_max_envelope(time, factor * values, most), own, colour, width=1.2))
        views[own] = View([k], {"yaxis": {"title": {"text": axis_label(own, text)}}})
        gaps = int((~np.isfinite(values)).sum())
        words.append(
            f"{own} runs from {format_range(factor * values)} {text}" + (f", {gaps} values are missing" if gaps else "")
        )
    return Figure(
        name,
        caption,
        "; ".join(words) + ".",
        data,
        axes("time [s]", "") | {"showlegend": False},
        height=240,
        group=group,
        views=views,
    )


def _run(trace: Trace, outputs: list[str], units: Mapping[str, str], name: str, most: int) -> Figure:
    data, views, words = [], {}, []
    for k, output in enumerate(outputs):
        measured, simulated = trace.measured[output], trace.simulated[output]
        factor, text = scale_to_prefix(units[output], measured, simulated)
        data.append(line(*min_max_envelope(trace.time, factor * measured, most), "measured", "--measured", width=2.4))
        data.append(
            line(*min_max_envelope(trace.time, factor * simulated, most), "model, free run", "--model", width=1.2)
        )
        views[output] = View([2 * k, 2 * k + 1], {"yaxis": {"title": {"text": axis_label(output, text)}}})
        gaps = int(np.isnan(measured).sum())
        words.append(
            f"{output} over {trace.time[-1] - trace.time[0]:.4g} s: measured from {format_range(factor * measured)} {text}, simulated from "
            f"{format_range(factor * simulated)} {text}"
            + (f"; {gaps} of {len(measured)} values are missing, the measured curve has gaps there" if gaps else "")
        )
    return Figure(
        f"run-{name}", f"Record {trace.name}: measured, and the model's free run from the first row.", ". ".join(words) + ".", data,
        axes("time [s]", ""), group=name, views=views, switch=name,
    )  # fmt: skip


def _residual(
    trace: Trace, outputs: list[str], units: Mapping[str, str], noise: Mapping[str, float], name: str, most: int, whole: bool
) -> Figure:  # fmt: skip
    data, views, words = [], {}, []
    for k, output in enumerate(outputs):
        residual, std = trace.residual(output), known_noise(noise.get(output))
        factor, text = scale_to_prefix(units[output], residual, np.array([2 * std]))
        data.append(line(*min_max_envelope(trace.time, factor * residual, most), "residual", "--residual", width=1.0))
        layout: dict[str, Any] = {"yaxis": {"title": {"text": axis_label(f"residual of {output}", text)}}, "shapes": []}
        said = f"residual of {output}: rms {factor * rms(residual):.3g} {text}"
        if std > 0:
            layout["shapes"] = [band(factor * 2 * std)]
            inside = np.mean(np.abs(residual[np.isfinite(residual)]) <= 2 * std) if np.isfinite(residual).any() else 0
            said += (
                f", {100 * inside:.0f} % within two standard deviations of the noise (± {factor * 2 * std:.3g} {text})"
            )
        spectra = [(residual, f"spectrum-{name}", 2 * k)] if whole else []
        views[output] = View([k], layout, signals_of(trace.time, spectra, factor))
        words.append(said)
    known = (
        "; the grey band is two standard deviations of the noise" if any(known_noise(n) for n in noise.values()) else ""
    )
    return Figure(
        f"residual-{name}", f"Measured minus simulated, record {trace.name}{known}.", ". ".join(words) + ".", data,
        axes("time [s]", ""), height=270, group=name, views=views, switch=name,
    )  # fmt: skip


def _spectrum(
    trace: Trace, outputs: list[str], units: Mapping[str, str], noise: Mapping[str, float], name: str, most: int
) -> Figure:
    step = uniform_sampling_time(trace.time) or float(np.median(np.diff(trace.time)))
    data, views, words = [], {}, []
    for k, output in enumerate(outputs):
        residual, std = trace.residual(output), known_noise(noise.get(output))
        factor, text = scale_to_prefix(units[output], residual, np.array([2 * std]))
        f, amplitude = thin_spectrum(*amplitude_density(factor * residual, step), most)
        floor = np.array([factor * std * np.sqrt(2 * step)] * 2) if std > 0 else np.array([])
        data.append(line(f, amplitude, "residual", "--residual", width=1.0))
        data.append(line(f[[0, -1]] if len(f) and len(floor) else f[:0], floor, "noise", "--model", dash="dash"))
        views[output] = View(
            [2 * k, 2 * k + 1] if std > 0 else [2 * k],
            {"yaxis": {"title": {"text": axis_label(output, f"{text}/√Hz")}}},
        )
        if len(f):
            words.append(f"the residual of {output} is strongest at {f[int(np.argmax(amplitude))]:.4g} Hz")
    return Figure(
        f"spectrum-{name}", "Spectrum of this residual, and where white noise of the known size would lie. Zoom into the residual"
        " in time: the spectrum becomes that of the stretch.", ("; ".join(words) or "no residual") + ".", data,
        axes("frequency [Hz]", "", logarithmic="xy"), height=280, views=views, switch=name,
    )  # fmt: skip


def signals_of(time: np.ndarray, spectra: Sequence[tuple[np.ndarray, str, int]], factor: float) -> list[dict[str, Any]]:
    """Residuals (N,), each with the figure and the number of the curve that shows its spectrum; none where a spectrum says little."""
    step = uniform_sampling_time(time)
    if step is None or len(time) > WHOLE:
        return []
    start = float(time[0])
    return [
        {"start": start, "step": step, "values": factor * r, "figure": figure, "trace": trace}
        for r, figure, trace in spectra
    ]


def known_noise(std: float | None) -> float:
    """The standard deviation of a noise, 0 where it is not known."""
    return std if std is not None and np.isfinite(std) else 0.0
