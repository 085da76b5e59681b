"""What a controller sees that samples every ``dt`` seconds: exact hold or Tustin, with an input delay of any length."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.linalg import expm

from greybox.errors import ModelError, nearest
from greybox.export.linearisation import Linearisation
from greybox.export.state_scaling import balance_matrix

SAMPLINGS = ("zoh", "tustin")
# A mode that rings is followed by at least this many samples a period; one that does not decays over at least one sample.
SAMPLES_A_PERIOD = 10
RINGS = 0.7  # damping ratio below which a mode rings
MOST_DELAY_STATES = 1000


def sample(model: Linearisation, dt: float, method: str = "zoh", *, delay: float = 0.0) -> Linearisation:
    """``model`` sampled every ``dt`` seconds; every input arrives ``delay`` seconds later, besides the delays it has already.

    ``zoh``: exact for an input that is held between samples (Van Loan 1978); a delay of ``n + f`` intervals enters as the input of
    ``n + 1`` intervals ago for the share ``f`` of the interval and then that of ``n`` intervals ago, exact too (Franklin, Powell, Workman,
    Digital Control of Dynamic Systems, section 4.3). ``tustin``: the trapezoidal rule, ``s = 2 (z - 1) / (dt (z + 1))``, whose states are
    not those of the plant; a fraction of a sample is interpolated between the two inputs beside it. Past inputs become states
    ``u_1, u_2, ...`` (1, 2, ... samples ago).

    Raises ModelError for a sampling time that is not above zero, an unknown method, a model that is sampled already, and a delay
    that is negative or longer than 1000 samples. A sampling time too long for the dynamics is said in the notes.
    """
    if model.dt:
        raise ModelError(
            f"linear model of {model.name} is sampled already, every {model.dt:g} s; sample the continuous one"
        )
    if not (np.isfinite(dt) and dt > 0):
        raise ModelError(f"sampling time {dt} s: give a time above 0 s")
    if method not in SAMPLINGS:
        raise ModelError(f"unknown method {method!r} of sampling; {nearest(method, SAMPLINGS)}")
    late = model.late(delay).delay
    if late.max(initial=0.0) > MOST_DELAY_STATES * dt:
        raise ModelError(
            f"a delay of {late.max():g} s is {late.max() / dt:.0f} samples of {dt:g} s, more than {MOST_DELAY_STATES}; sample more slowly"
        )
    parts = [_intervals(seconds, dt) for seconds in late]
    a, c, now, before, direct = _held(model, dt, parts) if method == "zoh" else _trapezoidal(model, dt, parts)
    lengths = [n + (f > 0) for n, f in parts]
    nx, extra = len(a), sum(lengths)
    A, B = np.zeros((nx + extra, nx + extra)), np.zeros((nx + extra, len(parts)))
    C, D = np.zeros((len(model.C), nx + extra)), np.zeros(model.D.shape)
    A[:nx, :nx], C[:, :nx] = a, c
    row, names, units = nx, list(model.state_names), list(model.state_units)
    for j, ((n, _), length) in enumerate(zip(parts, lengths, strict=True)):
        past = [(B, j), *((A, row + i) for i in range(length))]  # where the input of 0, 1, 2 ... samples ago stands
        show = [(D, j), *((C, row + i) for i in range(length))]
        for ago, level, seen in ((n, now[:, j], direct[0][:, j]), (n + 1, before[:, j], direct[1][:, j])):
            if ago < len(past):
                past[ago][0][:nx, past[ago][1]] += level
                show[ago][0][:, show[ago][1]] += seen
        for i in range(length):
            (B if i == 0 else A)[row + i, j if i == 0 else row + i - 1] = 1.0
        names += [f"{model.input_names[j]}_{i + 1}" for i in range(length)]
        units += [model.input_units[j]] * length
        row += length
    held = np.concatenate([np.repeat(model.u0[j], length) for j, length in enumerate(lengths)] or [np.empty(0)])
    return replace(
        model, A=A, B=B, C=C, D=D, state_names=tuple(names), state_units=tuple(units), dt=float(dt), method=method,
        x0=np.concatenate([model.x0, held]), rates=np.concatenate([model.rates, np.zeros(extra)]), delay=np.zeros(len(parts)),
        notes=(*model.notes, *_warnings(model, dt, method)),
    )  # fmt: skip


def _intervals(delay: float, dt: float) -> tuple[int, float]:
    """A delay as whole intervals and the share (0 to below 1) of one more."""
    whole = math.floor(delay / dt + 1e-9)
    share = delay / dt - whole
    return whole, share if share > 1e-9 else 0.0


Parts = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray]]


def _held(model: Linearisation, dt: float, parts: list[tuple[int, float]]) -> Parts:
    """``Phi, C``, the gains (nx, nu) of the inputs of ``n`` and ``n + 1`` intervals ago, and those (ny, nu) on the outputs."""
    phi, gamma = _hold(model, dt)
    now, before = gamma.copy(), np.zeros_like(gamma)
    here, old = model.D.copy(), np.zeros_like(model.D)
    for j, (_, share) in enumerate(parts):
        if share:
            now[:, j] = _hold(model, (1 - share) * dt)[1][:, j]
            before[:, j] = gamma[:, j] - now[:, j]
            here[:, j], old[:, j] = 0.0, model.D[:, j]  # at the sample itself the older one still acts
    return phi, model.C, now, before, (here, old)


def _hold(model: Linearisation, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """``expm(A dt)`` and its integral times ``B``, in balanced coordinates."""
    n, m = model.B.shape
    a, t = balance_matrix(model.A)
    block = np.zeros((n + m, n + m))
    size = np.abs(model.B / t[:, None]).max(axis=0, initial=0.0)
    size = np.where(size > 0, size, 1.0)
    block[:n, :n], block[:n, n:] = a * dt, model.B / t[:, None] / size
    e = expm(block) * _paths(block)
    return t[:, None] * e[:n, :n] / t, t[:, None] * e[:n, n:] * size * dt


def _paths(a: np.ndarray) -> np.ndarray:
    """Where a function of ``a`` (n, n) can differ from zero: entry (i, j) if j acts on i, through others too. The rest is rounding."""
    reach = (a != 0) | np.eye(len(a), dtype=bool)
    for _ in range(len(a).bit_length()):
        reach = reach @ reach
    return reach


def _trapezoidal(model: Linearisation, dt: float, parts: list[tuple[int, float]]) -> Parts:
    n = len(model.A)
    a, t = balance_matrix(model.A)
    b, c = model.B / t[:, None], model.C * t
    inverse = np.linalg.inv(np.eye(n) - a * dt / 2) * _paths(a)
    phi, gamma, seen = inverse @ (np.eye(n) + a * dt / 2), inverse @ b * dt, c @ inverse
    direct = model.D + seen @ b * dt / 2
    share = np.array([f for _, f in parts])
    level = t[:, None] * gamma
    return (
        t[:, None] * phi / t, seen / t, level * (1 - share), level * share, (direct * (1 - share), direct * share)
    )  # fmt: skip


def _warnings(model: Linearisation, dt: float, method: str) -> list[str]:
    """What is lost at this sampling time, with one that would do."""
    poles = model.poles
    poles = poles[np.abs(poles) > 0]
    said = []
    ringing = poles[(np.abs(poles.imag) > 0) & (-poles.real < RINGS * np.abs(poles))]
    if len(ringing):
        fastest = float(np.abs(ringing.imag).max())
        samples = 2 * np.pi / (fastest * dt)
        if samples < SAMPLES_A_PERIOD:
            lost = (
                "it cannot be seen at all: it is beyond half the sampling rate"
                if samples <= 2
                else "it is followed poorly"
            )
            said.append(
                f"sampling time {dt:g} s is too long: the mode at {fastest:.4g} rad/s has {samples:.2g} samples a period and"
                f" {lost}; give {2 * np.pi / (fastest * SAMPLES_A_PERIOD):.2g} s or less"
            )
    slowest = float(np.abs(poles).min()) if len(poles) else 0.0
    if slowest * dt > 1 and not said:
        said.append(
            f"sampling time {dt:g} s is too long: every mode decays within one sample (the slowest takes {1 / slowest:.2g} s);"
            f" give {0.2 / slowest:.2g} s or less"
        )
    real = np.abs(poles.real).max(initial=0.0)
    if method == "tustin" and real * dt > 2:
        said.append(
            f"Tustin at {dt:g} s turns the pole at -{real:.4g} 1/s into one that rings from sample to sample; take zoh, or"
            f" {2 / real:.2g} s or less"
        )
    return said
