"""The unexplained signal at one site of a model: a smoothing spline through the residual, and how likely the site is.

At a site the signal ``w`` is piecewise linear in time with a smoothness prior (an Ornstein-Uhlenbeck process slower than the
stretch, of intensity ``q``). With ``H`` the sensors' response to each knot, the residual is ``r = J theta + H c + noise``. Constants and
the initial state of the stretch (``theta``, which could have absorbed part of it) are projected out; what is left is Bayesian
linear regression, whose marginal likelihood picks ``q`` and ranks the sites (G. Wahba 1990, Spline models for observational data).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg import eigh

from greybox.discovery.disturbance_sites import DisturbanceSite, LinearisedRun, SiteKind
from greybox.discovery.policy import LocalisationPolicy
from greybox.linear_algebra import range_basis
from greybox.noise import AutoRegression


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
        policy: LocalisationPolicy,
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
        policy
            Knots, memory and intensities of the signal.
        """
        knots, tent = _tent(line.rows, policy.knot_spacing)
        flat = whiten_columns(_response(line, site, tent) * weight[:, None], colour, present)[present]
        flat = flat - basis @ (basis.T @ flat)
        root = _prior_root(len(knots), policy.memory)
        gram = root.T @ (flat.T @ flat) @ root  # of flat @ root, whose many rows are gone through once
        size = float(np.sqrt(np.trace(gram) / max(len(flat), 1)))
        if size > 0:
            root, gram = root / size, gram / size**2
        values, vectors = eigh(gram)
        return cls(knots, flat, basis, root, np.maximum(values, 0.0), vectors, policy.intensities)

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


def _response(line: LinearisedRun, site: DisturbanceSite, tent: np.ndarray) -> np.ndarray:
    """Outputs (R, ny, K) of the linearised model to each hat function at ``site``."""
    ny = line.c.shape[1]
    if site.kind == SiteKind.SENSOR:
        response = np.zeros((line.rows, ny, tent.shape[1]))
        response[:, site.column] = tent
        return response
    return _simulate_linear(line, np.zeros((line.x.shape[1], tent.shape[1])), line.gamma[site], tent)


def _initial(line: LinearisedRun) -> np.ndarray:
    """Outputs (R, ny, nx) to each initial state of the stretch."""
    nx = line.x.shape[1]
    return _simulate_linear(line, np.eye(nx), np.zeros((1, nx)), np.zeros((line.rows, nx)))


def _simulate_linear(line: LinearisedRun, x: np.ndarray, gamma: np.ndarray, w: np.ndarray) -> np.ndarray:
    """Outputs (R, ny, L) from the initial state ``x`` (nx, L) and the signals ``w`` (R, L) through ``gamma`` (R-1, nx)."""
    states = np.empty((line.rows, *x.shape))
    constant_phi, constant_gamma = len(line.phi) == 1, len(gamma) == 1
    for k in range(line.rows):
        states[k] = x
        if k < line.rows - 1:
            x = line.phi[0 if constant_phi else k] @ x + gamma[0 if constant_gamma else k][:, None] * w[k]
    return line.c @ states
