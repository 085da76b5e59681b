"""One record in figures: its signals, the model's run, the residual and its spectrum."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence

import numpy as np

from greybox.base import figure as fig
from greybox.data.experiment import Experiment
from greybox.estimation.result_parts import Trace
from greybox.show.figures.figure import draw_over_time, root_mean_square, scale_to_prefix, value_range
from greybox.show.sentences.wording import capitalise, range_with_unit, record_text, value_with_unit

# The spectrum of a residual, as pages draw it and take it anew over the stretch that a reader zooms into.


def amplitude_density(values: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """One-sided amplitude density by a Hann window.

    Gaps count as the mean of the rest, and not as rows: white noise has the same density with gaps and without.

    Parameters
    ----------
    values
        Evenly sampled (N,), NaN in gaps.
    step
        Between them, in s.

    Returns
    -------
    frequency, density
        In Hz and in the unit of ``values`` per root hertz, (N // 2,); empty for fewer than four values.
    """
    known = np.isfinite(values)
    if len(values) < 4 or not known.any():
        return np.array([]), np.array([])
    window = np.hanning(len(values) + 1)[:-1]
    centred = np.where(known, values - values[known].mean(), 0.0)
    spectrum = np.fft.rfft(window * centred)
    frequency = np.fft.rfftfreq(len(values), step)
    return frequency[1:], np.sqrt(2 * step * np.abs(spectrum[1:]) ** 2 / np.sum(window[known] ** 2))


# Relative variation of the sampling time from which a record is not evenly sampled: clocks in files are rounded.
DRAWING_UNEVEN = 0.001


def uniform_sampling_time(time: np.ndarray) -> float | None:
    """Seconds between rows, None where they are not evenly spaced."""
    steps = np.diff(time)
    even = len(steps) > 0 and float(np.ptp(steps)) < DRAWING_UNEVEN * float(steps.mean())
    return float(steps.mean()) if even else None


TIME = fig.Axis("time", "s")
FREQUENCY = fig.Axis("frequency", "Hz", fig.Scale.LOG)


def plot_signals(
    name: str,
    time: np.ndarray,
    signals: Mapping[str, np.ndarray],
    units: Mapping[str, str],
    role: fig.Role,
    caption: str,
    *,
    held: Collection[str] = (),
) -> fig.Figure:
    """Signals (N,) over ``time`` (N,), a panel for each; those of ``held`` as steps."""
    panels, description = [], []
    for signal, given in signals.items():
        values = np.asarray(given)
        factor, unit = scale_to_prefix(units[signal], values)
        curve = draw_over_time(time, values, role, signal, factor=factor, held=signal in held)
        panels.append(fig.Panel(signal, (curve,), TIME, fig.Axis(signal, unit), height=fig.Height.LOW))
        low, high = value_range(values)
        missing = int((~np.isfinite(values)).sum())
        gaps = f"; {missing} values are missing" if missing else ""
        verb = "ranges from" if math.isfinite(low) else "has"
        description.append(f"{signal} {verb} {range_with_unit(factor * low, factor * high, unit)}{gaps}")
    return fig.Figure(name, tuple(panels), caption, tuple(description))


def plot_inputs(record: Trace | Experiment, units: Mapping[str, str], name: str) -> fig.Figure | None:
    """What drove a record, a panel for each input; None where nothing did."""
    if not record.inputs:
        return None
    caption = f"Inputs of {record_text(record.name)}."
    courses = (record if isinstance(record, Experiment) else record.experiment).courses
    held = [n for n, course in courses.items() if course == "zero"]
    return plot_signals(name, record.time, record.inputs, units, fig.Role.INPUT, caption, held=held)


def plot_outputs(record: Experiment, units: Mapping[str, str], name: str) -> fig.Figure | None:
    """What the sensors show, a panel for each output; None where nothing was measured."""
    if not record.outputs:
        return None
    caption = f"Measured outputs of {record_text(record.name)}."
    return plot_signals(name, record.time, record.outputs, units, fig.Role.OUTPUT, caption)


def plot_run(trace: Trace, units: Mapping[str, str], name: str) -> fig.Figure:
    """Measured outputs and the model's run over one record, a panel for each output."""
    panels, description = [], []
    for output, measured in trace.measured.items():
        simulated = trace.simulated[output]
        factor, unit = scale_to_prefix(units[output], measured, simulated)
        curves = (
            draw_over_time(trace.time, measured, fig.Role.MEASURED, "measured", 2.4, factor=factor),
            draw_over_time(trace.time, simulated, fig.Role.SIMULATED, "simulated", 1.2, factor=factor),
        )
        panels.append(fig.Panel(output, curves, TIME, fig.Axis(output, unit), height=fig.Height.TALL))
        missing = int(np.isnan(measured).sum())
        gaps = f"; {missing} of {len(measured)} values are missing" if missing else ""
        ends = (value_range(values) for values in (measured, simulated))
        ranges = (range_with_unit(factor * low, factor * high, unit) for low, high in ends)
        description.append(
            f"{output} over {trace.time[-1] - trace.time[0]:.4g} s: measured {', simulated '.join(ranges)}{gaps}"
        )
    return fig.Figure(
        name,
        tuple(panels),
        f"{capitalise(record_text(trace.name))}: measured outputs and the model's run over it.",
        tuple(description),
    )


def plot_residual(trace: Trace, units: Mapping[str, str], noise: Mapping[str, float], name: str) -> fig.Figure:
    """Measured minus simulated over one record with a band of two standard deviations of the noise, a panel for each output."""
    panels, description = [], []
    for output in trace.measured:
        residual, std = trace.residual(output), known_noise(noise.get(output))
        factor, unit = scale_to_prefix(units[output], residual, np.array([2 * std]))
        band = 2 * factor * std
        curve = draw_over_time(trace.time, residual, fig.Role.RESIDUAL, "residual", 1.0, factor=factor)
        # The range of factor times a residual, not blown up by a single outlier, and never less than the noise band.
        sizes = np.abs(residual[np.isfinite(residual)])
        largest = factor * float(np.quantile(sizes, SHOWN_SHARE, overwrite_input=True)) if len(sizes) else 0.0
        reach = 1.1 * max(1.2 * band, largest)
        robust_limits = (-reach, reach) if reach > 0 else (-1.0, 1.0)
        axis = fig.Axis(f"residual of {output}", unit, still_limits=robust_limits)
        panels.append(fig.Panel(output, (*_noise_band(band), curve), TIME, axis))
        text = f"Residual of {output}: rms {value_with_unit(factor * root_mean_square(residual), unit)}"
        known = int(np.isfinite(residual).sum())
        if std > 0 and known:
            inside = 100 * int(((-2 * std <= residual) & (residual <= 2 * std)).sum()) / known
            text += f", {inside:.0f} % of it within two standard deviations of the noise, {value_with_unit(band, unit)}"
        description.append(text)
    caption = f"Residual (measured minus simulated) of {record_text(trace.name)}" + (
        "; a band is two standard deviations of a noise that is known."
        if any(map(known_noise, noise.values()))
        else "."
    )
    return fig.Figure(name, tuple(panels), caption, tuple(description))


def plot_spectrum(
    trace: Trace, units: Mapping[str, str], noise: Mapping[str, float], name: str, *, follows: str = ""
) -> fig.Figure:
    """Amplitude density of the residual and of white noise, a panel for each output.

    ``follows`` names the figure with the residual: the spectrum is taken anew over the stretch that the reader zooms into there.
    """
    step = uniform_sampling_time(trace.time) or float(np.median(np.diff(trace.time)))
    panels, description = [], []
    for output in trace.measured:
        residual, std = trace.residual(output), known_noise(noise.get(output))
        factor, unit = scale_to_prefix(units[output], residual, np.array([2 * std]))
        curve = _spectrum(trace.time, factor * residual, step, fig.Role.RESIDUAL, "residual", follows)
        series = (curve, *_noise_floor(curve.x, factor * std * np.sqrt(2 * step)))
        panels.append(fig.Panel(output, series, FREQUENCY, fig.Axis(output, f"{unit}/√Hz", fig.Scale.LOG)))
        if len(curve.x):
            peak = float(curve.x[int(np.argmax(curve.y))])
            description.append(f"The residual of {output} is strongest at {peak:.4g} Hz")
    level = "; the dashed line is white noise of the same standard deviation as the sensor noise"
    caption = (
        f"Spectrum of the residual of {record_text(trace.name)}{level * any(map(known_noise, noise.values()))}."
        " Zoom into the residual over time to see the spectrum of that interval."
    )
    return fig.Figure(name, tuple(panels), caption, tuple(description))


def plot_residuals_before_after(
    before: Trace, after: Trace, units: Mapping[str, str], noise: Mapping[str, float], name: str, extended: str
) -> fig.Figure:
    """The residual of one record with the plain model and with the extended one, a panel for each output."""
    panels, description = [], []
    for output in before.measured:
        std, pair = known_noise(noise.get(output)), (before.residual(output), after.residual(output))
        factor, unit = scale_to_prefix(units[output], pair[0], np.array([2 * std]))
        curves = (
            draw_over_time(before.time, pair[0], fig.Role.BASELINE, "plain model", 1.0, factor=factor),
            draw_over_time(after.time, pair[1], fig.Role.EXTENDED, extended, 1.0, factor=factor),
        )
        series = (*_noise_band(2 * factor * std), *curves)
        panels.append(fig.Panel(output, series, TIME, fig.Axis(f"residual of {output}", unit)))
        before_text, after_text = (value_with_unit(factor * root_mean_square(r), unit) for r in pair)
        description.append(f"Residual of {output}: rms {before_text} before, {after_text} after")
    return fig.Figure(
        name,
        tuple(panels),
        (
            f"Residual of {record_text(before.name)} with the plain and with the extended model"
            + ("; the band is two standard deviations of the noise." if any(map(known_noise, noise.values())) else ".")
        ),
        tuple(description),
    )


def plot_spectra_before_after(
    before: Trace,
    after: Trace,
    units: Mapping[str, str],
    noise: Mapping[str, float],
    name: str,
    extended: str,
    *,
    follows: str = "",
) -> fig.Figure:
    """Amplitude densities of both residuals of `plot_residuals_before_after`."""
    step = uniform_sampling_time(before.time) or float(np.median(np.diff(before.time)))
    panels, description = [], []
    for output in before.measured:
        std, pair = known_noise(noise.get(output)), (before.residual(output), after.residual(output))
        factor, unit = scale_to_prefix(units[output], pair[0], np.array([2 * std]))
        curves = (
            _spectrum(before.time, factor * pair[0], step, fig.Role.BASELINE, "plain model", follows),
            _spectrum(before.time, factor * pair[1], step, fig.Role.EXTENDED, extended, follows),
        )
        series = (*curves, *_noise_floor(curves[0].x, factor * std * np.sqrt(2 * step)))
        panels.append(fig.Panel(output, series, FREQUENCY, fig.Axis(output, f"{unit}/√Hz", fig.Scale.LOG)))
        before_text, after_text = (value_with_unit(factor * root_mean_square(r), unit) for r in pair)
        description.append(f"Residual of {output}: rms {before_text} before, {after_text} after")
    return fig.Figure(
        name,
        tuple(panels),
        f"Spectra of both residuals of {record_text(before.name)}. Zoom into the residuals over time to see the spectra of that interval.",
        tuple(description),
    )


def plot_runs_before_after(
    before: Trace, after: Trace, units: Mapping[str, str], name: str, labels: tuple[str, str]
) -> fig.Figure:
    """Measured outputs and the free runs of two models over one record, a panel for each output."""
    panels = []
    for output, measured in before.measured.items():
        factor, unit = scale_to_prefix(units[output], measured, before.simulated[output])
        curves = (
            draw_over_time(before.time, measured, fig.Role.MEASURED, "measured", 3.0, factor=factor),
            draw_over_time(before.time, before.simulated[output], fig.Role.BASELINE, labels[0], 1.3, factor=factor),
            draw_over_time(after.time, after.simulated[output], fig.Role.EXTENDED, labels[1], 1.3, factor=factor),
        )
        panels.append(fig.Panel(output, curves, TIME, fig.Axis(output, unit), height=fig.Height.TALL))
    return fig.Figure(name, tuple(panels), f"{capitalise(record_text(before.name))}: measured outputs and both runs.")


# Rows of the closer look at a record's liveliest stretch.
CLOSER_LOOK = 200


def liveliest_window(time: np.ndarray, values: np.ndarray) -> tuple[float, float] | None:
    """From when to when ``values`` (N,) vary most, for a closer look; None where the record is short."""
    rows = CLOSER_LOOK
    if len(time) <= 2 * rows:
        return None
    known = np.isfinite(values)
    centred = np.where(known, values - np.mean(values[known]), 0.0)
    # Sum of squares about the mean of each window (N - rows + 1,), by running sums.
    total, squares = (np.convolve(v, np.ones(rows), "valid") for v in (centred, centred**2))
    spread = squares - total**2 / rows
    # A single peak is in the middle of what is shown.
    most = np.flatnonzero(spread >= (1 - 1e-9) * spread.max())
    first = int(most[(len(most) - 1) // 2])
    return float(time[first]), float(time[first + rows - 1])


def known_noise(std: float | None) -> float:
    """The standard deviation of a noise, 0 where it is not known."""
    return std if std is not None and np.isfinite(std) else 0.0


def _noise_band(half: float) -> Sequence[fig.Series]:
    return [fig.Band(-half, half, label="noise, 95 %")] if half > 0 else []


def _noise_floor(frequency: np.ndarray, density: float) -> Sequence[fig.Series]:
    """The density of white noise, a straight line over the ``frequency`` (F,) of a spectrum."""
    if not (density > 0 and len(frequency)):
        return []
    return [fig.Curve(frequency[[0, -1]], np.array([density, density]), fig.Role.NOISE, "noise", 1.4, fig.Dash.DASHED)]


# Values of a residual that travel with a page, for the spectrum of a stretch; of a longer one the spectrum stays as it is.
SIGNAL_ON_PAGE = 25000


def _spectrum(
    time: np.ndarray, residual: np.ndarray, step: float, role: fig.Role, label: str, follows: str
) -> fig.Curve:
    """The spectrum of a residual (N,), with the residual itself where a page is to take it anew."""
    even = uniform_sampling_time(time)
    signal = None
    if follows and even is not None and len(time) <= SIGNAL_ON_PAGE:
        signal = fig.SampledSignal(follows, float(time[0]), even, residual)
    frequency, density = amplitude_density(residual, step)
    return fig.Curve(frequency, density, role, label, 1.0, thinning=fig.Thinning.PEAKS, signal=signal)


# Share of a residual that lies within the limits of a picture: a single outlier does not flatten the rest.
SHOWN_SHARE = 0.9995
