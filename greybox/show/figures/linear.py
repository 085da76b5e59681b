"""A linear model in figures: gain and phase over frequency, and its poles."""

from __future__ import annotations

import numpy as np

from greybox.base.figure import Area, Axis, Curve, Dash, Figure, Height, Panel, Points, Role, Scale, Series, Symbol
from greybox.estimation.linear.linearisation import Linearisation
from greybox.estimation.linear.model_family import ModelFamily
from greybox.show.figures.figure import typeset_unit
from greybox.show.figures.records import FREQUENCY
from greybox.show.sentences.wording import choose_prefix, value_with_unit

# Of a frequency response.
DRAWING_FREQUENCIES = 500
# A frequency response reaches from the slowest pole divided by this to the fastest one times this.
BEYOND_POLES = 20.0


def response_frequencies(linear: Linearisation) -> np.ndarray:
    """Angular frequencies (nw,) in rad/s around the poles; up to half the sampling rate."""
    poles = linear.poles[np.abs(linear.poles) > 0]
    speeds = np.abs(np.log(poles) / linear.dt) if linear.dt else np.abs(poles)
    speeds = speeds[np.isfinite(speeds) & (speeds > 1e-9)]
    low, high = (float(speeds.min()), float(speeds.max())) if len(speeds) else (1.0, 1.0)
    reach = BEYOND_POLES
    high = min(high * reach, 0.999 * np.pi / linear.dt) if linear.dt else high * reach
    peaks = np.concatenate([s * np.linspace(0.9, 1.1, 81) for s in np.unique(speeds)]) if len(speeds) else np.array([])
    grid = np.concatenate([np.geomspace(min(low / reach, high / 10), high, DRAWING_FREQUENCIES), peaks])
    return np.unique(grid[grid <= high])


def plot_bode(linear: Linearisation, family: ModelFamily | None) -> tuple[Figure, ...]:
    """Gain and phase, a panel for each channel; around the gain the band that holds 95 % of the family's models."""
    if not linear.input_names or not linear.output_names:
        return ()
    w = response_frequencies(linear)
    response, hertz = linear.frequency_response(w), w / (2 * np.pi)
    bounds = family.bounds(w) if family is not None else None
    gains, phases, description = [], [], []
    for r, output in enumerate(linear.output_names):
        for c, name in enumerate(linear.input_names):
            channel, size = f"{name} → {output}", np.abs(response[:, r, c])
            factor, prefix = choose_prefix(linear.output_units[r], float(size.max()))
            size *= factor
            unit = prefix + typeset_unit(f"({linear.output_units[r] or '1'})/({linear.input_units[c] or '1'})")
            gain: list[Series] = [Curve(hertz, np.where(size > 0, size, np.nan), Role.SIMULATED, "gain", 1.4)]
            if bounds is not None:
                low, high = (factor * b[:, r, c] for b in bounds)
                gain.insert(0, Area(hertz, low, high, label="95 % of the models"))
            angle = np.degrees(np.unwrap(np.angle(response[:, r, c])))
            phase = Curve(hertz, angle, Role.RESIDUAL, "phase", 1.4)
            gains.append(Panel(channel, tuple(gain), FREQUENCY, Axis("gain", unit, Scale.LOG), height=Height.TALL))
            phases.append(Panel(channel, (phase,), FREQUENCY, Axis("phase", "°", spacing=90.0), height=Height.LOW))
            top = int(np.argmax(size))
            description.append(
                f"{channel}: gain {value_with_unit(size[0], unit, 4)} at {hertz[0]:.3g} Hz, largest"
                f" {value_with_unit(size[top], unit, 4)} at {hertz[top]:.4g} Hz"
            )
    return (
        Figure(
            "gain",
            tuple(gains),
            ("Gain over frequency" + ("; the band contains 95 % of the drawn models." if family is not None else ".")),
            tuple(description),
        ),
        Figure("phase", tuple(phases), "Phase over frequency.", tuple(description)),
    )


def plot_poles(linear: Linearisation, family: ModelFamily | None) -> Figure | None:
    """Poles in the complex plane, with those of the family; the unit circle around those of a sampled model."""
    poles = linear.poles
    if not len(poles):
        return None
    series: list[Series] = []
    if linear.dt:
        turn = np.linspace(0, 2 * np.pi, 361)
        series.append(Curve(np.cos(turn), np.sin(turn), Role.NOISE, "unit circle", 1.0, Dash.SOLID))
    if family is not None and len(family.members):
        cloud = family.poles.ravel()
        series.append(Points(cloud.real, cloud.imag, Role.MEASURED, "drawn models", size=4, opacity=0.5))
    series.append(Points(poles.real, poles.imag, Role.SIMULATED, "nominal", size=11, symbol=Symbol.CROSS))
    units = ("", "") if linear.dt else ("1/s", "rad/s")
    panel = Panel(
        "poles",
        tuple(series),
        Axis("real part", units[0]),
        Axis("imaginary part", units[1]),
        height=Height.TALL,
        equal_scales=bool(linear.dt),
    )
    places = (f"{p.real:.5g} {'+' if p.imag >= 0 else '-'} {abs(p.imag):.5g} j" for p in poles)
    description = f"Poles at {'; '.join(places)}"
    return Figure(
        "poles",
        (panel,),
        f"Poles in the complex plane. Modes decay {'inside the unit circle' if linear.dt else 'left of the imaginary axis'}.",
        (description,),
    )
