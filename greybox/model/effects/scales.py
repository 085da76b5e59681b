"""How large things are in a record: what start values of effects are measured by."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import product

import casadi as ca
import numpy as np

from greybox.base import INTEGRATING_POLE, DataError
from greybox.model.balance import eliminate
from greybox.model.effect import GUESSES, Effect
from greybox.model.model import Model
from greybox.model.signals import Parameter
from greybox.model.sites import PlaceKind, Site, find_sites

# Bounds of a delay (s) before a record says how it is sampled.
UNTAILORED_DELAY = (0.0, 5e-3)


@dataclass(frozen=True)
class SiteScales:
    """How large things are at one site: peaks of what an effect there sees, 0 where there is no such signal.

    Attributes
    ----------
    displacement, velocity, force, storage
        Of a balance.
    lowest, highest
        Between which the displacement lies.
    store
        Peak of the pressure or level that the balance stores.
    input, sensor
        Of an input, and how far an output moves from its first value.
    readings
        Least and largest reading of an output.
    pitch
        Distance along the displacement after which what the plain model leaves repeats; 0 where it does not.
    """

    displacement: float = 0.0
    velocity: float = 0.0
    force: float = 0.0
    storage: float = 0.0
    lowest: float = 0.0
    highest: float = 0.0
    store: float = 0.0
    input: float = 0.0
    sensor: float = 0.0
    readings: tuple[float, float] | None = None
    pitch: float = 0.0


# Share of the largest force: an effect of this size is visible in a good record and small enough to be nearly linear.
VISIBLE_SHARE = 0.02


@dataclass(frozen=True)
class Scales:
    """How large and how fast things are in a record, in the units of the model: what start values of effects are measured by.

    A peak is 0 where the model has no such signal, and 1 where it has one and nothing moves.

    Attributes
    ----------
    displacement, velocity, current
        Peak absolute values of the states with these roles.
    input
        Peak of the first input.
    sensor
        How far the main output moves from its first value.
    force, storage
        Largest term of the balance ``force``, and what it stores (the mass).
    balances
        Largest term of each balance, by its name.
    period, duration
        Time between samples and length of the record, in s.
    fastest, slowest
        Time constants ``1 / |lambda|`` of the model along the record in s, integrators left out, at most the duration.
    readings
        Least and largest reading of the main output.
    peaks
        Peak of every state that has a role, by role.
    lowest, highest
        Between which the displacement lies.
    store
        Peak of the first pressure or level.
    floors
        What every state that has a role stays above in size but for a twentieth of the rows, by role.
    pitch
        Distance along a displacement after which what the plain model leaves repeats; 0 where it does not, or where nobody looked.
    sites
        Scales at every site of the model, by the names and labels of the sites.
    """

    displacement: float
    velocity: float
    current: float
    input: float
    sensor: float
    force: float
    storage: float
    balances: Mapping[str, float]
    period: float
    duration: float
    fastest: float
    slowest: float
    readings: tuple[float, float] = (0.0, 1.0)
    peaks: Mapping[str, float] = field(default_factory=dict)
    lowest: float = 0.0
    highest: float = 0.0
    store: float = 0.0
    floors: Mapping[str, float] = field(default_factory=dict)
    pitch: float = 0.0
    sites: Mapping[str, SiteScales] = field(default_factory=dict)

    def at(self, site: str) -> Scales:
        """The same as an effect at ``site`` sees it: peaks there in the place of those at the first site of their kind."""
        shown = {f.name: getattr(self.sites[site], f.name) for f in fields(SiteScales)} if site in self.sites else {}
        return replace(self, **{name: value for name, value in shown.items() if value})

    def with_periods(self, model: Model, periods: Mapping[str, float]) -> Scales:
        """The same where what the plain ``model`` leaves repeats over states: ``periods`` by the name of the state, in its unit."""
        pitches = {
            name: periods[displacement]
            for site in model.sites
            if (displacement := site.states.get("displacement", "")) in periods
            for name in (site.name, site.label)
        }
        sites = {name: replace(at_site, pitch=pitches.get(name, at_site.pitch)) for name, at_site in self.sites.items()}
        return replace(self, pitch=next(iter(pitches.values()), self.pitch), sites=sites)

    @property
    def reading(self) -> float:
        """Peak of the main output itself."""
        return max(map(abs, self.readings))

    @property
    def visible_force(self) -> float:
        """A small share of the largest force: an effect of this size is visible but small (`StartingValues.visible_share`)."""
        return VISIBLE_SHARE * self.force


# Share of the rows in which a state may lie below its floor: it may begin anywhere.
FLOOR_SHARE = 0.05
# Rows of a record that the scales are taken from, evenly spread.
STARTING_ROWS = 5000


def measure_scales(model: Model, x: np.ndarray, u: np.ndarray, period: float) -> Scales:
    """The scales of a model along a record or a simulation of it.

    Parameters
    ----------
    model
        The model; its parameters have the values of the simulation.
    x, u
        Its states (N, nx) and inputs (N, nu). Rows that are not finite are left out.
    period
        Time between rows in s.

    Returns
    -------
    Scales
        Peaks, largest terms and time constants.

    Raises
    ------
    DataError
        If no row is finite.
    """
    system, p = model.system, np.array(list(model.values.values()))
    duration = period * max(len(x) - 1, 1)
    every = max(1, len(x) // STARTING_ROWS)
    x, u = np.asarray(x, float)[::every], np.asarray(u, float).reshape(len(u), -1)[::every]
    is_finite = np.isfinite(x).all(axis=1) & np.isfinite(u).all(axis=1)
    x, u = x[is_finite], u[is_finite]
    if not len(x):
        raise DataError(
            f"model {model.title!r}: no row of the simulated states is finite; start from other values of its parameters"
        )
    arguments = [system.x, system.u, system.p]
    columns = {state.name: x[:, k] for k, state in enumerate(model.all_states)}
    columns |= {i.name: u[:, k] for k, i in enumerate(model.inputs)}
    for a in system.algebraic:
        columns[a.state.name] = np.asarray(ca.Function("value", arguments, [a.value])(x.T, u.T, p)).ravel()
    of_role = {state.role: columns[state.name] for state in reversed(model.all_states) if state.role}
    for site in model.sites:  # roles that units tell
        of_role = {role: columns[name] for role, name in site.states.items() if name} | of_role
    peaks = {role: _peak(values) for role, values in of_role.items()}
    floors = {role: float(np.quantile(np.abs(values), FLOOR_SHARE)) for role, values in of_role.items()}
    rows = {b.name: ca.vertcat(*b.terms.values()) for b in system.balances}
    rows |= {
        a.balance.name: eliminate(ca.vertcat(*a.balance.terms.values()), system.algebraic) for a in system.algebraic
    }
    every_term = {name: ca.Function("terms", arguments, [row]) for name, row in rows.items()}
    balances = {name: _peak(np.asarray(terms(x.T, u.T, p))) for name, terms in every_term.items()}
    stored = ca.Function("storage", arguments, [ca.vertcat(*[ca.SX(b.storage) for b in system.balances])])
    of_balances = dict(zip(balances, np.asarray(stored(x[0], u[0], p)).ravel().tolist(), strict=False))
    # Of a relation what its largest term would move as it moves: force over acceleration.
    moved = {
        s.name: np.gradient(columns[s.states["velocity"]], every * period)
        for s in model.sites
        if s.is_motion and len(x) > 1
    }
    storages = {name: balances[name] / _peak(moved[name]) if name in moved else 0.0 for name in balances} | of_balances
    readings = dict(zip(system.output_names, np.asarray(system.output_function(x.T, u.T, p)), strict=True))
    inputs = dict(zip(system.input_names, u.T, strict=True))
    sites: dict[str, SiteScales] = {}
    for site in model.sites:
        at_site = _measure_site(site, columns, inputs, readings, balances, storages)
        sites |= {site.name: at_site, site.label: at_site}
    bodies = [sites[site.name] for site in find_sites("force", model.sites)]
    body = bodies[0] if bodies else SiteScales()
    stores = [s.store for s in sites.values() if s.store]
    shown = readings[system.output_names[0]]
    fastest, slowest = _time_constants(model, x, u, p, duration)
    return Scales(
        displacement=peaks.get("displacement", body.displacement),
        velocity=peaks.get("velocity", body.velocity),
        current=peaks.get("current", 0.0),
        input=_peak(u[:, 0]) if u.shape[1] else 0.0,
        sensor=_peak(shown - shown[0]),
        force=body.force,
        storage=body.storage,
        balances=balances,
        period=period,
        duration=duration,
        fastest=fastest,
        slowest=slowest,
        readings=_range(shown),
        peaks=peaks,
        lowest=body.lowest,
        highest=body.highest,
        store=stores[0] if stores else 0.0,
        floors=floors,
        sites=sites,
    )


def _measure_site(
    site: Site,
    states: Mapping[str, np.ndarray],
    inputs: Mapping[str, np.ndarray],
    readings: Mapping[str, np.ndarray],
    balances: Mapping[str, float],
    storages: Mapping[str, float],
) -> SiteScales:
    if site.kind is PlaceKind.INPUT:
        return SiteScales(input=_peak(inputs[site.name]))
    if site.kind is PlaceKind.OUTPUT:
        shown = readings[site.name]
        return SiteScales(sensor=_peak(shown - shown[0]), readings=_range(shown))
    seen = {role: states[name] for role, name in site.states.items() if name}
    displacement = seen.get("displacement", np.zeros(0))
    return SiteScales(
        displacement=_peak(displacement) if len(displacement) else 0.0,
        velocity=_peak(seen["velocity"]) if "velocity" in seen else 0.0,
        force=balances[site.name],
        storage=storages[site.name],
        lowest=float(displacement.min(initial=0.0)),
        highest=float(displacement.max(initial=0.0)),
        store=_peak(seen["store"]) if "store" in seen else 0.0,
    )


def is_told(parameter: Parameter) -> bool:
    """Whether a person has fixed a constant of an effect, whose value no record changes; what the catalogue fixes is a guess."""
    return parameter.fixed and parameter.source not in GUESSES


# How far the bounds of a shape parameter reach beyond its start values, as a factor either way.
BOUNDS_REACH = 1000.0


def tailor_to_record(entry: Effect, scales: Scales) -> Effect:
    """An effect of the catalogue made ready for a record.

    Shape parameters start inside their grid, and their bounds reach `StartingValues.bounds_reach` times further; a delay gets its longest
    value: the catalogue cannot know how the record is sampled.

    Parameters
    ----------
    entry
        An effect.
    scales
        Those of the record, from `measure_scales`.

    Returns
    -------
    Effect
        The same effect with other start values and bounds.
    """
    grid = entry.grid(scales) if entry.grid else {}
    limits = dict(entry.limits(scales)) if entry.limits else {}
    parameters = []
    for q in entry.parameters:
        low, high = q.bounds
        value = q.value
        values = sorted(grid[q.name]) if q.name in grid and q.name not in entry.amplitudes else []
        if values and not is_told(q):
            value = values[len(values) // 2]
        if q.name in limits:
            low, high = limits[q.name]
        elif values and q.positive and low < values[0] and values[-1] < high:
            low, high = max(low, values[0] / BOUNDS_REACH), min(high, values[-1] * BOUNDS_REACH)
        parameters.append(replace(q, bounds=(low, high), value=min(max(value, low), high)))
    return replace(entry, parameters=tuple(parameters))


# Longest delay that is considered at first, in sampling periods: each is a column of the step's input.
LONGEST_DELAY = 16.0
# Share of it from which a delay has ended there.
AT_LIMIT = 0.98


def bound_delays(model: Model, period: float) -> Model:
    """A model whose delays may be as long as records show that are sampled every ``period`` seconds.

    Only bounds that are still the catalogue's are changed: it cannot know how a record is sampled.

    Parameters
    ----------
    model
        A model with a delay or without one.
    period
        Time between rows in s.

    Returns
    -------
    Model
        The same model, or one with other bounds of its delays.
    """
    return model.bound(**dict.fromkeys(list_untailored_delays(model), (0.0, LONGEST_DELAY * period)))


def list_delays_at_limit(model: Model, values: Mapping[str, float], period: float) -> tuple[str, ...]:
    """The delays of a model that `bound_delays` has bounded and that ended at this bound with ``values``: parameter -> value."""
    limit = LONGEST_DELAY * period
    return tuple(
        q.name
        for bound in model.bound_effects
        if bound.effect.delay
        for q in bound.parameters
        if not q.fixed and q.bounds == (0.0, limit) and values.get(q.name, 0.0) >= AT_LIMIT * limit
    )


def list_untailored_delays(model: Model) -> tuple[str, ...]:
    """The delays of a model that are not fixed and whose bounds are still the catalogue's."""
    return tuple(
        outer.name
        for bound in model.bound_effects
        if bound.effect.delay
        for inner, outer in zip(bound.effect.parameters, bound.parameters, strict=True)
        if inner.name in bound.effect.amplitudes and inner.bounds == UNTAILORED_DELAY and not outer.fixed
    )


