"""What the catalogue does not explain: a smooth fitted curve in the place of the unknown effect.

``sum c_k exp(-(t - k)^2)``, ``t = (z - lowest) / pitch``: bumps so close that their sum is smooth (equal ones make a constant to 1e-4), and
short enough to be read in a model file. Outside the range that was seen the curve goes to zero. Weak priors on the heights keep
apart what a constant of the model could do as well.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from greybox.discovery.attempt import judged
from greybox.discovery.bench import Bench, Trial
from greybox.discovery.gap import Gap, gaps
from greybox.discovery.look import Signal, Unexplained
from greybox.discovery.places import INPUT, SENSOR, Place, places
from greybox.discovery.region import TIME, WORTH, Region
from greybox.experiment import Experiment
from greybox.model import Effect
from greybox.result import Fit
from greybox.result.frozen import ReadOnly
from greybox.signals import Expression, Named, Parameter

NAME = "fitted_curve"
# Intervals of the curve; how far it reaches beyond the stretch that was looked at; prior of a height over the signal's rms.
INTERVALS, MARGIN, LOOSE = 20, 0.15, 5.0
ITERATIONS = 30


@dataclass(frozen=True)
class Tone:
    """A sinusoid from outside: ``frequency`` and its standard deviation ``std`` (None: not known) in Hz, ``amplitude`` by record.

    ``beginning``: seconds of each validation record from which its amplitude and phase are read there; ``alike``: places at which it
    would explain the records as well.
    """

    frequency: float
    std: float | None
    amplitude: Mapping[str, float]
    beginning: float
    alike: tuple[str, ...]

    def __str__(self) -> str:
        return f"a tone of {f'{self.frequency:#.4g}'.rstrip('.')} Hz"


@dataclass(frozen=True, eq=False)
class StandIn(ReadOnly):
    """What was fitted in the place of an unknown effect at ``site``: a curve over the variable of ``region``, or a ``tone`` in time.

    ``fit`` is the extended model with it as an effect; ``gap`` by output on the validation records. ``values`` (M,) of the
    variable and the ``curve`` (M,) there, in ``variable_unit`` and ``unit``, through the unexplained ``signal``. A straight line is shared
    with the model's own constants (a damper, a spring) in a way that no data decide: the ``curve`` has the one that the signal has.
    """

    site: str
    unit: str
    fit: Fit
    gap: Mapping[str, Gap]
    values: np.ndarray
    curve: np.ndarray
    signal: Signal
    region: Region
    tone: Tone | None = None

    @property
    def variable(self) -> str:
        """Name of the state or input that the curve is over, or ``time``."""
        return self.region.variable

    @property
    def variable_unit(self) -> str:
        """Unit of the variable."""
        return self.region.unit

    @property
    def closed(self) -> float:
        """Share of the gap that it closes, in the output that the plain model misses most."""
        return max(self.gap.values(), key=lambda g: g.before / g.floor).closed

    @property
    def title(self) -> str:
        """``a curve over x`` or ``a tone of 50.00 Hz``."""
        return f"a curve over {self.variable}" if self.tone is None else str(self.tone)

    @property
    def seen(self) -> np.ndarray:
        """The values (K,) of the variable along the signal."""
        return self.signal.time if self.variable == TIME else self.signal.variables[self.variable]

    def __str__(self) -> str:
        if self.tone is None:
            return f"a smooth curve over {self.variable} at the {self.site} {closing(self.closed)} on the validation records"
        sizes = sorted(self.tone.amplitude.values())
        size = f"{sizes[0]:.3g}" if sizes[-1] <= 1.05 * sizes[0] else f"{sizes[0]:.3g} to {sizes[-1]:.3g}"
        also = f" (or the {', the '.join(self.tone.alike)}: these records cannot tell)" if self.tone.alike else ""
        return (
            f"{self.tone} at the {self.site}{also}, of amplitude {size} {self.unit}".rstrip()
            + f", {closing(self.closed)} on the validation records (amplitude and phase there from the first"
            f" {self.tone.beginning:.2g} s)"
        )


def closing(share: float) -> str:
    """``closes 98.8 % of the gap``; a model that is farther off than the plain one closes nothing."""
    return f"closes {100 * min(share, 1.0):.3g} % of the gap" if share > 0 else "closes nothing of the gap"


def stand_in(
    bench: Bench, trial: Trial, found: Unexplained, judges: Sequence[Experiment], base: Fit, skip: int = 0
) -> StandIn | None:
    """The curve for what ``trial`` leaves over; None where that is no function of any one variable, or cannot be simulated.

    ``base``: the plain model judged on the same records, which the gap is counted from.
    """
    region = next((r for r in found.regions if r.variable != TIME and r.share > WORTH), None)
    signal = found.signal
    if region is None or signal is None:
        return None
    measured = [o.name for o in trial.model.outputs]
    place = next(p for p in places(trial.model, measured) if str(p) == signal.site)
    effect, start = curve_effect(place, region, signal.variables[region.variable], signal.value, signal.std)
    model = trial.model + effect
    names = next(b.own for b in model.bound_effects if b.effect.name == NAME)
    better = bench.best(
        model, [{**trial.model.values, **{names[n]: v for n, v in start.items()}}, trial.model.values], 1, ITERATIONS
    )
    if better is None:
        return None
    fitted = judged(better, bench, judges, skip)
    seen = signal.variables[region.variable]
    z = np.linspace(seen.min(), seen.max(), 101)
    values = {n: better.model.values[there] for n, there in names.items()}
    return StandIn(
        signal.site, place.unit, fitted, gaps(base, fitted), z,
        curve_at(values, z) + np.polyval(np.polyfit(seen, signal.value - curve_at(values, seen), 1), z), signal, region,
    )  # fmt: skip


def curve_effect(
    place: Place, region: Region, z: np.ndarray, w: np.ndarray, std: np.ndarray, intervals: int = INTERVALS
) -> tuple[Effect, dict[str, float]]:
    """A smooth curve over the variable of ``region`` as an effect at ``place``; its heights by regression of ``w`` (K,) on ``z`` (K,)."""
    low, high = float(z.min()), float(z.max())
    low, high = low - MARGIN * (high - low), high + MARGIN * (high - low)
    pitch, size = (high - low) / intervals, float(np.sqrt(np.mean(w**2)))
    heights = [f"c{k}" for k in range(intervals + 1)]
    parameters = [
        Parameter("lowest", region.unit, low, fixed=True, source="range of the record", description=f"least {region.variable}"),
        Parameter("pitch", region.unit, pitch, fixed=True, source="range of the record", description="distance of the bumps"),
        *(
            Parameter(n, place.unit, 0.0, source="zero, until fitted", prior=(0.0, LOOSE * size), description="height")
            for n in heights
        ),
    ]  # fmt: skip
    variable, is_input = region.variable, place.kind == INPUT

    def curve(x: Named, u: Named, p: Named) -> Expression:
        seen = x[variable] if variable in x else u[variable]
        return _bumps((seen - p.lowest) / p.pitch, [p[n] for n in heights])

    def changed(value: Expression, x: Named, u: Named, p: Named) -> Expression:
        return value + curve(x, u, p)

    basis = _basis((z - low) / pitch, len(heights))
    weight = 1 / np.maximum(std, 1e-3 * size)
    held = np.eye(len(heights)) / (LOOSE * size)
    c = np.linalg.lstsq(
        np.vstack([basis * weight[:, None], held]), np.append(w * weight, np.zeros(len(heights))), rcond=None
    )[0]
    effect = Effect(
        NAME, place.name, parameters,
        terms=None if place.kind in (INPUT, SENSOR) else curve,
        on_input=changed if is_input else None, on_output=changed if place.kind == SENSOR else None,
        equation=f"smooth curve over {variable}", parity=region.parity, amplitudes=heights,
        source="fitted to what the model leaves over; no law of its own",
    )  # fmt: skip
    return effect, dict(zip(heights, map(float, c), strict=True))


def curve_at(values: Mapping[str, float], z: np.ndarray) -> np.ndarray:
    """The curve with these constants at ``z`` (M,)."""
    heights = np.array([values[f"c{k}"] for k in range(INTERVALS + 1)])
    return _basis((z - values["lowest"]) / values["pitch"], len(heights)) @ heights


def _basis(t: np.ndarray, count: int) -> np.ndarray:
    """Bumps (M, count) at ``t``."""
    return np.exp(-((t[:, None] - np.arange(count)) ** 2))


def _bumps(t: Expression, heights: Sequence[Expression]) -> Expression:
    total: Expression = 0
    for k, c in enumerate(heights):
        total = total + c * ca.exp(-((t - k) ** 2))
    return total
