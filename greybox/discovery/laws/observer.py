"""An observer that keeps a model on its records although a term is missing: what it has to correct shows which.

A free run of a model without one of its terms soon is somewhere else, and a term computed along it is another term. An extended Kalman
filter follows the records; its innovations ``e`` are what the model did not foresee from one row to the next, and their slopes along the
constants, and along a signal at any balance, are those of a linear recursion with the filter's gains:

    s- = A s+ + B,    de = -(C s- + D),    s+ = s- - K (C s- + D).

So a term is ranked by a linear regression of the innovations on its signal, with the constants of the plain model beside it, and states
that no sensor sees are as good as the others. (L. Ljung 1979, Asymptotic behavior of the extended Kalman filter as a parameter estimator.)
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from greybox.base.numerics import OFF_REST, TINY
from greybox.discovery.problem import DiscoveryProblem
from greybox.model import Model, System


@dataclass(frozen=True, eq=False)
class ObservedRecord:
    """One record as the observer reads it.

    ``y`` (N, ny) with NaN where nothing was measured, ``u`` (N, nu), ``h`` (N-1,) seconds, ``start`` and ``spread`` (nx,) of the first
    state, ``scale`` (nx,) the size of each state's motion; ``holds``: whether inputs are held between rows.
    """

    y: np.ndarray
    u: np.ndarray
    h: np.ndarray
    start: np.ndarray
    spread: np.ndarray
    scale: np.ndarray
    holds: bool

    @property
    def duration(self) -> float:
        """Seconds."""
        return float(self.h.sum())


@dataclass(frozen=True, eq=False)
class FilteredRun:
    """A run of the observer over one record; outputs are taken in one after the other, so that innovations are scalars.

    ``x`` (N, nx) corrected states, ``e`` (N, ny) innovations over their deviation, zero where nothing was measured,
    ``slopes`` (N, ny, np) theirs along the constants, ``start`` (nx,) the first state; ``likelihood`` is minus twice its logarithm.
    """

    x: np.ndarray
    e: np.ndarray
    slopes: np.ndarray
    start: np.ndarray
    likelihood: float


@dataclass(frozen=True, eq=False)
class FilterTape:
    """What the observer's recursion was made of along a run: with it the slopes along any signal follow.

    ``a`` (N, nx, nx), ``g`` (N, nx, sites), ``c`` and ``gain`` (N, ny, nx), ``weight`` (N, ny), one over the deviation of each innovation.
    """

    a: np.ndarray
    g: np.ndarray
    c: np.ndarray
    gain: np.ndarray
    weight: np.ndarray

    def slopes_of_start(self) -> np.ndarray:
        """Of the innovations along the first state (N, ny, nx)."""
        return self._propagate(np.eye(self.a.shape[1]), None, 0)

    def slopes_of_signals(self, signals: np.ndarray, site: int) -> np.ndarray:
        """Of the innovations along signals (N, L) at balance number ``site`` (N, ny, L)."""
        middle = 0.5 * (signals[1:] + signals[:-1])
        return self._propagate(np.zeros((self.a.shape[1], signals.shape[1])), middle, site)

    def _propagate(self, s: np.ndarray, middle: np.ndarray | None, site: int) -> np.ndarray:
        rows, ny = self.weight.shape
        slopes = np.empty((rows, ny, s.shape[1]))
        for k in range(rows):
            for j in range(ny):
                of_output = self.c[k, j] @ s
                slopes[k, j] = -self.weight[k, j] * of_output
                s = s - self.gain[k, j, :, None] * of_output
            if k < rows - 1:
                s = self.a[k] @ s
                if middle is not None:
                    s += self.g[k, :, site, None] * middle[k]
        return slopes


class StateObserver:
    """An extended Kalman filter of a model, made once for it; rows are gone through inside CasADi."""

    def __init__(self, model: Model, names: Sequence[str], sites: Sequence[str], substeps: int) -> None:
        system = model.system
        self.names, self.sites = tuple(names), tuple(sites)
        self.columns = [system.parameter_names.index(n) for n in names]
        x, u, p = system.x, system.u, system.p
        nx, ny, count = x.numel(), system.outputs.numel(), len(names)
        u1, h, w = ca.SX.sym("u1", u.numel()), ca.SX.sym("h"), ca.SX.sym("w", len(sites))
        after = _integrate(system, sites, x, u, u1, p, h, w, substeps)
        free = ca.vertcat(*[p[c] for c in self.columns]) if count else ca.SX(0, 1)
        no_push = ca.DM.zeros(len(sites))
        slopes = [
            ca.substitute(part, w, no_push)
            for part in (after, ca.jacobian(after, x), ca.jacobian(after, free), ca.jacobian(after, w))
        ]
        advance = ca.Function("advance", [x, u, u1, p, h], [ca.densify(part) for part in slopes])
        y = system.outputs
        read = ca.Function("read", [x, u, p], [ca.densify(q) for q in (y, ca.jacobian(y, x), ca.jacobian(y, free))])
        low, high = (np.array([s.bounds[k] for s in system.states]) for k in (0, 1))

        # One row: the readings in, then to the next row.
        z, cov, s = ca.SX.sym("z", nx), ca.SX.sym("P", nx, nx), ca.SX.sym("S", nx, count)
        reading, seen, variance, push = (ca.SX.sym(n, m) for n, m in (("y", ny), ("seen", ny), ("r", ny), ("q", nx)))
        predicted, of_x, of_p = read(z, u, p)
        corrected, p_now, s_now = z, cov, s
        e, weight, log, gains, e_slopes = [], [], 0, [], []
        for j in range(ny):
            c = of_x[j, :]
            spread = ca.mtimes([c, p_now, c.T]) + variance[j]
            error = reading[j] - predicted[j] - ca.mtimes(c, corrected - z)
            gain = seen[j] * ca.mtimes(p_now, c.T) / spread
            of_output = ca.mtimes(c, s_now) + of_p[j, :]
            e.append(seen[j] * error / ca.sqrt(spread))
            weight.append(seen[j] / ca.sqrt(spread))
            e_slopes.append(-weight[-1] * of_output)
            log += seen[j] * ca.log(spread)
            corrected = corrected + gain * error
            keep = ca.SX.eye(nx) - ca.mtimes(gain, c)
            p_now = ca.mtimes([keep, p_now, keep.T]) + ca.mtimes(gain, gain.T) * variance[j]
            s_now = s_now - ca.mtimes(gain, of_output)
            gains.append(gain.T)
        limited = [
            ca.fmin(ca.fmax(corrected[k], low[k]), high[k])
            if np.isfinite(low[k]) or np.isfinite(high[k])
            else corrected[k]
            for k in range(nx)
        ]
        corrected = ca.vertcat(*limited)
        foreseen, a, b, g = advance(corrected, u, u1, p, h)
        p_next = ca.mtimes([a, p_now, a.T]) + ca.diag(push * h)
        s_next = ca.mtimes(a, s_now) + b
        state = ca.vertcat(z, ca.vec(cov), ca.vec(s))
        following = ca.vertcat(foreseen, ca.vec(p_next), ca.vec(s_next))
        given = [state, ca.vertcat(reading, seen, u, u1, h), ca.vertcat(p, variance, push)]
        results = [corrected, ca.vertcat(*e), log, ca.vec(ca.vertcat(*e_slopes))]
        tape = [
            corrected,
            ca.vec(p_now),
            ca.vec(cov),
            z,
            ca.vec(a),
            ca.vec(g),
            ca.vec(of_x),
            ca.vec(ca.vertcat(*gains)),
            ca.vertcat(*weight),
        ]
        self._row = ca.Function("row", given, [following, *map(ca.densify, results)])
        self._tape = ca.Function("tape", given, [following, *map(ca.densify, tape)])
        self._sizes = nx, ny, count
        self._runs: dict[tuple[str, int], ca.Function] = {}

    def run(self, record: ObservedRecord, p: np.ndarray, noise: np.ndarray, intensity: float) -> FilteredRun | None:
        """Over one record, with process noise that moves each state by ``intensity`` scales over the record; None where it fails."""
        _, ny, count = self._sizes
        x, e, log, slopes = self._over("row", record, p, noise, intensity)
        likelihood = float(np.sum(e**2) + np.sum(log))
        if not (np.isfinite(likelihood) and np.isfinite(slopes).all()):
            return None
        rows = x.shape[1]
        return FilteredRun(x.T, e.T, slopes.T.reshape(rows, count, ny).transpose(0, 2, 1), x[:, 0].copy(), likelihood)

    def tape(
        self, record: ObservedRecord, p: np.ndarray, noise: np.ndarray, intensity: float
    ) -> tuple[FilterTape, np.ndarray]:
        """The same run with all that its recursion was made of, and the first state (nx,) as all rows show it."""
        nx = self._sizes[0]
        x, corrected, predicted, foreseen, a, g, c, gain, weight = self._over("tape", record, p, noise, intensity)
        rows = x.shape[1]

        def square(values: np.ndarray, columns: int) -> np.ndarray:
            return values.T.reshape(rows, columns, -1).transpose(0, 2, 1)

        tape = FilterTape(square(a, nx), square(g, len(self.sites)), square(c, nx), square(gain, nx), weight.T)
        # The smoother of Rauch, Tung and Striebel (1965), back to the first row.
        late = x[:, -1]
        now, before = square(corrected, nx), square(predicted, nx)
        for k in range(rows - 2, -1, -1):
            gains = np.linalg.lstsq(before[k + 1], tape.a[k] @ now[k], rcond=None)[0].T
            late = x[:, k] + gains @ (late - foreseen[:, k + 1])
        return tape, late

    def _over(
        self, which: str, record: ObservedRecord, p: np.ndarray, noise: np.ndarray, intensity: float
    ) -> list[np.ndarray]:
        nx, _, count = self._sizes
        rows = len(record.y)
        key = which, rows
        if key not in self._runs:
            self._runs[key] = (self._row if which == "row" else self._tape).mapaccum(rows)
        after = record.u if record.holds else np.vstack([record.u[1:], record.u[-1:]])
        seen = np.isfinite(record.y)
        given = np.hstack([np.nan_to_num(record.y), seen, record.u, after, np.append(record.h, 0.0)[:, None]]).T
        push = (intensity * record.scale) ** 2 / record.duration
        first = np.concatenate([record.start, np.diag(record.spread**2).ravel(), np.zeros(nx * count)])
        fixed = np.concatenate([p, noise**2, push])
        return [np.asarray(r) for r in self._runs[key](first, given, np.tile(fixed[:, None], rows))[1:]]


def _integrate(
    system: System,
    sites: Sequence[str],
    x: ca.SX,
    u: ca.SX,
    u1: ca.SX,
    p: ca.SX,
    h: ca.SX,
    w: ca.SX,
    substeps: int,
) -> ca.SX:
    """The state after ``h`` seconds by Runge-Kutta steps, with signals ``w`` held at the sites."""
    force = ca.SX.zeros(x.numel())
    for k, site in enumerate(sites):
        row = system.state_names.index(next(b.state for b in system.balances if b.name == site))
        force[row] += w[k] / system.storages[row]
    rate = ca.Function("rate", [x, u, p, w], [system.explicit + force])
    z, step = x, h / substeps
    for k in range(substeps):
        ua, um, ub = (u + (u1 - u) * (k + s) / substeps for s in (0, 0.5, 1))
        k1 = rate(z, ua, p, w)
        k2 = rate(z + step / 2 * k1, um, p, w)
        k3 = rate(z + step / 2 * k2, um, p, w)
        k4 = rate(z + step * k3, ub, p, w)
        z = z + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return z


def _size_of_rate(y: np.ndarray, time: np.ndarray, measured: Mapping[str, int], of: str) -> float:
    """Root-mean-square rate of a state that a sensor reads; 0 for another one."""
    if of not in measured:
        return 0.0
    quotient = np.diff(y[:, measured[of]]) / np.diff(time)
    return float(np.sqrt(np.nanmean(quotient**2))) if np.isfinite(quotient).any() else 0.0


def observe_records(
    problem: DiscoveryProblem,
    model: Model,
    initial: Mapping[str, Sequence[float]],
    pushed: Collection[str],
    rates: Mapping[str, str],
    most_rows: int,
) -> list[ObservedRecord]:
    """The estimation records for an observer of ``model``; ``initial`` are first states by name, one value a record.

    Only states that are ``pushed`` have process noise: nothing is missing in the definition of a state that no sensor reads.
    ``rates``: state -> the state whose rate it is by definition, and whose readings then show how large it is.
    """
    estimation = problem.prepare(model)
    names = model.system.state_names
    measured = {
        system_output.name(): j
        for j in range(len(model.outputs))
        if (system_output := model.system.outputs[j]).is_symbolic()
    }
    noise = estimation.noise.std
    observed = []
    for e, record in enumerate(estimation.records):
        y, u = record.samples(record.y), record.samples(record.u)
        time = problem.experiments[e].time
        every = max(1, -(-len(time) // most_rows))
        holds = problem.experiments[e].hold == "zero"  # a band-limited input is nearer to a straight line
        if holds and every > 1:  # what acts from one row that is kept to the next
            starts = np.arange(0, len(time), every)
            u = np.add.reduceat(u, starts, axis=0) / np.diff(np.append(starts, len(time)))[:, None]
        y, u, time = y[::every], u if holds and every > 1 else u[::every], time[::every]
        start = estimation.variables.initial.guess[e].astype(float).copy()
        spread, scale = np.empty(len(names)), np.empty(len(names))
        for j, name in enumerate(names):
            if name in measured and np.isfinite(y[:, measured[name]]).any():
                column = y[:, measured[name]]
                scale[j] = max(float(np.nanstd(column)), TINY)
                spread[j] = 3 * noise[measured[name]]
                if np.isfinite(column[0]):
                    start[j] = column[0]
            else:
                start[j] = initial[name][e] if name in initial else start[j]
                size = _size_of_rate(y, time, measured, rates.get(name, ""))
                spread[j] = abs(start[j]) or size or 1.0
                scale[j] = (size or spread[j]) if name in pushed else 0.0
                start[j] = start[j] or OFF_REST * size  # where a root of it has a slope
        observed.append(ObservedRecord(y, u, np.diff(time), start, spread, scale, holds))
    return observed
