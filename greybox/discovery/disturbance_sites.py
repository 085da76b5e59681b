"""Where something may be missing in a model, and how an unknown signal there reaches the sensors.

The fitted model is linearised along its own run: ``d x_{k+1} = Phi_k d x_k + Gamma_k w_k``, ``d y_k = C_k d x_k``, with ``w`` held between
samples. Dry friction has no slope and is left out, and so is a delay. What an effect sets after each step (play) slides: held, it would
hide from its sensor all that drives it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache

import numpy as np
from scipy.linalg import eigh, expm

from greybox.base.linear_algebra import range_basis
from greybox.base.numerics import SAME_DIRECTION
from greybox.data.noise.noise_model import AutoRegression
from greybox.discovery.problem import FittedCandidate
from greybox.estimation.transcription.shooting_cost import SingleShooting
from greybox.model import Model
from greybox.simulation.free_run import linearise_along


class SiteKind(StrEnum):
    """What a disturbance may be added to."""

    BALANCE = "balance"
    INPUT = "input"
    SENSOR = "sensor"


def site_label(kind: str, name: str) -> str:
    """The name by which a site is known: ``balance force``, ``input u``, ``sensor of x``."""
    return f"{kind} {name}" if kind != SiteKind.SENSOR else f"sensor of {name}"


@dataclass(frozen=True)
class DisturbanceSite:
    """A balance, an input or a sensor of a model: its ``name``, ``kind`` and the ``unit`` of what may be missing there.

    ``column``: position of the balance's state, of the input or of the output.
    """

    name: str
    kind: SiteKind
    unit: str
    column: int

    @property
    def label(self) -> str:
        """The name by which the site is known in results."""
        return site_label(self.kind, self.name)


@dataclass(frozen=True, eq=False)
class LinearisedRun:
    """The model along rows ``first`` to ``first + R`` of one record.

    ``phi`` (R-1, nx, nx), ``c`` (R, ny, nx), and for each site ``gamma`` (R-1, nx), zero for sensors; ``x`` (R, nx) and ``u`` (R, nu)
    are the run and its inputs, ``time`` (R,) in seconds. A time-invariant model has one entry of ``phi``, ``c`` and ``gamma``, not R.
    """

    record: int
    first: int
    time: np.ndarray
    x: np.ndarray
    u: np.ndarray
    phi: np.ndarray
    c: np.ndarray
    gamma: dict[DisturbanceSite, np.ndarray]

    @property
    def rows(self) -> int:
        """Samples in the stretch."""
        return len(self.time)


def list_disturbance_sites(model: Model, measured: Sequence[str]) -> list[DisturbanceSite]:
    """Every balance of the plant in which something can be missing, every input, and the sensor of every output in ``measured``."""
    system, plant = model.system, {s.name for s in model.states} - model.auxiliary
    sites = [
        DisturbanceSite(b.name, SiteKind.BALANCE, b.unit, system.state_names.index(b.state))
        for b in system.balances
        # A balance that only says what a rate is (dx/dt = v) lacks nothing.
        if b.state in plant and not system.rhs[system.state_names.index(b.state)].is_symbolic()
    ]
    sites += [
        DisturbanceSite(i.name, SiteKind.INPUT, i.unit, k)
        for k, i in enumerate(model.inputs)
        if i.name not in model.auxiliary
    ]
    return sites + [
        DisturbanceSite(o.name, SiteKind.SENSOR, o.unit, k) for k, o in enumerate(model.outputs) if o.name in measured
    ]


def linearise_run(candidate: FittedCandidate, record: int, first: int, rows: int) -> LinearisedRun:
    """The candidate's model along a stretch of one of its records."""
    problem, model, variables = candidate.problem, candidate.model, candidate.variables
    system, measured = model.system, problem.records[record]
    run = unwhitened_shooting(candidate).simulate(variables.here)[record]
    # A delayed input widens the kernel's record; the linearisation is about the input as it is now.
    stretch = slice(first, first + rows)
    x, u = measured.samples(run[1])[stretch], measured.samples(measured.u)[stretch]
    time = problem.experiments[record].time[stretch]
    p = variables.parameters(variables.here, record)
    sites = list_disturbance_sites(model, [o.name for o in model.outputs])
    a, b, c, _, storages = map(np.nan_to_num, linearise_along(system, x, u, p, slide=True, others=[system.storages]))
    storage = storages[:, :, 0]
    steps = np.diff(time)
    if len(a) == 1 and np.allclose(steps, steps[0], rtol=1e-6):
        steps = steps[:1]
    count = max(len(steps), 1)
    directions = {site: _direction(site, b, storage) for site in sites if site.kind != SiteKind.SENSOR}
    nx = x.shape[1]
    block = np.zeros((count, nx + len(directions), nx + len(directions)))
    block[:, :nx, :nx] = (a[:-1] if len(a) > 1 else a) * steps[:, None, None]
    for k, direction in enumerate(directions.values()):
        block[:, :nx, nx + k] = (direction[:-1] if len(direction) > 1 else direction) * steps[:, None]
    exponential = expm(block)
    gamma = {site: exponential[:, :nx, nx + k] for k, site in enumerate(directions)}
    gamma |= {site: np.zeros((1, nx)) for site in sites if site.kind == SiteKind.SENSOR}
    return LinearisedRun(record, first, time, x, u, exponential[:, :nx, :nx], c, gamma)


