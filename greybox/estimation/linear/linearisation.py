"""A linear model with names and units: matrices about an operating point, continuous or sampled."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import qr

from greybox.base import Finding, ModelError, Printable, numerics
from greybox.base.json_shape import ComplexArray, Matrix
from greybox.base.linear_algebra import REACHABILITY, range_basis
from greybox.estimation.linear.exported_model import ExportFinding

# Coordinates in which a state-space model is of one size (pascals and micrometres side by side lose digits), and poles in them.


class ScaledStateSpace(NamedTuple):
    """A model in the coordinates ``x = t * z``; ``b`` and ``c`` are besides scaled by a number for each input and output."""

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    t: np.ndarray


def scale_states(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> ScaledStateSpace:
    """``a, b, c`` with states balanced by powers of two (exact in floating point), columns of ``b`` and rows of ``c`` of length one."""
    n = len(a)
    whole = np.zeros((n + 1, n + 1))
    # Inputs and outputs take part as one more state: balancing A alone could leave B and C of very different sizes.
    whole[:n, :n], whole[:n, n], whole[n, :n] = a, np.abs(b).sum(axis=1), np.abs(c).sum(axis=0)
    factors = _factors(whole)
    t = factors[:n] / factors[n]
    b1, c1 = b / t[:, None], c * t
    b1 = b1 / _lengths(b1, axis=0)
    return ScaledStateSpace(a / t[:, None] * t, b1, c1 / _lengths(c1, axis=1)[:, None], t)


def balance_matrix(a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """``a`` in balanced coordinates and the scaling ``t`` (n,) with ``x = t * z``."""
    t = _factors(a)
    return a / t[:, None] * t, t


def _factors(a: np.ndarray) -> np.ndarray:
    """Powers of two (n,) that make rows and columns of ``a`` equally long (Osborne 1960; Parlett, Reinsch 1969)."""
    size = np.abs(a - np.diag(np.diag(a)))
    exponents = np.zeros(len(a), int)
    for _ in range(numerics.BALANCING_SWEEPS):
        before = exponents.copy()
        for k in range(len(a)):
            t = np.ldexp(1.0, exponents)
            # Sums of the sizes in column and row k of T^-1 A T.
            column, row = size[:, k] @ (1 / t) * t[k], size[k] @ t / t[k]
            if column and row:
                exponents[k] = np.clip(
                    # t_k = sqrt(row / column) makes both equally long; a power of two keeps every digit.
                    exponents[k] + round(np.log2(row / column) / 2),
                    -numerics.LARGEST_SCALING_EXPONENT,
                    numerics.LARGEST_SCALING_EXPONENT,
                )
        if np.array_equal(before, exponents):
            break
    return np.ldexp(1.0, exponents)


def _lengths(matrix: np.ndarray, axis: int) -> np.ndarray:
    lengths = np.linalg.norm(matrix, axis=axis)
    return np.where(lengths > 0, lengths, 1.0)


def compute_poles(a: np.ndarray, dt: float) -> np.ndarray:
    """Eigenvalues (n,) of ``a``, slowest first; a pole that integrates is 0 (or 1 in the z-plane) to the last digit."""
    values = np.linalg.eigvals(balance_matrix(a)[0]).astype(complex) if len(a) else np.empty(0, complex)
    values = np.where(is_at_rest(values, dt), 1.0 if dt else 0.0, values)
    # An imaginary part that is rounding would make a slow oscillation of a real pole.
    values.imag[np.abs(values.imag) <= numerics.REAL_PART_ONLY * np.abs(values)] = 0.0
    # Slowest first, rounded: a conjugate pair whose parts differ in the last digit must not be torn apart.
    speed = np.abs(values - 1.0) if dt else np.abs(values)
    return values[np.lexsort((values.imag, np.round(speed / max(speed.max(initial=0.0), numerics.TINY), 9)))]


def is_at_rest(roots: np.ndarray, dt: float, size: float | None = None) -> np.ndarray:
    """Which of some poles or zeros are at rest: 0, or 1 in the z-plane; ``size`` is that of the fastest (None: among these)."""
    distance = np.abs(roots - 1.0) if dt else np.abs(roots)
    return distance <= numerics.INTEGRATING_POLE * max(
        np.abs(roots).max(initial=0.0) if size is None else size, numerics.TINY
    )


@dataclass(frozen=True, eq=False)
class Linearisation(Printable):
    """``dx/dt = A x + B u, y = C x + D u`` for deviations from an operating point; with ``dt`` above zero ``x[k+1] = A x[k] + B u[k]``.

    Attributes
    ----------
    name
        Name of the model.
    A, B, C, D
        Matrices (nx, nx), (nx, nu), (ny, nx), (ny, nu).
    state_names, input_names, output_names
        Names in the order of the matrices.
    state_units, input_units, output_units
        Their units.
    x0, u0, y0
        The operating point: states (nx,), inputs (nu,), outputs (ny,).
    rates
        ``dx/dt`` (nx,) at the operating point, zero at an equilibrium.
    delay
        Seconds (nu,) by which each input arrives late, not in the matrices. A sampled model holds delays as states: then it is zero.
    parameters
        The parameters of the model, by name.
    dt
        Sampling time in seconds, 0 for continuous.
    method
        How it was sampled.
    findings
        What to know before using it.
    is_exact
        Whether the equations are linear themselves, so that it holds for deviations of any size.

    See Also
    --------
    sample, minimal_realisation, extract_channel, to_state_space, to_transfer_function : what is made of it.
    """

    name: str
    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix
    state_names: tuple[str, ...]
    input_names: tuple[str, ...]
    output_names: tuple[str, ...]
    state_units: tuple[str, ...]
    input_units: tuple[str, ...]
    output_units: tuple[str, ...]
    x0: np.ndarray
    u0: np.ndarray
    y0: np.ndarray
    rates: np.ndarray
    delay: np.ndarray
    parameters: Mapping[str, float]
    dt: float = 0.0
    method: str = ""
    findings: tuple[Finding, ...] = ()
    is_exact: bool = False

    def __post_init__(self) -> None:
        infinite = [name for name in ("A", "B", "C", "D") if not np.isfinite(getattr(self, name)).all()]
        if infinite:
            raise ModelError(
                f"linear model of {self.name}: {' and '.join(infinite)} not finite; an equation has no finite slope at the operating"
                " point (a root at zero, a division by zero); give a point near it: at={NAME: VALUE, ...} (shell: --at NAME=VALUE)"
            )

    @property
    def poles(self) -> ComplexArray:
        """Eigenvalues of ``A`` (nx,), in 1/s, or in the z-plane for a sampled model; slowest first."""
        return compute_poles(self.A, self.dt)

    def frequency_response(self, omega: np.ndarray) -> np.ndarray:
        """Complex response (nw, ny, nu) at the angular frequencies ``omega`` (nw,) in rad/s, delays included."""
        w = np.atleast_1d(np.asarray(omega, float))
        # s = j w, or z = e^{j w dt} of a sampled model.
        point = np.exp(1j * w * self.dt) if self.dt else 1j * w
        resolvent = point[:, None, None] * np.eye(len(self.A)) - self.A
        # G = (C (p I - A)^-1 B + D) e^{-j w delay}
        response = self.C @ np.linalg.solve(resolvent, np.broadcast_to(self.B, (len(w), *self.B.shape))) + self.D
        return response * np.exp(-1j * w[:, None, None] * self.delay)

    def with_delay(self, seconds: float) -> Linearisation:
        """The same plant with every input arriving ``seconds`` later (a converter, a bus, the time of a computation)."""
        if not (np.isfinite(seconds) and seconds >= 0):
            raise ModelError(f"delay {seconds} s: give a time of 0 s or more")
        if seconds and self.dt:
            raise ModelError("a delay is added before sampling; use linearise(..., dt=..., delay=...)")
        return replace(self, delay=self.delay + seconds)


# Minimal realisation: states that no input reaches, and those that no output shows, are taken out.


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
    reduced, unreached, unobserved = model, list[str](), list[str]()
    s = scale_states(model.A, model.B, model.C)
    basis = compute_reachable_basis(s.a, s.b)
    if basis.shape[1] < len(s.a):
        keep = _choose_states(basis)
        # x = T x[keep]: the states left out as they follow from those that stay
        lift = s.t[:, None] * _without_rounding(basis @ np.linalg.inv(basis[keep])) / s.t[keep]
        lift[keep] = np.eye(len(keep))
        names, a = [model.state_names[k] for k in keep], (model.A @ lift)[keep]
        reduced, unreached = _with_states(model, a, model.B[keep], model.C @ lift, keep, names)
    # Observability of (A, C) is reachability of (A', C').
    s = scale_states(reduced.A, reduced.B, reduced.C)
    basis = compute_reachable_basis(s.a.T, s.c.T)
    if basis.shape[1] < len(s.a):
        keep = _choose_states(basis)
        # z[keep] = R x: the part of the state that the outputs show, in the coordinates of the states that stay
        rows = s.t[keep, None] * _without_rounding(basis @ np.linalg.inv(basis[keep])).T / s.t
        rows[:, keep] = np.eye(len(keep))
        others = np.setdiff1d(np.arange(len(s.a)), keep)
        mixed = np.abs(rows[:, others] * s.t[others]).max(axis=1, initial=0.0) > numerics.REACHABILITY_RANK * s.t[keep]
        names = [reduced.state_names[k] + "_r" * bool(m) for k, m in zip(keep, mixed, strict=True)]
        shown = reduced.C[:, keep]
        reduced, unobserved = _with_states(reduced, rows @ reduced.A[:, keep], rows @ reduced.B, shown, keep, names)
    if not (unreached or unobserved):
        return model
    values = {"states": len(reduced.A), "of": len(model.A), "unreached": unreached, "unobserved": unobserved}
    return replace(reduced, findings=(*model.findings, Finding(ExportFinding.STATES_REMOVED, values=values)))


def compute_reachable_basis(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Orthonormal basis (n, r) of what ``b`` reaches through ``a``, by the staircase of Rosenbrock; both of size about one."""
    size = max(float(np.linalg.norm(a, 2)) if a.size else 0.0, numerics.TINY)
    basis, new = np.zeros((len(a), 0)), b
    scale = 1.0
    while basis.shape[1] < len(a):
        rest = new - basis @ (basis.T @ new)
        # Twice is enough: the second projection takes away what rounding of the first one left (Kahan, Parlett).
        rest = rest - basis @ (basis.T @ rest)
        new = range_basis(rest, REACHABILITY, np.full(new.shape[1], scale))
        if not new.shape[1]:
            break
        # [B, A B, A^2 B, ...] in steps: only what is new is multiplied again, so that its size says whether it is
        # there.
        basis = np.hstack([basis, new])
        new, scale = a @ new, size
    return basis


def _without_rounding(lift: np.ndarray) -> np.ndarray:
    """Coefficients (n, r) of about one, those that are rounding errors put to zero: balancing would blow them up to a coupling."""
    return np.where(np.abs(lift) > numerics.REACHABILITY_RANK, lift, 0.0)


def _choose_states(basis: np.ndarray) -> np.ndarray:
    """As many states as the basis (n, r) has columns, by which a vector in it is told best; in their order."""
    if not basis.shape[1]:
        return np.empty(0, int)
    # Of two that tell the same the first one stays, whatever their rounding errors.
    preference = (1 - numerics.EARLIER_STATE) ** np.arange(len(basis))
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
