"""`unexplained`: where, when and in which region model and data disagree."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from greybox.discovery import rules
from greybox.discovery.bench import Bench, Trial
from greybox.discovery.places import INPUT, SENSOR, Linearised, Place, linearised, places, plain_shooting, same_way
from greybox.discovery.region import WORTH, Region, regions
from greybox.discovery.signal import Regression, Smoothed, projected_out, whitened
from greybox.discovery.when import Window, told, windows
from greybox.model import Model
from greybox.result import Fit
from greybox.values import ReadOnly

# Rows of the stretch in which the signal is estimated: where the misfit is largest.
MOST_ROWS = 1200
# A place leads only if its log-likelihood is this far ahead, or this share of what it gained.
LEAD, LEAD_SHARE = 10.0, 0.001
# A reading takes the place of the model's run from so many noise deviations between them.
READ = 2.0


@dataclass(frozen=True)
class Site:
    """A place of the model and how much likelier the residual is with an unknown signal there.

    ``kind``: ``balance``, ``input`` or ``sensor``; ``gain`` in nats; ``size``: rms of the signal that is needed there, in ``unit``.
    """

    name: str
    kind: str
    gain: float
    size: float
    unit: str

    def __str__(self) -> str:
        return f"{self.kind} {self.name}" if self.kind != "sensor" else f"sensor of {self.name}"


@dataclass(frozen=True, eq=False)
class Signal(ReadOnly):
    """The unexplained signal at ``site`` in a stretch of ``record``: ``time``, ``value`` and ``std`` (K,) in ``unit``.

    ``variables``: name -> values (K,) of every state and input there, ``units`` theirs; of a measured state that the model misses the
    readings. What is constant or proportional to what the
    model's constants already multiply is not in it: the fit has absorbed that.
    """

    site: str
    unit: str
    record: str
    time: np.ndarray
    value: np.ndarray
    std: np.ndarray
    variables: Mapping[str, np.ndarray]
    units: Mapping[str, str]


@dataclass(frozen=True, eq=False)
class Unexplained(ReadOnly):
    """What a fitted model leaves over.

    ``misfit``: rms over noise on the records it was fitted to, ``threshold`` the largest that chance explains, ``missing`` whether
    something is. ``sites``: likeliest first; ``sets``: the same in sets that the sensors cannot separate. ``windows``: when. ``signal``:
    at the likeliest site, with ``regions``: as a function of what, best first. Without anything missing the last four are empty.
    """

    misfit: float
    threshold: float
    sites: tuple[Site, ...]
    sets: tuple[tuple[str, ...], ...]
    windows: tuple[Window, ...]
    signal: Signal | None
    regions: tuple[Region, ...]

    @property
    def missing(self) -> bool:
        """Whether more than noise is left."""
        return self.misfit > self.threshold

    @property
    def where(self) -> tuple[str, ...]:
        """The likeliest site with those that cannot be told from it; empty where none explains anything."""
        return self.sets[0] if self.sets and self.sites[0].gain > LEAD else ()

    def __str__(self) -> str:
        lines = [f"misfit {self.misfit:.4g} times the noise; noise alone stays below {self.threshold:.4g}"]
        if not self.missing:
            return "\n".join([*lines, "nothing is missing"])
        lines.append(f"when:  {told(self.windows)}")
        if self.where:
            size = f", {self.sites[0].size:.3g} {self.sites[0].unit} rms" if self.sites[0].unit else ""
            lines.append(f"where: {where_told(self)}{size}")
        worth = [r for r in self.regions if r.share + r.loop > WORTH][:3]
        lines.append(f"as:    {'; '.join(map(str, worth)) if worth else 'no function of any one variable'}")
        return "\n".join(lines)


def where_told(found: Unexplained) -> str:
    """The likeliest set in words."""
    if len(found.where) > 1:
        return f"{' or '.join(found.where)} (the sensors cannot tell)"
    return found.where[0] if found.where else "no place in particular"


def unexplained(fit: Fit) -> Unexplained:
    """Look at what ``fit`` leaves over: the first of the three steps by hand (look, `try_effect`, ``model + effect``).

    At each balance, input and sensor in turn an unknown slowly varying signal is estimated in the stretch where the misfit is
    largest, with the fitted constants and the initial state projected out, and the places are ranked by likelihood. Says also when
    the misfit happens, and as a function of what. The model is linearised along its run.
    """
    return looked(trial_of(fit))


def trial_of(fit: Fit) -> Trial:
    """A fit as a trial: the same records, noise and options, at its constants."""
    return Bench.of(fit).at(fit)


def looked(trial: Trial) -> Unexplained:
    """`unexplained` for a refitted model."""
    residuals = plain_residuals(trial)
    experiments = trial.problem.experiments
    misfit, threshold = trial.per_sample**0.5, rules.threshold(trial.count) ** 0.5
    if misfit <= threshold:
        return Unexplained(misfit, threshold, (), (), (), None, ())
    when = windows([e.name for e in experiments], [e.time for e in experiments], residuals)
    line = linearised(trial, *stretch_of(residuals))
    ranked = _ranked(trial, line)
    if not ranked:
        return Unexplained(misfit, threshold, (), (), when, None, ())
    sites = tuple(Site(p.name, p.kind, s.gain, float(np.sqrt(np.mean(s.value**2))), p.unit) for p, s in ranked)
    signal = _signal(trial, line, *ranked[0])
    variables = {name: (values, signal.units[name]) for name, values in signal.variables.items()}
    run = np.column_stack([line.x, line.u])[ranked[0][1].rows]
    return Unexplained(
        misfit,
        threshold,
        sites,
        _sets(sites),
        when,
        signal,
        tuple(regions(signal.time, signal.value, variables, run)),
    )


def signals(trial: Trial) -> dict[str, Signal]:
    """The unexplained signal as it would be at each place of the model, in the stretch with the largest misfit; likeliest first."""
    line = linearised(trial, *stretch_of(plain_residuals(trial)))
    return {str(place): _signal(trial, line, place, smoothed) for place, smoothed in _ranked(trial, line)}


def plain_residuals(trial: Trial) -> list[np.ndarray]:
    """Residual over noise (N, ny) of each record."""
    return [r for r, _ in plain_shooting(trial).residuals(np.zeros(trial.variables.size))]


def stretch_of(residuals: Sequence[np.ndarray]) -> tuple[int, int, int]:
    """Record, first row and rows of the stretch with the largest misfit."""
    best, found = -1.0, (0, 0, 1)
    for e, r in enumerate(residuals):
        rows = min(MOST_ROWS, len(r))
        sums = np.concatenate([[0.0], np.cumsum(np.nansum(r**2, axis=1))])
        inside = sums[rows:] - sums[:-rows]
        if inside.max() > best:
            best, found = float(inside.max()), (e, int(np.argmax(inside)), rows)
    return found


def _ranked(trial: Trial, line: Linearised) -> list[tuple[Place, Smoothed]]:
    """Every place with the signal that the residual asks for there, likeliest first."""
    r, jacobian = plain_shooting(trial).residuals(np.zeros(trial.variables.size))[line.record]
    stretch = slice(line.first, line.first + line.rows)
    r, jacobian = r[stretch], jacobian[stretch]
    present = np.isfinite(r)
    noise = trial.problem.noise
    seen = whitened(r[:, :, None], noise.colour, present)[present][:, 0]
    absorbing = whitened(np.nan_to_num(jacobian), noise.colour, present)
    basis = projected_out(line, 1 / noise.std, noise.colour, absorbing, present)
    measured = [o.name for o, there in zip(trial.model.outputs, present.any(axis=0), strict=True) if there]
    found: list[tuple[Place, Smoothed]] = []
    for place in places(trial.model, measured):
        same = next(((p, t) for p, t in found if same_way(line.gamma[p], line.gamma[place])), None)
        if same is None:
            signal = Regression.of(line, place, 1 / noise.std, noise.colour, basis, present).smooth(seen)
        else:  # the same signal in another unit
            ratio = float(np.linalg.norm(line.gamma[same[0]]) / np.linalg.norm(line.gamma[place]))
            signal = replace(same[1], value=ratio * same[1].value, std=ratio * same[1].std)
        found.append((place, signal))
    # Of places that cannot be told apart the balance comes first: that is where most physics is. Their gains differ by rounding.
    return sorted(found, key=lambda one: (-float(f"{one[1].gain:.6g}"), one[0].kind == INPUT))


def units_of(model: Model) -> dict[str, str]:
    """Unit of each state and input by name."""
    found = {s.name: s.unit for s in model.all_states}
    return found | {i.name: i.unit for i in model.inputs}


def _sets(sites: Sequence[Site]) -> tuple[tuple[str, ...], ...]:
    """Sites in sets within a lead of their first, likeliest first."""
    found: list[list[Site]] = []
    for site in sites:
        if found and found[-1][0].gain - site.gain <= max(LEAD, LEAD_SHARE * found[-1][0].gain):
            found[-1].append(site)
        else:
            found.append([site])
    return tuple(tuple(str(s) for s in group) for group in found)


def _signal(trial: Trial, line: Linearised, place: Place, smoothed: Smoothed) -> Signal:
    model, rows = trial.model, smoothed.rows
    names = [*model.system.state_names, *(i.name for i in model.inputs)]
    values = np.column_stack([line.x, line.u])[rows]
    if place.kind != SENSOR:
        _as_measured(trial, line, rows, values)
    units = units_of(model)
    return Signal(
        str(place), place.unit, trial.problem.experiments[line.record].name, line.time[rows], smoothed.value, smoothed.std,
        dict(zip(names, values.T, strict=True)), units,
    )  # fmt: skip


def _as_measured(trial: Trial, line: Linearised, rows: np.ndarray, values: np.ndarray) -> None:
    """Put the readings of measured states into ``values`` (K, nx + nu) where the model's run is farther off than they are."""
    model, experiment = trial.model, trial.problem.experiments[line.record]
    for j, output in enumerate(model.outputs):
        equation = model.system.outputs[j]
        if output.name not in experiment.outputs or not equation.is_symbolic():
            continue
        read = experiment.outputs[output.name][line.first + rows]
        if equation.name() in model.system.state_names and np.isfinite(read).all():
            column = model.system.state_names.index(equation.name())
            off = float(np.sqrt(np.mean((read - values[:, column]) ** 2)))
            if off > READ * trial.problem.noise.std[j]:
                values[:, column] = read
