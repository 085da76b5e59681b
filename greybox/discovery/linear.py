"""The one screen of a search: what an effect would add along the run of a fitted set, and by how much that promises to lower its error.

An effect adds a signal to rates and outputs, a function of states, inputs and its own constants. Along the run ``x(t)`` of a set without it
that signal is ``d = f_with(x, z, u) - f(x, u)``, its own states ``z`` driven by the run; it reaches the outputs through the run's linear
response, ``dx_{k+1} = Phi_k dx_k + Gamma_k d_k``. One Gauss-Newton step beside the set's own constants says what a multiple of it takes
(a Schur complement). No model with the effect is compiled or run. What has no slope at zero (a width, a threshold, a resonance) is tried at
several amplitudes and shapes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import casadi as ca
import numpy as np
from scipy.linalg import expm

from greybox.base.numerics import TINY
from greybox.discovery.disturbance_sites import unwhitened_shooting
from greybox.discovery.execution import FailureLog, SearchStage
from greybox.discovery.problem import FittedCandidate
from greybox.discovery.table import RIDGE, LinearisedSet
from greybox.model import Effect, Model, System
from greybox.model.effects.scales import Scales, count_starts, list_effect_values, within_bounds
from greybox.simulation.free_run import linearise_along
from greybox.simulation.integrators.step import call_function
from greybox.simulation.kernel.record import Record

# Amplitudes that are tried, in multiples of an effect's probe.
SCREENED_AMPLITUDES = (0.1, 1.0, 10.0)
# How far the step may take an amplitude from the tried one, as a factor: farther the line says nothing.
MOST_SCALED = 30.0
# Columns that are stepped along the records side by side, in values: 64 MB.
SCREENED_VALUES = 8e6
# Substeps of a sample in which the states of an effect follow the run.
OWN_SUBSTEPS = 4


@dataclass(frozen=True)
class EffectPromise:
    """An effect beside a set: what one step promises to take of the set's sum of squares, and where a refit of the two begins.

    ``starts``: values of all constants of the model with both, the most promising first; ``shapes``: those of the effect's own constants,
    by its own names.
    """

    effect: Effect
    decrease: float
    starts: tuple[Mapping[str, float], ...] = ()
    shapes: tuple[Mapping[str, float], ...] = ()


@dataclass(frozen=True, eq=False)
class LinearRun:
    """A fitted set along its fitted records: the run, and how what is added to its rates reaches the outputs."""

    slopes: LinearisedSet

    @property
    def candidate(self) -> FittedCandidate:
        """The set, with all records in its problem."""
        return self.slopes.candidate

    @cached_property
    def records(self) -> list[_RecordRun]:
        """Its runs over the fitted records."""
        candidate = self.candidate
        variables = candidate.variables
        runs = unwhitened_shooting(candidate).simulate(variables.here)
        return [
            _RecordRun(
                candidate.model.system,
                candidate.problem.records[e],
                runs[e][1],
                variables.parameters(variables.here, e),
            )
            for e in range(self.slopes.fitted)
        ]

    def screen(
        self,
        effects: Sequence[Effect],
        scales: Scales,
        failures: FailureLog,
        shapes: Mapping[str, Sequence[Mapping[str, float]]] = {},
    ) -> list[EffectPromise]:
        """What each effect promises beside the set, the most promising first; none of those that cannot stand there.

        ``shapes``: the only values of the effect's constants that are tried, by its own names, where they are given.
        """
        columns: list[_Column] = []
        for effect in effects:
            listed = partial(self._list_columns, effect, scales, shapes.get(effect.name))
            columns += failures.attempt(SearchStage.PREPARATION, (*self.candidate.effects, effect.name), listed, [])
        made: dict[int, list[tuple[float, float, _Column, np.ndarray]]] = {}  # two curves have the same name
        for chunk in self._chunks(columns):
            responses = [
                record.respond([column.signals[e] for column in chunk]) for e, record in enumerate(self.records)
            ]
            noise = self.candidate.problem.noise.std[:, None]
            step = promise_decrease(self.slopes, [response / noise for response in responses])
            for k, column in enumerate(chunk):
                decrease, factor, move = float(step.decrease[k]), float(step.factor[k]), step.move(k)
                if factor < 0 and not column.takes_any_sign:
                    # The records ask for the sign that it cannot have: at this size it promises nothing.
                    decrease, factor, move = 0.0, 1.0, np.zeros_like(move)
                made.setdefault(id(column.effect), []).append((decrease, factor, column, move))
        promises = []
        for tried in made.values():
            tried.sort(key=lambda one: -one[0])
            effect = tried[0][2].effect
            starts = tuple(self._list_starts(tried, count_starts(effect, scales)))
            inner = {outer: name for name, outer in tried[0][2].model.names_of(effect.name).items()}
            shown = tuple({inner[n]: v for n, v in column.values.items()} for _, _, column, _ in tried)
            promises.append(EffectPromise(effect, tried[0][0], starts, shown))
        return sorted(promises, key=lambda promise: -promise.decrease)

    def predict(self, effect: Effect, values: Mapping[str, float]) -> list[np.ndarray]:
        """What an effect with these constants, by the model's names, adds to the outputs (N, ny) of each fitted record, to first order."""
        model = self.candidate.model + effect
        return [record.respond([_Adder(record, model, effect).add(values)])[:, :, 0] for record in self.records]

    def _list_columns(
        self, effect: Effect, scales: Scales, shapes: Sequence[Mapping[str, float]] | None
    ) -> list[_Column]:
        model, columns = self.candidate.model + effect, []
        names = model.names_of(effect.name)
        free = [names[name] for name in effect.amplitudes if effect.probe and name not in effect.neutral]
        takes_any_sign = any(model.parameter(name).bounds[0] < 0 for name in free)
        adders = [_Adder(record, model, effect) for record in self.records]
        # What an amplitude scales is the same at each: one says all.
        amplitudes = (1.0,) if adders[0].is_linear_in(free) else SCREENED_AMPLITUDES
        listed = (
            list_effect_values(model, effect, scales, amplitudes)
            if shapes is None
            else [{names[n]: within_bounds(model, names[n], v) for n, v in shape.items()} for shape in shapes]
        )
        for values in listed:
            signals = [adder.add(values) for adder in adders]
            if all(np.isfinite(each).all() for pair in signals for each in pair):
                scaled = {name: values[name] for name in free if name in values}
                columns.append(_Column(effect, model, values, scaled, takes_any_sign, signals))
        return columns

    def _chunks(self, columns: Sequence[_Column]) -> Iterator[Sequence[_Column]]:
        size = sum(record.size for record in self.records)
        at_once = max(int(SCREENED_VALUES // max(size, 1)), 1)
        for first in range(0, len(columns), at_once):
            yield columns[first : first + at_once]

    def _list_starts(
        self, tried: Sequence[tuple[float, float, _Column, np.ndarray]], most: int
    ) -> Iterator[dict[str, float]]:
        """The best column with its amplitudes as the step has them, beside the set as it is and as the step moves it; the next shapes."""
        candidate = self.candidate
        variables = candidate.variables
        for k, (_, factor, column, move) in enumerate(tried[:most]):
            share = float(np.clip(abs(factor), 1 / MOST_SCALED, MOST_SCALED)) * (1 if factor >= 0 else -1)
            scaled = {n: within_bounds(column.model, n, share * v) for n, v in column.scaled.items()}
            of_effect = {**column.values, **scaled}
            yield {**candidate.model.values, **of_effect}
            if not k:
                low, high = variables.bounds()
                moved = variables.constants(np.clip(move, low, high))
                names = [candidate.model.system.parameter_names[j] for j in variables.which]
                yield {**candidate.model.values, **dict(zip(names, map(float, moved), strict=True)), **of_effect}


@dataclass(frozen=True, eq=False)
class _Column:
    """An effect with given constants: what it adds along each record, and which of the constants scale it."""

    effect: Effect
    model: Model
    values: Mapping[str, float]
    scaled: Mapping[str, float]
    takes_any_sign: bool
    signals: Sequence[tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True, eq=False)
class _RecordRun:
    """A run over one record: ``x`` (R, nx) at every row, and the constants ``p`` that hold there."""

    system: System
    record: Record
    x: np.ndarray
    p: np.ndarray

    @property
    def size(self) -> int:
        """Values of one column."""
        return self.x.size

    @cached_property
    def _linear(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """``Phi``, ``Gamma`` (R-1, nx, nx) over each interval and ``C`` (R, ny, nx); one entry where they are the same all along."""
        x, u = self.x, self.record.u[:, : len(self.system.input_names)]
        a, _, c, _ = map(np.nan_to_num, linearise_along(self.system, x, u, self.p, slide=True))
        h, n = self.record.h, x.shape[1]
        if len(a) == 1 and len(self.record.lengths) == 1:
            h = h[:1]
        elif len(a) > 1:
            # Between two rows: their mean, exact to the second order in the interval.
            a = 0.5 * (a[:-1] + a[1:])
        block = np.zeros((max(len(h), len(a)), 2 * n, 2 * n))
        block[:, :n, :n] = a * h[:, None, None]
        block[:, :n, n:] = np.eye(n) * h[:, None, None]
        with np.errstate(over="ignore", invalid="ignore"):
            exponential = expm(block)
        phi, gamma = exponential[:, :n, :n], exponential[:, :n, n:]
        if self.system.dry:
            phi, gamma = (np.broadcast_to(m, (len(x) - 1, n, n)).copy() for m in (phi, gamma))
            for friction in self.system.dry:
                # What sticks does not move, whatever small pushes it.
                stuck = (x[1:, friction.state] == 0) & (x[:-1, friction.state] == 0)
                phi[stuck, friction.state], gamma[stuck, friction.state] = 0.0, 0.0
        return phi, gamma, c

    def arrive(self, system: System, p: np.ndarray, effect: Effect | None = None) -> tuple[np.ndarray, np.ndarray]:
        """The inputs (R, nu) as they reach the plant at the start and at the end of each interval."""
        record, count = self.record, len(system.input_names)
        starts = record.u[:, :count]
        ends = record.find_ends(np.arange(len(starts)))[:, :count]
        if effect is not None and effect.late:
            rows = np.clip(np.arange(len(starts)) + effect.late, 0, len(starts) - 1)
            starts, ends = starts[rows], ends[rows]
        if effect is not None and effect.hold:
            after = np.vstack([starts[1:], starts[-1:]])
            ends = starts if effect.hold == "zero" else after
        for delay in system.delays:
            seconds = float(ca.Function("delay", [system.p], [delay.seconds])(p))
            time = np.concatenate([[0.0], np.cumsum(record.h)])
            # The mean over an interval of what was there ``seconds`` before; nothing before the first row.
            passed = np.concatenate([[0.0], np.cumsum(0.5 * (starts + ends)[:-1, delay.column] * record.h)])
            late = np.interp(time - seconds, time, passed)
            mean = np.append(np.diff(late) / record.h, starts[-1, delay.column])
            starts, ends = starts.copy(), ends.copy()
            starts[:, delay.column] = ends[:, delay.column] = mean
        return starts, ends

    def respond(self, signals: Sequence[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
        """Outputs of the samples (N, ny, K) to what is added to rates and outputs."""
        phi, gamma, c = self._linear
        rates = np.stack([rate for rate, _ in signals], axis=2)  # (R-1, nx, K)
        outputs = np.stack([output for _, output in signals], axis=2)
        states = np.zeros((len(self.x), *rates.shape[1:]))
        constant = len(phi) == 1
        # What runs away promises nothing (`promise_decrease`).
        with np.errstate(over="ignore", invalid="ignore"):
            pushed = np.matmul(gamma, rates)
            for k in range(len(pushed)):
                states[k + 1] = phi[0 if constant else k] @ states[k] + pushed[k]
            response = np.matmul(c, states) + outputs
        return self.record.samples(response)


class _Adder:
    """What an effect adds along one run, as a function of its own constants."""

    def __init__(self, record: _RecordRun, model: Model, effect: Effect) -> None:
        self.record, self.model = record, model
        plain, system = record.system, model.system
        names = model.names_of(effect.name)
        self.own_names = [n for n in system.parameter_names if n in {names[q.name] for q in effect.parameters}]
        places = {name: k for k, name in enumerate(plain.parameter_names)}
        index = {name: k for k, name in enumerate(system.parameter_names)}
        self.p = np.array([record.p[places[n]] if n in places else model.values[n] for n in system.parameter_names])
        self.q = system.p[[index[n] for n in self.own_names]]
        self.known = [system.state_names.index(name) for name in plain.state_names]
        self.own = [k for k in range(len(system.state_names)) if k not in self.known]
        # Everything but its own constants as numbers, and the plain equations in the symbols of the larger model.
        shared = [n for n in system.parameter_names if n not in self.own_names]
        constants = system.p[[index[n] for n in shared]], ca.DM([self.p[index[n]] for n in shared])
        # An effect may move the input in time: the plain equations have their own.
        self.plain_u = ca.SX.sym("u", plain.u.numel())
        inner = ca.vertcat(plain.x, plain.u, plain.p)
        outer = ca.vertcat(system.x[self.known], self.plain_u, ca.DM(record.p))
        rates, outputs = ca.substitute([plain.explicit, plain.outputs], [inner], [outer])
        with_rates, with_outputs = ca.substitute([system.explicit, system.outputs], [constants[0]], [constants[1]])
        self.rates, self.outputs = with_rates[self.known] - rates, with_outputs - outputs
        self.own_rates = with_rates[self.own]
        self.updates = [(u.state, ca.substitute(u.value, *constants)) for u in system.updates if u.state in self.own]
        self.system, self.effect = system, effect
        self._functions: dict[str, ca.Function] = {}
        outputs = ca.substitute(outputs, self.plain_u, system.u)
        same = all(ca.is_equal(with_outputs[k], outputs[k], COMPARED_DEPTH) for k in range(outputs.numel()))
        self.has_outputs = not same
        self.is_delayed = bool(system.delays)
        self.arrived = record.arrive(system, self.p, effect)
        self.plain_arrived = record.arrive(plain, record.p)

    def is_linear_in(self, names: Sequence[str]) -> bool:
        """Whether what is added is a multiple of these constants, all of the effect's amplitudes."""
        if not names or self.is_delayed:
            return False
        amplitudes = self.q[[self.own_names.index(n) for n in names if n in self.own_names]]
        every = ca.vertcat(self.rates, self.outputs)
        slopes = ca.jacobian(every, amplitudes)
        follows = ca.vertcat(self.own_rates, *(value for _, value in self.updates))
        return not ca.depends_on(slopes, amplitudes) and not (self.own and ca.depends_on(follows, amplitudes))

    def add(self, values: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        """What is added to the rates over each interval (R-1, nx), and to the outputs at each row (R, ny)."""
        record, system = self.record, self.system
        q = np.array([values.get(n, self.model.values[n]) for n in self.own_names])
        starts, ends = self.arrived
        if self.is_delayed:
            p = self.p.copy()
            p[[system.parameter_names.index(n) for n in self.own_names]] = q
            starts, ends = record.arrive(system, p, self.effect)
        x = np.zeros((len(record.x), len(system.state_names)))
        x[:, self.known] = record.x
        between = 0.5 * (x[:-1] + x[1:])
        if self.own:
            x[:, self.own], between[:, self.own] = self._follow(x, starts, ends, q)
        mean, of_plain = (0.5 * (u[0] + u[1])[:-1] for u in ((starts, ends), self.plain_arrived))
        rates = self._map("rates", self.rates, len(between))(between, mean, of_plain, q)
        outputs = np.zeros((len(x), self.outputs.numel()))
        if self.has_outputs:
            outputs = self._map("outputs", self.outputs, len(x))(x, starts, self.plain_arrived[0], q)
        return rates, outputs

    def _map(self, name: str, expression: ca.SX, rows: int) -> Callable[..., np.ndarray]:
        """``expression`` at each row: states, inputs with the effect and without it (R, nu), its constants (nq,) -> (R, m)."""
        if name not in self._functions:
            system = self.system
            one = ca.Function(name, [system.x, system.u, self.plain_u, self.q], [ca.densify(expression)])
            self._functions[name] = one.map(f"{name}_rows", "serial", rows, [3], [])
        function = self._functions[name]
        return lambda x, u, without, q: call_function(function, x.T, u.T, without.T, q)[0].T

    def _follow(
        self, x: np.ndarray, starts: np.ndarray, ends: np.ndarray, q: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The states of the effect along the run, at each row (R, nz) and their means over each interval (R-1, nz)."""
        if "follow" not in self._functions:
            self._functions["follow"] = self._build_follower(len(x) - 1)
        p = self.p.copy()
        p[[self.system.parameter_names.index(n) for n in self.own_names]] = q
        begun = np.asarray(self.system.start_function(p)[0]).ravel()[self.own]
        rows = np.hstack([x[:-1], starts[:-1], x[1:], ends[:-1], self.record.record.h[:, None]])
        run, mean = call_function(self._functions["follow"], np.concatenate([begun, q]), rows.T)
        return np.vstack([begun, run[: len(self.own)].T]), mean.T

    def _build_follower(self, intervals: int) -> ca.Function:
        """(states and constants of the effect, rows of the run) -> the same after each interval, and the means of the states over it."""
        system, places = self.system, self.own
        wide = len(system.state_names) + system.u.numel()
        before, after, h = ca.SX.sym("before", wide), ca.SX.sym("after", wide), ca.SX.sym("h")
        now = ca.SX.sym("now", len(places))
        slope = ca.jacobian(self.own_rates, system.x[places])

        def put(expression: ca.SX, share: float, value: ca.SX) -> ca.SX:
            between = (1 - share) * before + share * after
            between[places] = value
            return ca.substitute(expression, ca.vertcat(system.x, system.u), between)

        reached, part, mean = ca.SX(now), h / OWN_SUBSTEPS, ca.SX(0.5 * now)
        for k in range(OWN_SUBSTEPS):
            share = (k + 0.5) / OWN_SUBSTEPS
            j = put(slope, share, reached)
            if len(places) == 1:
                # What drives it is straight over the substep: z + part (phi_1(a) g + phi_2(a) g'), a = part j.
                first, last = (put(self.own_rates, (k + end) / OWN_SUBSTEPS, reached) for end in (0, 1))
                a = part * j
                far = ca.fabs(a) > FLAT
                safe = ca.if_else(far, a, 1.0)
                one = ca.if_else(far, (ca.exp(ca.fmin(a, MOST_GROWTH)) - 1) / safe, 1.0)
                two = ca.if_else(far, (one - 1) / safe, 0.5)
                reached = reached + part * (one * first + two * (last - first))
            else:
                # Linearly implicit midpoint rule.
                g = put(self.own_rates, share, reached)
                reached = reached + part * ca.solve(ca.SX.eye(len(places)) - 0.5 * part * j, g)
            mean = mean + (reached if k < OWN_SUBSTEPS - 1 else 0.5 * reached)
        mean = mean / OWN_SUBSTEPS
        for state, value in self.updates:
            place = places.index(state)
            reached[place] = put(value, 1.0, reached)
            mean[place] = 0.5 * (now[place] + reached[place])
        whole = ca.vertcat(reached, self.q)
        arguments = [ca.vertcat(now, self.q), ca.vertcat(before, after, h)]
        interval = ca.Function("follow", arguments, [ca.densify(whole), ca.densify(mean)])
        return interval.mapaccum("follow_rows", intervals)


# How deep two expressions are compared, and the exponents between which a growth is straight or cut off.
COMPARED_DEPTH, FLAT, MOST_GROWTH = 50, 1e-6, 50.0


# Share of a signal's sum of squares outside the span of the constants below which it is within.
ABSORBED = 1e-6


@dataclass(frozen=True, eq=False)
class LinearStep:
    """One Gauss-Newton step of a set with each of K signals: ``decrease`` (K,) of the sum of squares, ``factor`` (K,) of the signal; and
    what the set's own unknowns do alone (n,) and to make up for each signal (n, K).
    """

    decrease: np.ndarray
    factor: np.ndarray
    alone: np.ndarray
    shared: np.ndarray

    def move(self, k: int) -> np.ndarray:
        """The step (n,) of the set's own unknowns with signal number ``k``."""
        return np.asarray(-self.alone + self.shared[:, k] * self.factor[k])


def promise_decrease(slopes: LinearisedSet, responses: Sequence[np.ndarray]) -> LinearStep:
    """By how much the sum of squares of the fitted records falls in one step with each of the responses (N, ny, K) over the noise."""
    n, count = slopes.candidate.variables.size, responses[0].shape[2]
    hessian, gradient = RIDGE * np.eye(n), np.zeros(n)
    mixed, square, pull = np.zeros((n, count)), np.full(count, RIDGE), np.zeros(count)
    for e in range(slopes.fitted):
        columns, present = slopes.columns(e), slopes.present[e]
        j, r, g = slopes.jacobians[e][present], slopes.residuals[e][present], responses[e][present]
        hessian[np.ix_(columns, columns)] += j.T @ j
        gradient[columns] += j.T @ r
        mixed[columns] += j.T @ g
        square += np.einsum("nk,nk->k", g, g)
        pull += r @ g
    usable = np.isfinite(mixed).all(axis=0) & np.isfinite(square)
    mixed, square, pull = np.where(usable, mixed, 0.0), np.where(usable, square, 1.0), np.where(usable, pull, 0.0)
    if not (np.isfinite(hessian).all() and np.isfinite(gradient).all()):
        # A run that nearly goes astray: nothing is promised.
        return LinearStep(np.zeros(count), np.zeros(count), np.zeros(n), np.zeros((n, count)))
    # In units in which each unknown alone has a curvature of one: beside the curvatures of a steep run the ridge is lost in rounding.
    unit = 1 / np.sqrt(np.diag(hessian))
    scaled = hessian * np.outer(unit, unit) + n * np.finfo(float).eps * np.eye(n)
    # The Schur complement of the constants: (g'r - g'J H^-1 J'r)^2 / (g'g - g'J H^-1 J'g).
    absorbed = unit[:, None] * np.linalg.solve(scaled, unit[:, None] * np.column_stack([gradient, mixed]))
    alone, shared = absorbed[:, 0], absorbed[:, 1:]
    pull = pull - mixed.T @ alone
    rest = square - (mixed * shared).sum(axis=0)
    # What the constants of the set do as well promises nothing.
    pull, rest = np.where(rest > ABSORBED * square, pull, 0.0), np.maximum(rest, TINY)
    return LinearStep(pull**2 / rest, pull / rest, alone, shared)
