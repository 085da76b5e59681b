"""Minimal realisation: states that no input reaches, and those that no output shows, are taken out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import qr

from greybox.export.findings import ExportFinding
from greybox.export.linearisation import Linearisation
from greybox.export.state_scaling import scale_states
from greybox.findings import Finding
from greybox.linear_algebra import REACHABILITY, range_basis
from greybox.numerics import EARLIER_STATE, REACHABILITY_RANK, TINY


def minimal_realisation(model: Linearisation) -> Linearisation:
    """Remove states that no input reaches or no output shows (Kalman 1963); the input-output behaviour stays exactly the same.

    The states that stay keep their names. Where a conservation law ties some of them (``p_a + p_b`` constant) the others follow from
    these. A state that had to take in part of an unobservable one carries ``_r`` at the end of its name.

    Parameters
    ----------
    model
        A linear model, continuous or sampled.

    Returns
    -------
    Linearisation
        The smaller model with a finding that names the removed states; ``model`` itself where there are none.

    Examples
    --------
    >>> small = gb.export.minimal_realisation(gb.linearise(model))  # doctest: +SKIP
    """
    reduced, unreached = _keep_reachable(model)
    reduced, unobserved = _keep_observable(reduced)
    if not (unreached or unobserved):
        return model
    values = {
        "states": len(reduced.A),
        "of": len(model.A),
        "unreached": unreached,
        "unobserved": unobserved,
    }
    return replace(reduced, findings=(*model.findings, Finding(ExportFinding.STATES_REMOVED, values=values)))


def compute_reachable_basis(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Orthonormal basis (n, r) of what ``b`` reaches through ``a``, by the staircase of Rosenbrock; both of size about one."""
    size = max(float(np.linalg.norm(a, 2)) if a.size else 0.0, TINY)
    basis, new = np.zeros((len(a), 0)), b
    scale = 1.0
    while basis.shape[1] < len(a):
        rest = new - basis @ (basis.T @ new)
        rest = rest - basis @ (basis.T @ rest)
        new = range_basis(rest, REACHABILITY, np.full(new.shape[1], scale))
        if not new.shape[1]:
            break
        basis = np.hstack([basis, new])
        new, scale = a @ new, size
    return basis


def _keep_reachable(model: Linearisation) -> tuple[Linearisation, list[str]]:
    s = scale_states(model.A, model.B, model.C)
    basis = compute_reachable_basis(s.a, s.b)
    r = basis.shape[1]
    if r == len(s.a):
        return model, []
    keep = _choose_states(basis)
    # x = T x[keep]: the states left out as they follow from those that stay
    lift = s.t[:, None] * _without_rounding(basis @ np.linalg.inv(basis[keep])) / s.t[keep]
    lift[keep] = np.eye(r)
    a = (model.A @ lift)[keep]
    return _with_states(model, a, model.B[keep], model.C @ lift, keep, [model.state_names[k] for k in keep])


def _keep_observable(model: Linearisation) -> tuple[Linearisation, list[str]]:
    s = scale_states(model.A, model.B, model.C)
    basis = compute_reachable_basis(s.a.T, s.c.T)
    r = basis.shape[1]
    if r == len(s.a):
        return model, []
    keep = _choose_states(basis)
    # z[keep] = R x: the part of the state that the outputs show, in the coordinates of the states that stay
    rows = s.t[keep, None] * _without_rounding(basis @ np.linalg.inv(basis[keep])).T / s.t
    rows[:, keep] = np.eye(r)
    others = np.setdiff1d(np.arange(len(s.a)), keep)
    mixed = np.abs(rows[:, others] * s.t[others]).max(axis=1, initial=0.0) > REACHABILITY_RANK * s.t[keep]
    names = [model.state_names[k] + "_r" * bool(m) for k, m in zip(keep, mixed, strict=True)]
    return _with_states(model, rows @ model.A[:, keep], rows @ model.B, model.C[:, keep], keep, names)


def _without_rounding(lift: np.ndarray) -> np.ndarray:
    """Coefficients (n, r) of about one, those that are rounding errors put to zero: balancing would blow them up to a coupling."""
    return np.where(np.abs(lift) > REACHABILITY_RANK, lift, 0.0)


def _choose_states(basis: np.ndarray) -> np.ndarray:
    """As many states as the basis (n, r) has columns, by which a vector in it is told best; in their order."""
    if not basis.shape[1]:
        return np.empty(0, int)
    # Of two that tell the same the first one stays, whatever their rounding errors.
    preference = (1 - EARLIER_STATE) ** np.arange(len(basis))
    _, _, order = qr(basis.T * preference, pivoting=True, mode="economic")
    return np.sort(order[: basis.shape[1]])


def _with_states(
    model: Linearisation, a: np.ndarray, b: np.ndarray, c: np.ndarray, keep: np.ndarray, names: list[str]
) -> tuple[Linearisation, list[str]]:
    left_out = [name for k, name in enumerate(model.state_names) if k not in keep]
    reduced = replace(
        model,
        A=a,
        B=b,
        C=c,
        state_names=tuple(names),
        state_units=tuple(model.state_units[k] for k in keep),
        x0=model.x0[keep],
        rates=model.rates[keep],
    )
    return reduced, left_out
