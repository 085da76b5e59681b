"""Which of thousands of terms are worth a refit: ranked by a regression in the observer, the best run through it once more."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import casadi as ca
import numpy as np
from scipy.linalg import block_diag
from scipy.special import ndtri

from greybox.base.numerics import TINY
from greybox.discovery.execution import SearchStage
from greybox.discovery.laws.observer import FilteredRun, ObservedRecord, StateObserver, observe_records
from greybox.discovery.laws.terms import LawTerm, list_terms
from greybox.discovery.problem import DiscoveryProblem
from greybox.model.model import Model


@dataclass(frozen=True, eq=False)
class ObservedModel:
    """A model fitted in the observer: ``values`` of its constants, first states by name (one a record), minus twice the log-likelihood."""

    model: Model
    values: Mapping[str, float]
    initial: Mapping[str, tuple[float, ...]]
    objective: float
    intensity: float
    records: Sequence[ObservedRecord]
    runs: Sequence[FilteredRun]
    prior: np.ndarray
    """Mean and standard deviation (np, 2) of the constants before the records were seen."""


@dataclass(frozen=True)
class TermStart:
    """A term with start values of its constants, and what it promises: the decrease of minus twice the log-likelihood."""

    term: LawTerm
    amplitude: float
    shape: float
    lag: float
    bounds: tuple[float, float]
    decrease: float


def list_law_sites(model: Model) -> list[tuple[str, str]]:
    """Name and unit of each balance of the plant that is no definition (``dx/dt = v``)."""
    plant, definitions = {s.name for s in model.states}, _list_definitions(model)
    return [(b.name, b.unit) for b in model.system.balances if b.state in plant and b.state not in definitions]


def _list_definitions(model: Model) -> dict[str, str]:
    """State -> the state that its rate is, where ``dx/dt = v``; a fixed factor of 1 may stand before it."""
    system = model.system
    fixed = [q for q in model.parameters if q.fixed]
    symbols = ca.vertcat(*[system.p[system.parameter_names.index(q.name)] for q in fixed]) if fixed else ca.SX(0, 1)
    rates = ca.substitute(system.rhs, symbols, ca.DM([q.value for q in fixed]) if fixed else ca.DM(0, 1))
    return {
        state: rates[k].name()
        for k, state in enumerate(system.state_names)
        if rates[k].is_symbolic() and rates[k].name() in system.state_names
    }


def list_unseen_states(model: Model) -> list[str]:
    """States that no sensor reads and that are not the rate of one that a sensor reads.

    Where they were is what the plain model makes of its constants, which may be far from the truth.
    """
    measured = {y.name() for k in range(len(model.outputs)) if (y := model.system.outputs[k]).is_symbolic()}
    rates = {rate for state, rate in _list_definitions(model).items() if state in measured}
    return [s.name for s in model.states if s.name not in measured | rates]


# Standard deviation of the plain model's constants before the records are seen, over their values: the observer does not take them
# further than the records ask.
LAW_CONSTANT_SPREAD = 0.4
# Standard deviation of constants of which nothing is known, over their values and at least over 1.
UNKNOWN_SPREAD = 100.0
# Decrease of minus twice the log-likelihood below which the observer's constants stand still.
SETTLED_DECREASE = 0.5
# Runge-Kutta steps a row that the observer takes at most.
MOST_SUBSTEPS = 8
# Rows of a record that the observer runs over; of longer records every second, third... row.
LAW_MOST_ROWS = 600
# Rows of a record with inputs that it runs over: between rows that are skipped their mean acts, which a fast part of the plant does not
# believe.
MOST_DRIVEN_ROWS = 1500


def fit_in_observer(
    problem: DiscoveryProblem,
    model: Model,
    nominal: Mapping[str, float],
    initial: Mapping[str, Sequence[float]],
    intensities: Sequence[float],
    steps: int,
) -> ObservedModel | None:
    """The free constants of a model as the observer's innovations ask for; None where it cannot be run.

    ``nominal``: constants that are known to about `LawPolicy.constant_spread`; the others may be anything.
    """
    names = [q.name for q in model.free_parameters]
    estimation = problem.prepare(model)
    substeps = max(1, min(estimation.step.substeps, MOST_SUBSTEPS))
    observer = StateObserver(model, names, list_law_sites(model), substeps)
    definitions = _list_definitions(model)
    rates = {rate: state for state, rate in definitions.items()}
    pushed = [s for s in model.system.state_names if s not in list_unseen_states(model) or s not in definitions]
    records = observe_records(estimation, initial, pushed, rates, MOST_DRIVEN_ROWS if model.inputs else LAW_MOST_ROWS)
    noise = problem.noise_model.std
    bounds = np.array([model.parameter(n).bounds for n in names]).reshape(-1, 2)
    mean = np.array([model.values[n] for n in names])
    known = np.array([n in nominal for n in names], bool)
    mean[known] = [nominal[n] for n in names if n in nominal]
    spread = np.where(known, LAW_CONSTANT_SPREAD * np.abs(mean), UNKNOWN_SPREAD * np.maximum(np.abs(mean), 1.0))
    spread = np.where(spread > 0, spread, UNKNOWN_SPREAD)
    start = np.array([model.values[n] for n in names])

    def run(z: np.ndarray, intensity: float) -> tuple[float, list[FilteredRun]]:
        runs: list[FilteredRun] = []
        for record in records:
            one = observer.run(record, z, noise, intensity)
            if one is None:
                return np.inf, []
            runs.append(one)
        return sum(r.likelihood for r in runs) + float(np.sum(((z - mean) / spread) ** 2)), runs

    def at_intensity(z: np.ndarray, k: int) -> tuple[float, list[FilteredRun], int]:
        return *run(z, intensities[k]), k

    z = start
    best = _descend({}, len(intensities) // 2, partial(at_intensity, z), len(intensities))
    if not np.isfinite(best[0]):
        return None
    for _ in range(steps):
        objective, runs, at = best
        slopes = np.concatenate([r.slopes[:, :, r.x.shape[1] :].reshape(-1, len(names)) for r in runs])
        errors = np.concatenate([r.e.ravel() for r in runs])
        scaled = np.vstack([slopes * spread, np.eye(len(names))])
        target = np.concatenate([errors, (z - mean) / spread])
        move = -spread * np.linalg.lstsq(scaled, target, rcond=None)[0]
        for share in (1.0, 0.3, 0.1):
            tried = np.clip(z + share * move, bounds[:, 0], bounds[:, 1])
            new = (*run(tried, intensities[at]), at)
            if new[0] < objective:
                break
        else:
            break
        z = tried
        best = _descend({at: new}, at, partial(at_intensity, z), len(intensities))
        if objective - best[0] < SETTLED_DECREASE:
            break
    objective, runs, at = best
    firsts = np.array([r.smooth_start(record) for r, record in zip(runs, records, strict=True)])
    states = dict(zip(model.system.state_names, map(tuple, firsts.T.tolist()), strict=True))
    values = {**model.values, **dict(zip(names, map(float, z), strict=True))}
    prior = np.column_stack([mean, spread])
    return ObservedModel(model, values, states, objective, intensities[at], records, runs, prior)


def _descend(
    known: dict[int, tuple[float, list[FilteredRun], int]],
    at: int,
    evaluate: Callable[[int], tuple[float, list[FilteredRun], int]],
    count: int,
) -> tuple[float, list[FilteredRun], int]:
    """The least of a row of ``count`` values downhill from number ``at``."""

    def value(k: int) -> float:
        if not 0 <= k < count:
            return np.inf
        if k not in known:
            known[k] = evaluate(k)
        return known[k][0]

    value(at)
    if not np.isfinite(value(at)):
        at = min(range(count), key=value)
    while True:
        lowest = min((at, at - 1, at + 1), key=value)
        if lowest == at:
            return known[at]
        at = lowest


# Where time constants of memory are tried, as shares of the record.
LAG_PLACES: tuple[float, ...] = (0.01, 0.03, 0.1, 0.3)
# Terms that are propagated through the observer at once: what fits into the cache and into memory.
TERMS_AT_ONCE = 1000
# What one unit of complexity costs in Schwarz's criterion: of the many terms that could be written, complicated ones fit by chance.
COMPLEXITY_COST = 4.0


def rank_terms(observed: ObservedModel) -> list[TermStart]:
    """Every term that the model may have, with what it promises beside its complexity; best first."""
    model, runs, records = observed.model, observed.runs, observed.records
    names = [*model.system.state_names, *(i.name for i in model.inputs)]
    along = [np.column_stack([run.x, record.u]) for run, record in zip(runs, records, strict=True)]
    everywhere = dict(zip(names, np.concatenate(along).T, strict=True))
    sites = list_law_sites(model)
    free = _FreeDirections.of(observed)
    starts: dict[LawTerm, TermStart] = {}
    terms = list_terms(model, sites, everywhere)
    index = {name: k for k, (name, _) in enumerate(sites)}
    signals = _Signals(everywhere, [len(a) for a in along], [r.h for r in records])
    for site in index:
        columns = [
            (term, shape, lag)
            for term in terms
            if term.site == site
            for shape in term.shape_starts(everywhere)
            for lag in ([q * records[0].duration for q in LAG_PLACES] if term.has_memory else [0.0])
        ]
        for first in range(0, len(columns), TERMS_AT_ONCE):
            chunk = columns[first : first + TERMS_AT_ONCE]
            values = [signals.of(*column) for column in chunk]
            slopes = [
                run.slopes_of_signals(np.column_stack([v[k] for v in values]), index[site]).reshape(-1, len(chunk))
                for k, run in enumerate(runs)
            ]
            for (term, shape, lag), (decrease, amplitude) in zip(
                chunk, free.regress(np.concatenate(slopes)), strict=True
            ):
                if decrease > (starts[term].decrease if term in starts else 0.0):
                    bounds = term.shape_bounds(everywhere)
                    starts[term] = TermStart(term, amplitude, shape, lag, bounds, decrease)
    return sorted(starts.values(), key=lambda s: COMPLEXITY_COST * s.term.complexity - s.decrease)


def rank_everywhere(variants: Sequence[ObservedModel]) -> list[tuple[TermStart, ObservedModel]]:
    """Every term beside the variant of the observed model where it promises most; best first."""
    best: dict[LawTerm, tuple[float, TermStart, ObservedModel]] = {}
    for observed in variants:
        for start in rank_terms(observed):
            promise = observed.objective - start.decrease + COMPLEXITY_COST * start.term.complexity
            if start.term not in best or promise < best[start.term][0]:
                best[start.term] = promise, start, observed
    return [(start, observed) for _, start, observed in sorted(best.values(), key=lambda one: one[0])]


# Process noise of the observer that is tried, in standard deviations of a state over the whole record: the likeliest is taken.
LAW_INTENSITIES: tuple[float, ...] = (0.01, 0.1, 1.0, 10.0)
# Where a state has no sensor: other constants and first states from which the terms are ranked as well.
UNSEEN_DRAWS = 12
# Standard deviation of the first states that are drawn, over their values.
UNSEEN_SPREAD = 0.5


def observe_variants(
    problem: DiscoveryProblem, observed: ObservedModel, nominal: Mapping[str, float]
) -> list[ObservedModel]:
    """The observed model, and where a state is unseen the same from other constants and first states that are as likely beforehand.

    A term in a state that nothing shows is computed along a guess of it: one guess would hide the right term.
    """
    model = observed.model
    unseen = list_unseen_states(model)
    if not unseen:
        return [observed]
    names = [n for n in nominal if n in observed.values]
    from scipy.stats import qmc  # half a second to import

    points = ndtri(qmc.Halton(len(names) + len(unseen), scramble=False).random(UNSEEN_DRAWS + 1)[1:])
    places = {n: model.system.state_names.index(n) for n in unseen}
    starts = {n: [float(record.start[j]) for record in observed.records] for n, j in places.items()}
    variants = [observed]
    for point in points:
        # Constants keep their signs.
        values = {n: nominal[n] * float(np.exp(LAW_CONSTANT_SPREAD * z)) for n, z in zip(names, point, strict=False)}
        first = {
            n: tuple(start + UNSEEN_SPREAD * float(z) * (abs(start) or 1.0) for start in starts[n])
            for n, z in zip(unseen, point[len(names) :], strict=True)
        }
        one = problem.failures.attempt(
            SearchStage.SCREENING,
            (),
            partial(
                fit_in_observer,
                problem,
                model.start(**values),
                nominal,
                {**observed.initial, **first},
                LAW_INTENSITIES,
                0,
            ),
            None,
        )
        if one is not None:
            variants.append(one)
    return variants


# Complexity up to which a term counts as simple: such terms have a third of the places that are run through the observer.
SIMPLE_COMPLEXITY = 4


def choose_terms(
    ranked: Sequence[tuple[TermStart, ObservedModel]], count: int
) -> list[tuple[TermStart, ObservedModel]]:
    """The leading terms; a third of the places is for simple ones, that a complicated one of the same shape would hide."""
    places = range(len(ranked))
    simple = [k for k in places if ranked[k][0].term.complexity <= SIMPLE_COMPLEXITY][: count // 3]
    rest = [k for k in places if k not in simple][: count - len(simple)]
    return [ranked[k] for k in sorted((*simple, *rest))]


# Intensities of the process noise that are tried once a term is in the model, which may leave nothing to it.
FINER_INTENSITIES: tuple[float, ...] = (0.0001, 0.001, 0.01, 0.1, 1.0)
# Gauss-Newton steps in the observer with a term in the model.
TERM_STEPS = 3
# Gauss-Newton steps in the observer with a term in the model where a state has no sensor: its start is a guess.
UNSEEN_STEPS = 10


def observe_terms(
    problem: DiscoveryProblem,
    nominal: Mapping[str, float],
    starts: Sequence[tuple[TermStart, ObservedModel]],
    name: str,
) -> list[tuple[TermStart, ObservedModel]]:
    """Each term in the model beside which it was ranked and run through the observer; those that can be, best first."""
    fits: list[tuple[TermStart, ObservedModel]] = []
    for start, observed in starts:

        def fit(start: TermStart = start, observed: ObservedModel = observed) -> ObservedModel | None:
            effect = start.term.to_effect(
                name, start.amplitude, start.shape, start.lag, start.bounds, observed.records[0].duration
            )
            return fit_in_observer(
                problem,
                observed.model.start(**observed.values) + effect,
                nominal,
                observed.initial,
                FINER_INTENSITIES,
                UNSEEN_STEPS if list_unseen_states(observed.model) else TERM_STEPS,
            )

        one = problem.failures.attempt(SearchStage.SCREENING, (name,), fit, None)
        if one is not None:
            fits.append((start, one))
    return sorted(fits, key=lambda one: one[1].objective + COMPLEXITY_COST * one[0].term.complexity)


class _Signals:
    """Terms along all records: a list of arrays, one a record."""

    def __init__(
        self, everywhere: Mapping[str, np.ndarray], rows: Sequence[int], intervals: Sequence[np.ndarray]
    ) -> None:
        self._values, self._cuts, self._intervals = everywhere, np.cumsum(rows)[:-1], intervals
        self._kept: dict[tuple[object, ...], np.ndarray] = {}

    def of(self, term: LawTerm, shape: float, lag: float) -> list[np.ndarray]:
        key = (term.product, shape)
        if key not in self._kept:
            self._kept[key] = np.nan_to_num(term.evaluate(self._values, shape), posinf=0.0, neginf=0.0)
        parts = np.split(self._kept[key], self._cuts)
        return [_through_lag(part, h, lag) for part, h in zip(parts, self._intervals, strict=True)] if lag else parts


def _through_lag(w: np.ndarray, h: np.ndarray, lag: float) -> np.ndarray:
    late = np.empty_like(w)
    late[0] = 0.0
    for k, share in enumerate(1 - np.exp(-h / lag)):
        late[k + 1] = late[k] + share * (0.5 * (w[k] + w[k + 1]) - late[k])
    return late


@dataclass(frozen=True, eq=False)
class _FreeDirections:
    """What the plain model's constants and first states can do to the innovations, and what they leave of them."""

    basis: np.ndarray
    rest: np.ndarray

    @classmethod
    def of(cls, observed: ObservedModel) -> _FreeDirections:
        names, records, runs = [q.name for q in observed.model.free_parameters], observed.records, observed.runs
        mean, spread = observed.prior.T
        z = np.array([observed.values[n] for n in names])
        slopes = [r.slopes.reshape(-1, r.slopes.shape[2]) for r in runs]
        constants = np.concatenate([each[:, each.shape[1] - len(names) :] for each in slopes]) * spread
        starts = [each[:, : len(r.spread)] * r.spread for each, r in zip(slopes, records, strict=True)]
        # A first state is of its record alone.
        columns = np.hstack([constants, block_diag(*starts)])
        errors = np.concatenate([r.e.ravel() for r in runs])
        free = columns.shape[1]
        known = np.concatenate([(z - mean) / spread, np.zeros(free - len(names))])
        basis, _ = np.linalg.qr(np.vstack([columns, np.eye(free)]))
        target = np.concatenate([errors, known])
        return cls(basis, target - basis @ (basis.T @ target))

    def regress(self, slopes: np.ndarray) -> list[tuple[float, float]]:
        """For each column of slopes (R, L) the decrease of the squares that its signal promises, and its amplitude."""
        rows = len(slopes)
        upper = self.basis[:rows]
        inner = upper.T @ slopes
        left = np.sum(slopes**2, axis=0) - np.sum(inner**2, axis=0)
        push = self.rest[:rows] @ slopes  # the rest is orthogonal to the basis
        size = np.sum(slopes**2, axis=0)
        # A signal that the constants of the plain model make as well is no term of its own.
        possible = left > 1e-6 * np.maximum(size, TINY)
        safe = np.where(possible, left, 1.0)
        decrease = np.where(possible, push**2 / safe, 0.0)
        amplitude = np.where(possible, -push / safe, 0.0)
        return list(zip(decrease.tolist(), amplitude.tolist(), strict=True))
