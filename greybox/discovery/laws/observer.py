"""An observer that keeps a model on its records although a term is missing: what it has to correct shows which.

A free run of a model without one of its terms soon is somewhere else, and a term computed along it is another term. An extended Kalman
filter follows the records; its innovations ``e`` are what the model did not foresee from one row to the next, and their slopes along the
first state, along the constants, and along a signal at any balance, are those of a linear recursion with the filter's gains in it:

    de = C s + D,    s+ = A s + B.

So a term is ranked by a linear regression of the innovations on its signal, with the constants of the plain model beside it, and states
that no sensor sees are as good as the others. (L. Ljung 1979, Asymptotic behavior of the extended Kalman filter as a parameter estimator.)
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from greybox.base.numerics import OFF_REST, TINY
from greybox.estimation.transcription.problem import EstimationProblem
from greybox.model import Effect, Model
from greybox.model.signals import Parameter
from greybox.simulation.filtering.kalman_filter import FilterRow, Moments, correct_by_measurement
from greybox.simulation.integrators.runge_kutta import rk4


@dataclass(frozen=True, eq=False)
class ObservedRecord:
    """One record as the observer reads it.

    ``y`` (N, ny) with NaN where nothing was measured, ``u`` (N, nu), ``h`` (N-1,) seconds, ``start`` and ``spread`` (nx,) of the first
    state, ``scale`` (nx,) the size of each state's motion; ``straight`` (nu,): which inputs move between rows.
    """

    y: np.ndarray
    u: np.ndarray
    h: np.ndarray
    start: np.ndarray
    spread: np.ndarray
    scale: np.ndarray
    straight: np.ndarray

    @property
    def duration(self) -> float:
        """Seconds."""
        return float(self.h.sum())


@dataclass(frozen=True, eq=False)
class FilteredRun:
    """A run of the observer over one record; outputs are taken in one after the other, so that innovations are scalars.

    ``x`` (N, nx) corrected states, ``e`` (N, ny) innovations over their deviation, zero where nothing was measured, ``slopes``
    (N, ny, nx + np) theirs along the first state and the constants; ``likelihood`` is minus twice its logarithm. The recursion of
    further slopes is that of ``a`` (N, nx, nx), of a signal at a site ``b`` (N, nx, sites), and ``c`` (N, ny, nx).
    """

    x: np.ndarray
    e: np.ndarray
    slopes: np.ndarray
    likelihood: float
    a: np.ndarray
    b: np.ndarray
    c: np.ndarray

    def slopes_of_signals(self, signals: np.ndarray, site: int) -> np.ndarray:
        """Slopes of the innovations (N, ny, L) along signals (N, L) at balance number ``site``."""
        middle = 0.5 * (signals[1:] + signals[:-1])
        s = np.zeros((self.x.shape[1], signals.shape[1]))
        slopes = np.empty((*self.e.shape, signals.shape[1]))
        for k in range(len(signals)):
            slopes[k] = self.c[k] @ s
            if k < len(middle):
                s = self.a[k] @ s + self.b[k, :, site, None] * middle[k]
        return slopes

    def smooth_start(self, record: ObservedRecord) -> np.ndarray:
        """The first state (nx,) as all rows show it: x0 - P0 sum (de/dx0)' e (A. E. Bryson, M. Frazier 1963, Smoothing for
        linear and nonlinear dynamic systems).
        """
        nx = len(record.start)
        return record.start - record.spread**2 * np.einsum("njx,nj->x", self.slopes[:, :, :nx], self.e)


# Names of the constant force at a balance along which a signal's slopes are taken.
PUSH, SIZE = "push", "size"


class StateObserver:
    """The extended Kalman filter of a model, made once for it; rows are gone through inside CasADi."""

    def __init__(self, model: Model, names: Sequence[str], sites: Sequence[tuple[str, str]], substeps: int) -> None:
        forces = [
            Effect(f"{PUSH}_{k}", site, [Parameter(SIZE, unit, 0.0)], terms=lambda x, u, p: p[SIZE], amplitudes=(SIZE,))
            for k, (site, unit) in enumerate(sites)
        ]
        model = replace(model, effects=(*model.effects, *forces))
        self.model, system, step = model, model.system, rk4(model.system)
        self.columns = [system.parameter_names.index(n) for n in names]
        pushes = [system.parameter_names.index(model.names_of(f"{PUSH}_{k}")[SIZE]) for k in range(len(sites))]
        x, u, p = system.x, system.u, system.p
        nx, ny, count = x.numel(), system.outputs.numel(), len(names)
        free, sizes = (ca.vertcat(ca.SX(0, 1), *[p[c] for c in columns]) for columns in (self.columns, pushes))

        # To the next row.
        following_u, h, after = ca.SX.sym("u1", u.numel()), ca.SX.sym("h"), x
        for k in range(substeps):
            ends = (u + (following_u - u) * (m / substeps) for m in (k, k + 1))
            after = step.advance(after, *ends, p, h / substeps)
        along = [ca.densify(part) for part in (after, *(ca.jacobian(after, z) for z in (x, free, sizes)))]
        advance = ca.Function("advance", [x, u, following_u, p, h], along)

        # The readings of a row in; a state stays within its bounds.
        P, S = ca.SX.sym("P", nx, nx), ca.SX.sym("S", nx, nx + count)
        y, seen, noise, push = (ca.SX.sym(n, m) for n, m in (("y", ny), ("seen", ny), ("r", ny), ("q", nx)))
        row = FilterRow(u, y, seen, ca.SX(0))
        corrected, innovation = correct_by_measurement(step, Moments(x, P), row, p, noise)
        low, high = (np.array([state.bounds[k] for state in system.states]) for k in (0, 1))
        bounded = ca.fmin(ca.fmax(corrected.x, low), high)
        next_x, slope, of_free, of_sizes = advance(bounded, u, following_u, p, h)
        # A = da/dx dx+/dx-, B = [0, da/dp], C and D the slopes of the innovations.
        a = slope @ ca.jacobian(corrected.x, x)
        c, d = (ca.jacobian(innovation.standardised, z) for z in (x, free))
        next_S = a @ S + ca.horzcat(ca.SX.zeros(nx, nx), of_free)
        next_P = slope @ corrected.P @ slope.T + ca.diag(push * h)
        state, following = (ca.vertcat(x, ca.vec(P), ca.vec(S)), ca.vertcat(next_x, ca.vec(next_P), ca.vec(next_S)))
        slopes = c @ S + ca.horzcat(ca.SX.zeros(ny, nx), d)
        results = [bounded, innovation.standardised, innovation.logarithm, slopes, a, of_sizes, c]
        given = [state, ca.vertcat(y, seen, u, following_u, h), ca.vertcat(p, noise, push)]
        made = ca.cse([following, *(ca.densify(ca.vec(part)) for part in results)])
        self._row = ca.Function("row", given, made)
        self._runs: dict[int, ca.Function] = {}

    def run(
        self, record: ObservedRecord, constants: np.ndarray, noise: np.ndarray, intensity: float
    ) -> FilteredRun | None:
        """Over one record, with process noise that moves each state by ``intensity`` scales over the record; None where it fails."""
        rows, ny = record.y.shape
        nx = len(record.start)
        if rows not in self._runs:
            self._runs[rows] = self._row.mapaccum(rows)
        after = np.where(record.straight, np.vstack([record.u[1:], record.u[-1:]]), record.u)
        seen = np.isfinite(record.y)
        given = np.hstack([np.nan_to_num(record.y), seen, record.u, after, np.append(record.h, 0.0)[:, None]]).T
        p = np.array(list(self.model.values.values()))
        p[self.columns] = constants
        push = (intensity * record.scale) ** 2 / record.duration
        start = np.hstack([np.eye(nx), np.zeros((nx, len(constants)))])
        first = np.concatenate([record.start, np.diag(record.spread**2).ravel(), start.T.ravel()])
        fixed = np.tile(np.concatenate([p, noise, push])[:, None], rows)
        x, e, log, *parts = (np.asarray(r).T for r in self._runs[rows](first, given, fixed)[1:])
        with np.errstate(over="ignore"):  # a run that goes astray is none
            likelihood = float(np.sum(e**2) + np.sum(log))
        if not (np.isfinite(likelihood) and np.isfinite(parts[0]).all()):
            return None
        # CasADi's columns are read as rows.
        slopes, a, b, c = (
            part.reshape(rows, -1, n).transpose(0, 2, 1) for part, n in zip(parts, (ny, nx, nx, ny), strict=True)
        )
        return FilteredRun(x, e, slopes, likelihood, a, b, c)


def _size_of_rate(y: np.ndarray, time: np.ndarray, measured: Mapping[str, int], of: str) -> float:
    """Root-mean-square rate of a state that a sensor reads; 0 for another one."""
    if of not in measured:
        return 0.0
    quotient = np.diff(y[:, measured[of]]) / np.diff(time)
    return float(np.sqrt(np.nanmean(quotient**2))) if np.isfinite(quotient).any() else 0.0


def observe_records(
    estimation: EstimationProblem,
    initial: Mapping[str, Sequence[float]],
    pushed: Collection[str],
    rates: Mapping[str, str],
    most_rows: int,
) -> list[ObservedRecord]:
    """The records of a problem for an observer of its model; ``initial`` are first states by name, one value a record.

    Only states that are ``pushed`` have process noise: nothing is missing in the definition of a state that no sensor reads.
    ``rates``: state -> the state whose rate it is by definition, and whose readings then show how large it is.
    """
    model = estimation.model
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
        time = estimation.experiments[e].time
        every = max(1, -(-len(time) // most_rows))
        straight = record.is_linear > 0  # a band-limited input is nearer to a straight line
        # Of a held input the mean acts from one row that is kept to the next.
        starts = np.arange(0, len(time), every)
        means = np.add.reduceat(u, starts, axis=0) / np.diff(np.append(starts, len(time)))[:, None]
        y, u, time = y[::every], np.where(straight, u[::every], means), time[::every]
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
        observed.append(ObservedRecord(y, u, np.diff(time), start, spread, scale, straight))
    return observed
