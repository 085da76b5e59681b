"""An observer that keeps a model on its records although a term is missing: what it has to correct shows which.

A free run of a model without one of its terms soon is somewhere else, and a term computed along it is another term. An extended Kalman
filter follows the records; its innovations ``e`` are what the model did not foresee from one row to the next, and their slopes along the
constants, and along a signal at any balance, are those of a linear recursion with the filter's gains:

    s- = A s+ + B,    s+ = (I - K C) s-,    de = -(C s- + D).

So a term is ranked by a linear regression of the innovations on its signal, with the constants of the plain model beside it, and states
that no sensor sees are as good as the others. (L. Ljung 1979, Asymptotic behavior of the extended Kalman filter as a parameter estimator.)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from greybox.discovery.problem import DiscoveryProblem
from greybox.model import Model
from greybox.numerics import TINY


@dataclass(frozen=True, eq=False)
class ObservedRecord:
    """One record as the observer reads it.

    ``y`` (N, ny) with NaN where nothing was measured, ``u`` (N, nu), ``h`` (N-1,) seconds, ``start`` (nx,) and ``spread`` (nx,) of the first
    state, ``scale`` (nx,) the size of each state's motion.
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
class ObserverRun:
    """A run of the observer over one record.

    ``x`` and ``foreseen`` (N, nx) states with and before their correction, ``e`` (N, ny) innovations over their standard deviation, zero where nothing was measured; ``a``
    (N-1, nx, nx), ``b`` (N-1, nx, np), ``g`` (N-1, nx, sites), ``c`` (N, ny, nx), ``d`` (N, ny, np) and ``gain`` (N, nx, ny) as in the module's
    text, ``root`` (N, ny, ny) what turns innovations into whitened ones; ``likelihood`` is minus twice its logarithm.
    """

    x: np.ndarray
    foreseen: np.ndarray
    e: np.ndarray
    a: np.ndarray
    b: np.ndarray
    g: np.ndarray
    c: np.ndarray
    d: np.ndarray
    gain: np.ndarray
    root: np.ndarray
    predicted: np.ndarray
    corrected: np.ndarray
    likelihood: float

    def slopes_of_constants(self) -> np.ndarray:
        """Of the whitened innovations along the constants (N, ny, np)."""
        return self._propagate(np.zeros((self.x.shape[1], self.b.shape[2])), lambda k: self.b[k], self.d)

    def slopes_of_start(self) -> np.ndarray:
        """Of the whitened innovations along the first state (N, ny, nx)."""
        nx = self.x.shape[1]
        return self._propagate(np.eye(nx), lambda k: 0.0, np.zeros((len(self.x), self.e.shape[1], nx)))

    def slopes_of_signals(self, signals: np.ndarray, site: int) -> np.ndarray:
        """Of the whitened innovations along signals (N, L) at balance number ``site`` (N, ny, L)."""
        middle = 0.5 * (signals[1:] + signals[:-1])
        size = signals.shape[1]
        none = np.zeros((1, self.e.shape[1], size))
        return self._propagate(
            np.zeros((self.x.shape[1], size)),
            lambda k: self.g[k, :, site, None] * middle[k],
            np.broadcast_to(none, (len(self.x), *none.shape[1:])),
        )

    def _propagate(self, s: np.ndarray, source, direct: np.ndarray) -> np.ndarray:
        rows, ny = self.e.shape
        slopes = np.empty((rows, ny, s.shape[1]))
        for k in range(rows):
            of_output = self.c[k] @ s + direct[k]
            slopes[k] = -(self.root[k] @ of_output)
            s = s - self.gain[k] @ of_output
            if k < rows - 1:
                s = self.a[k] @ s + source(k)
        return slopes

    def first_state(self) -> np.ndarray:
        """The first state (nx,) as all rows show it: the smoother's (Rauch, Tung, Striebel 1965)."""
        x = self.x[-1]
        for k in range(len(self.x) - 2, -1, -1):
            cross = self.corrected[k] @ self.a[k].T
            foreseen = self.predicted[k + 1]
            gain = np.linalg.lstsq(foreseen.T, cross.T, rcond=None)[0].T
            x = self.x[k] + gain @ (x - self.foreseen[k + 1])
        return x