def unwhitened_shooting(candidate: FittedCandidate) -> SingleShooting:
    """The candidate's residuals in units of the noise, not whitened."""
    return candidate.problem.with_plain_squares().shooting(candidate.variables)


def are_indistinguishable(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether two input directions (R, nx) differ by a factor only: then no sensor can tell them apart."""
    if one.shape != other.shape or not (one.any() and other.any()):
        return False
    a, b = one / np.linalg.norm(one), other / np.linalg.norm(other)
    return bool(min(np.abs(a - b).max(), np.abs(a + b).max()) < SAME_DIRECTION)


def _direction(site: DisturbanceSite, b: np.ndarray, storage: np.ndarray) -> np.ndarray:
    """What a unit at ``site`` does to the rates (R, nx)."""
    if site.kind == SiteKind.INPUT:
        return b[:, :, site.column]
    direction = np.zeros_like(storage)
    direction[:, site.column] = 1 / storage[:, site.column]
    return direction


# The unexplained signal at one site of a model: a smoothing spline through the residual, and how likely the site is.
#
# At a site the signal ``w`` is piecewise linear in time with a smoothness prior (an Ornstein-Uhlenbeck process slower than the
# stretch, of intensity ``q``). With ``H`` the sensors' response to each knot, the residual is ``r = J theta + H c + noise``. Constants and
# the initial state of the stretch (``theta``, which could have absorbed part of it) are projected out; what is left is Bayesian
# linear regression, whose marginal likelihood picks ``q`` and ranks the sites (G. Wahba 1990, Spline models for observational data).


@dataclass(frozen=True, eq=False)
class SmoothedSignal:
    """``w`` at the knots: ``rows`` (K,) of the stretch, ``value`` and ``std`` (K,) in the site's unit; ``gain`` in nats over no signal.

    ``intensity``: the one of the prior that was likeliest.
    """

    rows: np.ndarray
    value: np.ndarray
    std: np.ndarray
    gain: float
    intensity: float


# Rows between the knots of the signal.
KNOT_SPACING = 4
# Lowest, highest and number of intensities of the signal that are tried: the rms of its response over the noise.
LOCALISATION_INTENSITIES: tuple[float, float, int] = (0.001, 10000.0, 29)
# Correlation time of the signal, in stretches.
LOCALISATION_MEMORY = 0.5


@dataclass(frozen=True, eq=False)
class SignalSmoother:
    """The smoother of one site, ready for any residual of the stretch.

    ``response`` (R*m, K) of the whitened sensors, what is projected out removed; ``absorbing`` (R*m, L) an orthonormal basis of that.
    """

    knots: np.ndarray
    response: np.ndarray
    absorbing: np.ndarray
    root: np.ndarray
    values: np.ndarray
    vectors: np.ndarray
    intensities: tuple[float, float, int]

    @classmethod
    def at_site(
        cls,
        line: LinearisedRun,
        site: DisturbanceSite,
        weight: np.ndarray,
        colour: tuple[AutoRegression, ...],
        basis: np.ndarray,
        present: np.ndarray,
    ) -> SignalSmoother:
        """For one site.

        Parameters
        ----------
        line
            The model linearised along the stretch.
        site
            Where the signal acts.
        weight
            One over the noise of each output (m,).
        colour
            Colour of the noise of each output.
        basis
            What the parameters and the initial state could have absorbed, as `absorbed_basis` gives it.
        present
            Where something was measured (R, m).
        """
        knots, tent = _tent(line.rows, KNOT_SPACING)
        flat = whiten_columns(respond(line, site, tent) * weight[:, None], colour, present)[present]
        flat = flat - basis @ (basis.T @ flat)
        root = _prior_root(len(knots), LOCALISATION_MEMORY)
        gram = root.T @ (flat.T @ flat) @ root  # of flat @ root, whose many rows are gone through once
        size = float(np.sqrt(np.trace(gram) / max(len(flat), 1)))
        if size > 0:
            root, gram = root / size, gram / size**2
        values, vectors = eigh(gram)
        return cls(knots, flat, basis, root, np.maximum(values, 0.0), vectors, LOCALISATION_INTENSITIES)

    def smooth(self, r: np.ndarray, intensity: float | None = None) -> SmoothedSignal:
        """The signal that the whitened residual ``r`` (present samples,) shows; of the likeliest intensity, or the one given."""
        free = r - self.absorbing @ (self.absorbing.T @ r)
        push = self.vectors.T @ (self.root.T @ (self.response.T @ free))
        tried = np.geomspace(*self.intensities) if intensity is None else np.array([intensity])
        q2 = tried[:, None] ** 2
        gains = 0.5 * np.sum(push**2 * q2 / (1 + q2 * self.values) - np.log1p(q2 * self.values), axis=1)
        best = int(np.argmax(gains))
        shrunk = q2[best] / (1 + q2[best] * self.values)
        spread = self.root @ self.vectors
        value = spread @ (shrunk * push)
        std = np.sqrt(np.maximum((spread**2) @ shrunk, 0.0))
        return SmoothedSignal(self.knots, value, std, float(gains[best]), float(tried[best]))


def absorbed_basis(
    line: LinearisedRun,
    weight: np.ndarray,
    colour: tuple[AutoRegression, ...],
    absorbing: np.ndarray,
    present: np.ndarray,
) -> np.ndarray:
    """Orthonormal basis (R*m, L) of what constants (``absorbing``, (R, m, n)) and the initial state of the stretch can do."""
    initial = whiten_columns(_initial(line) * weight[:, None], colour, present)
    return range_basis(np.concatenate([absorbing, initial], axis=2)[present])


def whiten_columns(values: np.ndarray, colour: tuple[AutoRegression, ...], present: np.ndarray) -> np.ndarray:
    """Columns (R, m, L) through the noise's whitening filter, output by output; zero where nothing was measured."""
    if not any(c.order for c in colour):
        return np.where(present[:, :, None], values, 0.0)
    gaps = np.where(present[:, :, None], values, np.nan)
    white = np.stack([c.whiten(gaps[:, j]) for j, c in enumerate(colour)], axis=1)
    return np.where(present[:, :, None], white, 0.0)


@lru_cache(maxsize=2)
def _tent(rows: int, spacing: int) -> tuple[np.ndarray, np.ndarray]:
    """Knots (K,) and hat functions (rows, K): linear interpolation between the knots. Both are shared, and not to be written to."""
    knots = np.unique(np.append(np.arange(0, rows, spacing), rows - 1))
    tent = np.stack([np.interp(np.arange(rows), knots, row) for row in np.eye(len(knots))], axis=1)
    for values in (knots, tent):
        values.setflags(write=False)
    return knots, tent


def _prior_root(count: int, memory: float) -> np.ndarray:
    """Lower triangle L of the prior covariance LL' of a stationary first-order process of variance one at the knots."""
    a = float(np.exp(-1 / (memory * count)))
    lags = np.arange(count)[:, None] - np.arange(count)
    root = np.where(lags >= 0, a ** np.maximum(lags, 0) * np.sqrt(1 - a * a), 0.0)
    root[:, 0] /= np.sqrt(1 - a * a)
    return root


def respond(line: LinearisedRun, site: DisturbanceSite, signals: np.ndarray) -> np.ndarray:
    """Outputs (R, ny, K) of the linearised model to each of the ``signals`` (R, K) at ``site``."""
    ny = line.c.shape[1]
    if site.kind == SiteKind.SENSOR:
        response = np.zeros((line.rows, ny, signals.shape[1]))
        response[:, site.column] = signals
        return response
    return _simulate_linear(line, np.zeros((line.x.shape[1], signals.shape[1])), line.gamma[site], signals)


def _initial(line: LinearisedRun) -> np.ndarray:
    """Outputs (R, ny, nx) to each initial state of the stretch."""
    nx = line.x.shape[1]
    return _simulate_linear(line, np.eye(nx), np.zeros((1, nx)), np.zeros((line.rows, nx)))


@np.errstate(
    over="ignore", invalid="ignore"
)  # an unstable stretch grows beyond all numbers: what is not finite explains nothing
def _simulate_linear(line: LinearisedRun, x: np.ndarray, gamma: np.ndarray, w: np.ndarray) -> np.ndarray:
    """Outputs (R, ny, L) from the initial state ``x`` (nx, L) and the signals ``w`` (R, L) through ``gamma`` (R-1, nx)."""
    states = np.empty((line.rows, *x.shape))
    constant_phi, constant_gamma = len(line.phi) == 1, len(gamma) == 1
    for k in range(line.rows):
        states[k] = x
        if k < line.rows - 1:
            x = line.phi[0 if constant_phi else k] @ x + gamma[0 if constant_gamma else k][:, None] * w[k]
    return line.c @ states