def _peak(values: np.ndarray) -> float:
    return float(np.abs(values).max(initial=0.0)) or 1.0


def _range(values: np.ndarray) -> tuple[float, float]:
    low, high = float(values.min()), float(values.max())
    # A reading that never moves lies between nothing and itself, or 1 as a peak does.
    return (low, high) if low < high else (min(low, 0.0), max(high, float(not low)))


def _time_constants(model: Model, x: np.ndarray, u: np.ndarray, p: np.ndarray, duration: float) -> tuple[float, float]:
    rates = []
    for k in range(0, len(x), max(1, len(x) // 10)):
        jacobian = model.system.jacobian(x[k], u[k], p).full()
        if np.isfinite(jacobian).all():
            # |lambda| of the linearised model at about ten points along the record.
            rates.append(np.abs(np.linalg.eigvals(jacobian)))
    magnitudes = np.concatenate([*rates, np.empty(0)])
    # Integrators have no time constant.
    moving = magnitudes[magnitudes > INTEGRATING_POLE * magnitudes.max(initial=0.0)]
    if not len(moving):
        return duration, duration
    return min(1 / float(moving.max()), duration), min(1 / float(moving.min()), duration)


# Where a search for the constants of an effect begins: what decides its success is not the statistics but these points.
#
# Amplitudes of the catalogue are neutral: an effect just added changes nothing, and there the cost of many has no slope (a dry friction of
# zero, a dead zone of no width). So a search begins at a small amplitude and at a large one, and at every shape of the effect's grid.


# Amplitudes at which a refit starts, in multiples of the effect's probe (about a hundredth of the balance it enters).
AMPLITUDE_GRID: tuple[float, ...] = (1.0, 10.0)
# Starting points that are searched from, the most promising first ...
FEW_SHAPES_STARTS = 2
# ... of an effect with so many shapes more of them, as its cost has many minima ...
FEW_SHAPES = 4
MANY_SHAPES_STARTS = 5
# ... and above so many all of them: a step from afar predicts nothing for a sharp resonance.
MANY_SHAPES = 15


def list_effect_values(
    model: Model, effect: Effect, scales: Scales, amplitudes: Sequence[float] = AMPLITUDE_GRID
) -> Iterator[dict[str, float]]:
    """Values of the constants of one effect of ``model`` at which a search for them begins.

    Parameters
    ----------
    model
        The model with the effect.
    effect
        The effect.
    scales
        Peaks and times of the records, for the model without it.
    amplitudes
        In multiples of the effect's probe.

    Yields
    ------
    dict
        Constant, by its name in the model -> value in its unit, within its bounds; none that somebody has fixed.
    """
    known = model.names_of(effect.name)
    names = {q.name: known[q.name] for q in effect.parameters if not is_told(q)}
    probe = effect.probe(scales) if effect.probe else {}
    for shape, amplitude in product(list_shapes(effect, scales), amplitudes if probe else (1.0,)):
        values = {**shape, **{name: value * amplitude for name, value in probe.items()}}
        yield {names[name]: within_bounds(model, names[name], value) for name, value in values.items() if name in names}


def list_shapes(effect: Effect, scales: Scales) -> Sequence[Mapping[str, float]]:
    """Every combination of the effect's shape values; one empty one where it has no shape."""
    grid = effect.grid(scales) if effect.grid else {}
    return [dict(zip(grid, values, strict=True)) for values in product(*grid.values())]


def count_shapes(effect: Effect, scales: Scales) -> int:
    """How many combinations of shape values an effect starts from."""
    return len(list_shapes(effect, scales))


def count_starts(effect: Effect, scales: Scales) -> int:
    """From how many of its starting points, the most promising first, a fit with an effect is searched."""
    shapes = count_shapes(effect, scales)
    if shapes > MANY_SHAPES:
        return shapes
    return MANY_SHAPES_STARTS if shapes >= FEW_SHAPES else FEW_SHAPES_STARTS


def within_bounds(model: Model, name: str, value: float) -> float:
    """``value`` of a constant, or the bound that it exceeds."""
    low, high = model.parameter(name).bounds
    return min(max(value, low), high)


def is_neutral(model: Model, effect: Effect) -> bool:
    """Whether an effect that a fit may change changes nothing as it stands: its amplitudes are zero, or at their neutral values.

    An effect that replaces a law has no neutral value; it begins where it stands.
    """
    names = model.names_of(effect.name)
    values, free = model.values, {q.name for q in model.free_parameters}
    amplitudes = [name for name in effect.amplitudes if names[name] in values]
    absent = all(values[names[name]] == effect.neutral.get(name, 0.0) for name in amplitudes)
    return bool(amplitudes) and absent and any(names[name] in free for name in amplitudes)


def list_neutral_values(model: Model) -> dict[str, float]:
    """Constant -> the value at which its effect is absent, of the effects that a fit may take away from where they stand."""
    values, free = model.values, {q.name for q in model.free_parameters}
    neutral: dict[str, float] = {}
    for effect in model.effects:
        names = model.names_of(effect.name)
        absent = {names[n]: effect.neutral.get(n, 0.0) for n in effect.amplitudes if names[n] in values}
        if not is_neutral(model, effect) and set(absent) <= free:
            neutral |= absent
    bounds = {q.name: q.bounds for q in model.free_parameters}
    return neutral if all(bounds[n][0] <= value <= bounds[n][1] for n, value in neutral.items()) else {}