class Observer:
    """An extended Kalman filter of a model, made once for it."""

    def __init__(self, model: Model, names: Sequence[str], sites: Sequence[str], substeps: int) -> None:
        system = model.system
        self.model, self.names, self.sites, self.substeps = model, tuple(names), tuple(sites), substeps
        self.columns = [system.parameter_names.index(n) for n in names]
        states = [next(b.state for b in system.balances if b.name == s) for s in sites]
        rows = [system.state_names.index(s) for s in states]
        x, u, p = system.x, system.u, system.p
        u1, h, w = ca.SX.sym("u1", u.numel()), ca.SX.sym("h"), ca.SX.sym("w", len(sites))
        force = ca.SX.zeros(x.numel())
        for k, row in enumerate(rows):
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
        free = ca.vertcat(*[p[c] for c in self.columns]) if self.columns else ca.SX.zeros(0)
        no_push = ca.DM.zeros(len(sites))
        parts = [z, ca.jacobian(z, x), ca.jacobian(z, free), ca.jacobian(z, w)]
        parts = [ca.densify(ca.substitute(part, w, no_push)) for part in parts]
        self._advance = _Buffered(ca.Function("advance", [x, u, u1, p, h], parts))
        y = system.outputs
        reading = [ca.densify(part) for part in (y, ca.jacobian(y, x), ca.jacobian(y, free))]
        self._read = _Buffered(ca.Function("read", [x, u, p], reading))
        self._storages = ca.Function("storages", [x, u, p], [system.storages])
        self.low = np.array([s.bounds[0] for s in system.states])
        self.high = np.array([s.bounds[1] for s in system.states])

    def run(self, record: ObservedRecord, p: np.ndarray, noise: np.ndarray, intensity: float) -> ObserverRun | None:
        """Over one record, with process noise that moves each state by ``intensity`` times its scale over the record; None where it fails."""
        rows, ny = record.y.shape
        nx, count = len(record.start), len(self.columns)
        x, cov = record.start.copy(), np.diag(record.spread**2)
        push = (intensity * record.scale) ** 2 / record.duration
        xs, before, es = np.empty((rows, nx)), np.empty((rows, nx)), np.zeros((rows, ny))
        a, b, g = np.empty((rows - 1, nx, nx)), np.empty((rows - 1, nx, count)), np.empty((rows - 1, nx, len(self.sites)))
        c, d, gains = np.empty((rows, ny, nx)), np.empty((rows, ny, count)), np.zeros((rows, nx, ny))
        roots, predicted, corrected = np.zeros((rows, ny, ny)), np.empty((rows, nx, nx)), np.empty((rows, nx, nx))
        likelihood, eye = 0.0, np.eye(nx)
        for k in range(rows):
            if not (np.isfinite(x).all() and np.isfinite(cov).all()):
                return None
            predicted[k], before[k] = cov, x
            y, c[k], d[k] = self._read(x, record.u[k], p)
            seen = np.isfinite(record.y[k])
            if seen.any():
                ck = c[k][seen]
                spread = ck @ cov @ ck.T + np.diag(noise[seen] ** 2)
                error = record.y[k][seen] - y.ravel()[seen]
                try:
                    root = np.linalg.inv(np.linalg.cholesky(spread))
                except np.linalg.LinAlgError:
                    return None
                gain = cov @ ck.T @ root.T @ root
                x = x + gain @ error
                keep = eye - gain @ ck
                cov = keep @ cov @ keep.T + (gain * noise[seen] ** 2) @ gain.T
                white = root @ error
                where = np.flatnonzero(seen)
                es[k, where] = white
                roots[k][np.ix_(where, where)] = root
                gains[k][:, where] = gain
                likelihood += float(white @ white) - 2 * float(np.log(np.diag(root)).sum())
            x = np.clip(x, self.low, self.high)
            xs[k], corrected[k] = x, cov
            if k < rows - 1:
                after = record.u[k] if record.holds else record.u[k + 1]
                foreseen, a[k], b[k], g[k] = self._advance(x, record.u[k], after, p, record.h[k : k + 1])
                x = foreseen.ravel().copy()
                cov = a[k] @ cov @ a[k].T + np.diag(push * record.h[k])
        if not np.isfinite(likelihood):
            return None
        return ObserverRun(xs, before, es, a, b, g, c, d, gains, roots, predicted, corrected, likelihood)


class _Buffered:
    """A CasADi function of dense arguments that is called without copies between its own memory and arrays."""

    def __init__(self, function: ca.Function) -> None:
        self._buffer, self._evaluate = function.buffer()
        self._function = function
        self._arguments = [np.zeros(function.nnz_in(i)) for i in range(function.n_in())]
        flat = [np.zeros(function.nnz_out(i)) for i in range(function.n_out())]
        self._results = [r.reshape(function.size_out(i), order="F") for i, r in enumerate(flat)]
        for i, each in enumerate(self._arguments):
            if each.size:
                self._buffer.set_arg(i, memoryview(each))
        for i, each in enumerate(flat):
            if each.size:
                self._buffer.set_res(i, memoryview(each))

    def __call__(self, *values: np.ndarray) -> list[np.ndarray]:
        for own, value in zip(self._arguments, values, strict=True):
            own[:] = value
        self._evaluate()
        return self._results


def observe_records(problem: DiscoveryProblem, model: Model, initial: Mapping[str, Sequence[float]], most_rows: int) -> list[ObservedRecord]:
    """The estimation records for an observer of ``model``; ``initial`` are first states by name, one value a record."""
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
        y, u, time = y[::every], u[::every], time[::every]
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
                scale[j] = spread[j] = abs(start[j]) or 1.0
        holds = problem.experiments[e].hold != "first"
        observed.append(ObservedRecord(y, u, np.diff(time), start, spread, scale, holds))
    return observed


