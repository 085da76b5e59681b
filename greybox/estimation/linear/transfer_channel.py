"""One input and one output: zeros, poles, gain, bandwidth, from a minimal realisation."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from greybox.base import ModelError, Printable, nearest
from greybox.base.json_shape import ComplexArray
from greybox.base.linear_algebra import REACHABILITY, decompose_columns
from greybox.base.numerics import REACHABILITY_RANK, TINY
from greybox.estimation.linear.linearisation import (
    Linearisation,
    balance_matrix,
    compute_poles,
    is_at_rest,
    minimal_realisation,
    scale_states,
)

HALF_POWER = 1 / np.sqrt(2)
# Angular frequencies at which bandwidth and peak are looked for, over six decades about the poles and zeros.
GRID_POINTS = 2000


@dataclass(frozen=True, eq=False)
class TransferChannel:
    """``G(s) = factor * prod(s - zeros) / prod(s - poles)`` (z in the place of s with ``dt`` above zero), cancelled.

    Attributes
    ----------
    output, input
        From where to where.
    zeros, poles, factor
        Those of the equation above.
    dt
        Sampling time in seconds, 0 for continuous.
    delay
        In seconds, besides that.
    unit
        Unit of the gain.
    """

    output: str
    input: str
    zeros: ComplexArray
    poles: ComplexArray
    factor: float
    dt: float
    delay: float
    unit: str

    KEYS: ClassVar[str] = "zeros! poles! factor! gain! integrators! bandwidth! unit!"

    @property
    def integrators(self) -> int:
        """Poles at 0, or at 1 in the z-plane."""
        return int(is_at_rest(self.poles, self.dt).sum())

    @property
    def gain(self) -> float:
        """Output per input at rest; of an integrating channel what is left of ``s^n G(s)`` there, per second to the power of n."""
        rest = 1.0 if self.dt else 0.0
        steps = self.dt**self.integrators if self.dt else 1.0
        others = self.poles[~is_at_rest(self.poles, self.dt)]
        # k prod(rest - zeros) / prod(rest - poles) at rest, integrators left out.
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
        # The last crossing: a resonance above a dip still belongs to the band.
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
        # s = j w, or z = e^{j w dt} of a sampled model.
        point = np.exp(1j * omega * self.dt) if self.dt else 1j * omega
        # factor prod(p - zero) / prod(p - pole), one factor after the other: polynomials of high order lose their digits.
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
            # s = ln(z) / dt
            roots = np.log(roots[np.abs(roots) > 1e-12].astype(complex)) / self.dt
        speeds = np.abs(roots[np.abs(roots) > 0])
        low, high = (speeds.min(initial=1.0), speeds.max(initial=1.0)) if len(speeds) else (1.0, 1.0)
        # Natural frequencies and imaginary parts are on the grid themselves: a sharp resonance may lie between two
        # points.
        w = np.concatenate([np.geomspace(1e-3 * low, 1e3 * high, GRID_POINTS), np.abs(roots.imag), speeds])
        w = np.unique(w[w > 0])
        return w[w <= np.pi / self.dt] if self.dt else w


@dataclass(frozen=True, eq=False)
class LinearBehaviour(Printable):
    """Poles and channels of a linear model: what its text says about how it behaves."""

    poles: np.ndarray
    dt: float
    channels: tuple[TransferChannel, ...]


def describe_behaviour(model: Linearisation) -> LinearBehaviour:
    """Poles of ``model`` and every channel from an input to an output."""
    channels = [extract_channel(model, output, name) for output in model.output_names for name in model.input_names]
    return LinearBehaviour(model.poles, model.dt, tuple(channels))


def extract_channel(model: Linearisation, output: str | None = None, input: str | None = None) -> TransferChannel:
    """Reduce a linear model to one input and one output: zeros, poles, gain, bandwidth.

    Parameters
    ----------
    model
        A linear model, continuous or sampled.
    output, input
        Names of the signals; None: the first.

    Returns
    -------
    TransferChannel
        The channel, from a minimal realisation.

    Raises
    ------
    ModelError
        For unknown names.

    Examples
    --------
    >>> channel = gb.export.extract_channel(gb.linearise(model), "x", "u")  # doctest: +SKIP
    >>> channel.gain, channel.bandwidth  # doctest: +SKIP
    """
    row = _find_signal(model, "output", output, model.output_names)
    column = _find_signal(model, "input", input, model.input_names)
    single = replace(
        model,
        B=model.B[:, [column]],
        C=model.C[[row]],
        D=model.D[[row]][:, [column]],
        input_names=(model.input_names[column],),
        input_units=(model.input_units[column],),
        output_names=(model.output_names[row],),
        output_units=(model.output_units[row],),
        u0=model.u0[[column]],
        y0=model.y0[[row]],
        delay=model.delay[[column]],
    )
    small = minimal_realisation(single)
    zeros, factor = _find_zeros(small.A, small.B, small.C, float(small.D[0, 0]))
    poles = compute_poles(small.A, model.dt) if factor else np.empty(0, complex)
    fastest = np.abs(np.concatenate([poles, zeros])).max(initial=0.0)
    # A zero and a pole at rest must cancel to the last digit.
    zeros = np.where(is_at_rest(zeros, model.dt, fastest), 1.0 if model.dt else 0.0, zeros)
    unit = f"({single.output_units[0] or '1'})/({single.input_units[0] or '1'})"
    return TransferChannel(
        single.output_names[0], single.input_names[0], zeros, poles, factor, model.dt, float(single.delay[0]), unit
    )


def _find_signal(model: Linearisation, kind: str, name: str | None, names: tuple[str, ...]) -> int:
    if name is None and names:
        return 0
    if name not in names:
        raise ModelError(f"linear model of {model.name} has no {kind} {name!r}; {nearest(str(name), names)}")
    return names.index(name)


def _find_zeros(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: float) -> tuple[np.ndarray, float]:
    """Zeros of a single channel, and the factor in front of them: the first Markov parameter that is not zero.

    With relative degree ``r`` they are the eigenvalues of ``(I - b (c a^(r-1) b)^-1 c a^(r-1)) a`` on the states that the output and its
    first ``r - 1`` derivatives leave at zero.
    """
    n = len(a)
    if d:
        # With feed-through the zeros are the poles of the inverse system, A - B C / d.
        return np.linalg.eigvals(balance_matrix(a - b @ c / d)[0]).astype(complex) if n else np.empty(0, complex), d
    if not n:
        return np.empty(0, complex), 0.0
    s = scale_states(a, b, c)
    size = max(float(np.linalg.norm(s.a, 2)), TINY)
    rows, row, factor = [s.c], s.c, 0.0
    for degree in range(1, n + 1):
        # c A^(r-1) b: the first that is not zero is the factor, r the relative degree.
        markov = float((row @ s.b)[0, 0])
        if abs(markov) > REACHABILITY_RANK * np.linalg.norm(row):
            directions = np.vstack([r / max(np.linalg.norm(r), TINY) for r in rows])
            zero_states = decompose_columns(directions, REACHABILITY, np.ones(n)).null_basis
            # Zero dynamics: u = -c A^r x / (c A^(r-1) b) holds the output at zero; what moves then are the states that the rows leave free.
            inner = s.a - s.b @ (row @ s.a) / markov
            factor = float((c @ np.linalg.matrix_power(a, degree - 1) @ b)[0, 0])
            zeros = np.linalg.eigvals(zero_states.T @ inner @ zero_states) if zero_states.shape[1] else np.empty(0)
            return zeros.astype(complex), factor
        # Divided by the size of A, so that rows of high degree neither overflow nor fade.
        row = row @ s.a / size
        rows.append(row)
    return np.empty(0, complex), 0.0
