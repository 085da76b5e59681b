"""Where model and data disagree: the unexplained signal at each site, and how likely each site is.

At one site at a time (a balance, or a sensor) an unknown slowly varying signal ``w`` is added to the fitted linear model,
``w+ = a w + noise of intensity q``, and the residual's likelihood is computed by a steady Kalman filter for a grid of ``q``.
Constants and initial states are projected out through their sensitivities, which pass the same filter (they could have
absorbed part of the signal). The best site is where the data are most likely; sites within a small lead cannot be told apart
with these sensors.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
from scipy.linalg import expm

from greybox.discovery.bench import Trial
from greybox.model import System

# Intensities tried, as rms of the response over the noise; rows used at most; Riccati steps.
INTENSITIES = (0.03, 0.3, 3.0, 30.0)
MOST_ROWS, RICCATI = 2000, 300
# A site leads only if its log-likelihood is this far ahead, or this share of what it gained.
LEAD, LEAD_SHARE = 10.0, 0.01


@dataclass(frozen=True)
class Site:
    """A place of the model, how much likelier the residual is with an unknown signal there (nats), and its intensity."""

    name: str
    gain: float
    intensity: float


def sites(trial: Trial) -> list[Site]:
    """Every balance and every measured output of a linear model, likeliest first; empty for a nonlinear one."""
    system = trial.problem.model.system
    record = trial.problem.records[0]
    if not (system.linear and trial.problem.step.per_interval and len(record.lengths) == 1):
        return []
    r, jacobian = trial.problem.shooting(trial.variables).residuals(np.zeros(trial.variables.size))[0]
    measured = np.flatnonzero(np.isfinite(r).any(axis=0))
    columns = np.concatenate([r[:, :, None], jacobian], axis=2)[:MOST_ROWS, measured]
    columns = np.nan_to_num(columns)
    scaled = 1 / trial.problem.noise.std[measured]
    found = []
    for name, phi, gamma, output in _places(trial, float(record.lengths[0]), measured, scaled):
        plain = _likelihood(columns, phi, gamma, output, 0.0)
        tried = [(_likelihood(columns, phi, gamma, output, q) - plain, q) for q in INTENSITIES]
        gain, q = max(tried)
        found.append(Site(name, gain, q))
    return sorted(found, key=lambda s: -s.gain)


def likeliest(found: list[Site]) -> list[str]:
    """The names that the sensors cannot tell from the best one; none if no site explains anything."""
    if not found or found[0].gain < LEAD:
        return []
    lead = max(LEAD, LEAD_SHARE * found[0].gain)
    return [s.name for s in found if found[0].gain - s.gain <= lead]


def _places(
    trial: Trial, h: float, measured: np.ndarray, scale: np.ndarray
) -> list[tuple[str, np.ndarray, np.ndarray, np.ndarray]]:
    """Name, transition, way in and way out (scaled by the noise) of an unknown signal at each site."""
    system, p = trial.problem.model.system, trial.variables.fixed
    nx = system.x.numel()
    pieces = (
        ca.jacobian(system.rhs, system.x),
        ca.jacobian(system.rhs, system.u),
        ca.jacobian(system.outputs, system.x),
    )
    a, b, c = (m.full() for m in ca.Function("m", [system.p], list(pieces))(p))
    ways = {
        bal.name: np.eye(nx)[:, system.state_names.index(bal.state)]
        for bal in system.balances
        if not _is_definition(system, bal.state)
    }
    # An input that enters one balance only is that balance; one that enters several is a place of its own.
    ways |= {name: b[:, k] for k, name in enumerate(system.input_names) if np.count_nonzero(b[:, k]) > 1}
    c = np.column_stack([scale[:, None] * c[measured], np.zeros(len(measured))])
    result = []
    for name, way in ways.items():
        block = np.zeros((nx + 1, nx + 1))
        block[:nx, :nx], block[:nx, nx] = a * h, way * h
        e = expm(block)
        result.append((name, e[:nx, :nx], e[:nx, nx], c))
    for j, k in enumerate(measured):
        direct = np.zeros((len(measured), nx + 1))
        direct[j, nx] = 1.0
        result.append((f"sensor of {system.output_names[k]}", np.zeros((nx, nx)), np.zeros(nx), direct))
    return result


def _is_definition(system: System, state: str) -> bool:
    """Whether a balance only says what a rate is (``dx/dt = v``): nothing can be missing there."""
    return bool(system.rhs[system.state_names.index(state)].is_symbolic())


def _likelihood(columns: np.ndarray, phi: np.ndarray, gamma: np.ndarray, output: np.ndarray, q: float) -> float:
    """Log-likelihood of the residual (first column) with the other columns projected out, for a signal of intensity ``q``."""
    rows, m, _ = columns.shape
    nx = len(phi)
    transition = np.zeros((nx + 1, nx + 1))
    transition[:nx, :nx], transition[:nx, nx], transition[nx, nx] = phi, gamma, 1 - 3 / rows
    response = _peak_response(transition, output)
    noise = np.zeros((nx + 1, nx + 1))
    noise[nx, nx] = (q / response) ** 2 if response > 0 else 0.0
    covariance, gain = np.zeros((nx + 1, nx + 1)), np.zeros((nx + 1, m))
    s = np.eye(m)
    for _ in range(RICCATI):
        s = output @ covariance @ output.T + np.eye(m)
        gain = transition @ covariance @ output.T @ np.linalg.inv(s)
        covariance = transition @ covariance @ transition.T + noise - gain @ s @ gain.T
    innovations = _innovations(columns, transition - gain @ output, gain, output)
    whitened = np.einsum("ij,kjl->kil", np.linalg.inv(np.linalg.cholesky(s)), innovations).reshape(rows * m, -1)
    residual, slopes = whitened[:, 0], whitened[:, 1:]
    left = residual - slopes @ np.linalg.lstsq(slopes, residual, rcond=1e-10)[0]
    return float(-0.5 * (left @ left) - 0.5 * rows * np.linalg.slogdet(s)[1])


def _peak_response(transition: np.ndarray, output: np.ndarray) -> float:
    """Largest output (in noise standard deviations) that a unit signal causes within a hundred samples."""
    x = np.zeros(len(transition))
    x[-1] = 1.0
    largest = 0.0
    for _ in range(100):
        x = transition @ x
        x[-1] = 1.0
        largest = max(largest, float(np.abs(output @ x).max()))
    return largest


def _innovations(columns: np.ndarray, closed: np.ndarray, gain: np.ndarray, output: np.ndarray) -> np.ndarray:
    """Each column minus its one-step prediction, by the steady filter."""
    x = np.zeros((len(closed), columns.shape[2]))
    result = np.empty_like(columns)
    for k, y in enumerate(columns):
        result[k] = y - output @ x
        x = closed @ x + gain @ y
    return result
