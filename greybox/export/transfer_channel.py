"""One input and one output: zeros, poles, gain, bandwidth, from a minimal realisation."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import null_space

from greybox.export.linearisation import Linearisation
from greybox.export.minimal_realisation import RANK, minimal_realisation
from greybox.export.state_scaling import balance_matrix, scale_states

# A pole this near to 0 (or to 1 in the z-plane), relative to the fastest one, integrates.
INTEGRATES = 1e-9
HALF_POWER = 1 / np.sqrt(2)
GRID = 2000


@dataclass(frozen=True, eq=False)
class TransferChannel:
    """``G(s) = factor * prod(s - zeros) / prod(s - poles)`` (z in the place of s with ``dt`` above zero), cancelled.

    ``integrators``: how often it integrates. ``gain``: output per input at rest, in ``unit``; of an integrating channel what is left of
    ``s^n G(s)`` there, per second to that power. ``delay`` in seconds is besides that.
    """

    output: str
    input: str
    zeros: np.ndarray
    poles: np.ndarray
    factor: float
    dt: float
    delay: float
    unit: str

    @property
    def integrators(self) -> int:
        """Poles at 0, or at 1 in the z-plane."""
        return int(_integrating(self.poles, self.dt).sum())

    @property
    def gain(self) -> float:
        """Gain at rest, or of the integrator."""
        rest = 1.0 if self.dt else 0.0
        steps = self.dt**self.integrators if self.dt else 1.0
        others = self.poles[~_integrating(self.poles, self.dt)]
        return float(np.real(self.factor * np.prod(rest - self.zeros) / np.prod(rest - others)) / steps)

    @property
    def bandwidth(self) -> float:
        """Angular frequency in rad/s above which the gain stays 3 dB below that at rest.

        Infinite if it never does (for a sampled model: up to half the sampling rate), NaN if the channel integrates or has no gain
        at rest.
        """
        if self.integrators or self.gain == 0:
            return np.nan
        w = self._grid()
        above = np.flatnonzero(np.abs(self.response(w)) > HALF_POWER * abs(self.gain))
        if not len(above) or above[-1] + 1 >= len(w):
            return np.inf
        from scipy.optimize import brentq  # slow to import, and code needs no bandwidth

        low, high = w[above[-1]], w[above[-1] + 1]
        return float(brentq(lambda x: abs(self.response(np.array([x]))[0]) - HALF_POWER * abs(self.gain), low, high))

    @property
    def peak(self) -> tuple[float, float]:
        """Angular frequency in rad/s and gain where the gain is largest; NaN if the channel integrates."""
        if self.integrators:
            return np.nan, np.nan
        w = self._grid()
        size = np.abs(self.response(w))
        return float(w[np.argmax(size)]), float(size.max())

    def response(self, omega: np.ndarray) -> np.ndarray:
        """Complex response (nw,) at the angular frequencies ``omega`` (nw,) in rad/s, delay included."""
        point = np.exp(1j * omega * self.dt) if self.dt else 1j * omega
        value = np.full(len(point), complex(self.factor))
        for zero in self.zeros:
            value = value * (point - zero)
        for pole in self.poles:
            value = value / (point - pole)
        return value * np.exp(-1j * omega * self.delay)

    @property
    def numerator(self) -> np.ndarray:
        """Coefficients, highest power first."""
        return self.factor * np.atleast_1d(np.real(np.poly(self.zeros)))

    @property
    def denominator(self) -> np.ndarray:
        """Coefficients, highest power first; the first is 1."""
        return np.atleast_1d(np.real(np.poly(self.poles)))

    def _grid(self) -> np.ndarray:
        """Angular frequencies around all of the poles and zeros, more of them where a mode rings."""
        roots = np.concatenate([self.poles, self.zeros])
        if self.dt:
            roots = np.log(roots[np.abs(roots) > 1e-12].astype(complex)) / self.dt
        speeds = np.abs(roots[np.abs(roots) > 0])
        low, high = (speeds.min(initial=1.0), speeds.max(initial=1.0)) if len(speeds) else (1.0, 1.0)
        w = np.concatenate([np.geomspace(1e-3 * low, 1e3 * high, GRID), np.abs(roots.imag), speeds])
        w = np.unique(w[w > 0])
        return w[w <= np.pi / self.dt] if self.dt else w


def extract_channel(model: Linearisation, row: int, column: int) -> TransferChannel:
    """The channel from input number ``column`` to output number ``row``."""
    one = replace(
        model, B=model.B[:, [column]], C=model.C[[row]], D=model.D[[row]][:, [column]],
        input_names=(model.input_names[column],), input_units=(model.input_units[column],),
        output_names=(model.output_names[row],), output_units=(model.output_units[row],),
        u0=model.u0[[column]], y0=model.y0[[row]], delay=model.delay[[column]],
    )  # fmt: skip
    small = minimal_realisation(one)
    zeros, factor = _zeros(small.A, small.B, small.C, float(small.D[0, 0]))
    poles = compute_poles(small.A, model.dt) if factor else np.empty(0, complex)
    speeds = np.abs(np.concatenate([poles, zeros])).max(initial=0.0)
    zeros = np.where(_integrating(zeros, model.dt, speeds), 1.0 if model.dt else 0.0, zeros)
    unit = f"({one.output_units[0] or '1'})/({one.input_units[0] or '1'})"
    return TransferChannel(
        one.output_names[0], one.input_names[0], zeros, poles, factor, model.dt, float(one.delay[0]), unit
    )  # fmt: skip


def compute_poles(a: np.ndarray, dt: float) -> np.ndarray:
    """Eigenvalues (n,), slowest first; a pole that integrates is 0 (or 1) to the last digit."""
    values = np.linalg.eigvals(balance_matrix(a)[0]).astype(complex) if len(a) else np.empty(0, complex)
    values = np.where(_integrating(values, dt), 1.0 if dt else 0.0, values)
    values.imag[np.abs(values.imag) <= 1e-13 * np.abs(values)] = 0.0
    speed = np.abs(values - 1.0) if dt else np.abs(values)
    return values[np.lexsort((values.imag, np.round(speed / max(speed.max(initial=0.0), 1e-300), 9)))]


def _integrating(roots: np.ndarray, dt: float, size: float | None = None) -> np.ndarray:
    """Which of some poles or zeros are at rest: 0, or 1 in the z-plane; ``size`` is that of the fastest (None: among these)."""
    distance = np.abs(roots - 1.0) if dt else np.abs(roots)
    return distance <= INTEGRATES * max(np.abs(roots).max(initial=0.0) if size is None else size, 1e-300)


def _zeros(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: float) -> tuple[np.ndarray, float]:
    """Zeros of a single channel, and the factor in front of them: the first Markov parameter that is not zero.

    With relative degree ``r`` they are the eigenvalues of ``(I - b (c a^(r-1) b)^-1 c a^(r-1)) a`` on the states that the output and its
    first ``r - 1`` derivatives leave at zero.
    """
    n = len(a)
    if d:
        return np.linalg.eigvals(balance_matrix(a - b @ c / d)[0]).astype(complex) if n else np.empty(0, complex), d
    if not n:
        return np.empty(0, complex), 0.0
    s = scale_states(a, b, c)
    size = max(float(np.linalg.norm(s.a, 2)), 1e-300)
    rows, row, factor = [s.c], s.c, 0.0
    for degree in range(1, n + 1):
        markov = float((row @ s.b)[0, 0])
        if abs(markov) > RANK * np.linalg.norm(row):
            hidden = null_space(np.vstack([r / max(np.linalg.norm(r), 1e-300) for r in rows]), rcond=RANK)
            inner = s.a - s.b @ (row @ s.a) / markov
            factor = float((c @ np.linalg.matrix_power(a, degree - 1) @ b)[0, 0])
            zeros = np.linalg.eigvals(hidden.T @ inner @ hidden) if hidden.shape[1] else np.empty(0)
            return zeros.astype(complex), factor
        row = row @ s.a / size
        rows.append(row)
    return np.empty(0, complex), 0.0
