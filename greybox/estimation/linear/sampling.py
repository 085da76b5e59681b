"""Sampled linear models for a controller with sampling time ``dt``: exact hold or Tustin, with an input delay of any length."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.linalg import expm

from greybox.base import TIME_ROUNDING, Finding, ModelError, Severity, nearest
from greybox.estimation.linear.exported_model import ExportFinding, check_sampling_time
from greybox.estimation.linear.linearisation import Linearisation, balance_matrix

METHODS = ("zoh", "tustin")


# Longest delay in samples: each sample is a state.
MOST_DELAY_STATES = 1000


def sample(model: Linearisation, dt: float, method: str = "zoh", *, delay: float = 0.0) -> Linearisation:
    """Sample a continuous linear model.

    Parameters
    ----------
    model
        A continuous linear model.
    dt
        Sampling time in seconds.
    method
        ``zoh``: exact for an input that is held between samples (Van Loan 1978); a delay of ``n + f`` intervals enters as the input
        of ``n + 1`` intervals ago for the share ``f`` of the interval and then that of ``n`` intervals ago, exact too (Franklin,
        Powell, Workman, Digital Control of Dynamic Systems, section 4.3). ``tustin``: the trapezoidal rule,
        ``s = 2 (z - 1) / (dt (z + 1))``, whose states are not those of the plant; a fraction of a sample is interpolated between the
        two inputs beside it.
    delay
        Seconds by which every input arrives late, besides the delays that it has already. Past inputs become states
        ``u_1, u_2, ...`` (1, 2, ... samples ago).

    Returns
    -------
    Linearisation
        The sampled model; a sampling time that is too long for the dynamics is among its findings.

    Raises
    ------
    ModelError
        For a sampling time that is not above zero, an unknown method, a model that is sampled already, and a delay that is negative
        or longer than 1000 samples.

    Examples
    --------
    >>> sampled = gb.export.sample(gb.linearise(model), 1e-3)  # doctest: +SKIP
    """
    if model.dt:
        raise ModelError(
            f"linear model of {model.name} is sampled already, every {model.dt:g} s; sample the continuous one"
        )
    check_sampling_time(dt)
    if method not in METHODS:
        raise ModelError(f"unknown method {method!r} of sampling; {nearest(method, METHODS)}")
    late = model.with_delay(delay).delay
    if late.max(initial=0.0) > MOST_DELAY_STATES * dt:
        raise ModelError(
            f"a delay of {late.max():g} s is {late.max() / dt:.0f} samples of {dt:g} s, more than {MOST_DELAY_STATES};"
            " use a longer sampling time"
        )
    # Each delay as whole intervals and the share (0 to below 1) of one more.
    wholes = [math.floor(seconds / dt + TIME_ROUNDING) for seconds in late]
    shares = [seconds / dt - whole for seconds, whole in zip(late, wholes, strict=True)]
    parts = [(whole, f if f > TIME_ROUNDING else 0.0) for whole, f in zip(wholes, shares, strict=True)]
    a, c, now, before, direct = (
        _hold_with_delays(model, dt, parts) if method == "zoh" else _apply_tustin(model, dt, parts)
    )
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
    # Past inputs at the operating point are what the input is there.
    held = np.concatenate([np.repeat(model.u0[j], length) for j, length in enumerate(lengths)] or [np.empty(0)])
    return replace(
        model,
        A=A,
        B=B,
        C=C,
        D=D,
        state_names=tuple(names),
        state_units=tuple(units),
        dt=float(dt),
        method=method,
        x0=np.concatenate([model.x0, held]),
        rates=np.concatenate([model.rates, np.zeros(extra)]),
        delay=np.zeros(len(parts)),
        findings=(*model.findings, *_check_sampling_time(model, dt, method)),
    )


Parts = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray]]


def _hold_with_delays(model: Linearisation, dt: float, parts: list[tuple[int, float]]) -> Parts:
    """``Phi, C``, the gains (nx, nu) of the inputs of ``n`` and ``n + 1`` intervals ago, and those (ny, nu) on the outputs."""
    phi, gamma = _hold_exactly(model, dt)
    now, before = gamma.copy(), np.zeros_like(gamma)
    direct, direct_before = model.D.copy(), np.zeros_like(model.D)
    for j, (_, share) in enumerate(parts):
        if share:
            # The newer input acts over the last (1 - f) dt of the interval, the older one over what is before.
            now[:, j] = _hold_exactly(model, (1 - share) * dt)[1][:, j]
            before[:, j] = gamma[:, j] - now[:, j]
            direct[:, j], direct_before[:, j] = 0.0, model.D[:, j]  # at the sample itself the older one still acts
    return phi, model.C, now, before, (direct, direct_before)


def _hold_exactly(model: Linearisation, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """``expm(A dt)`` and its integral times ``B``, in balanced coordinates."""
    n, m = model.B.shape
    a, t = balance_matrix(model.A)
    block = np.zeros((n + m, n + m))
    size = np.abs(model.B / t[:, None]).max(axis=0, initial=0.0)
    size = np.where(size > 0, size, 1.0)
    block[:n, :n], block[:n, n:] = a * dt, model.B / t[:, None] / size
    # exp([[A dt, B dt], [0, 0]]) = [[Phi, Gamma], [0, I]] (Van Loan 1978)
    e = expm(block) * _find_paths(block)
    return t[:, None] * e[:n, :n] / t, t[:, None] * e[:n, n:] * size * dt


def _find_paths(a: np.ndarray) -> np.ndarray:
    """Where a function of ``a`` (n, n) can differ from zero: entry (i, j) if j acts on i, through others too. The rest is rounding."""
    reach = (a != 0) | np.eye(len(a), dtype=bool)
    for _ in range(len(a).bit_length()):
        reach = reach @ reach
    return reach


def _apply_tustin(model: Linearisation, dt: float, parts: list[tuple[int, float]]) -> Parts:
    n = len(model.A)
    a, t = balance_matrix(model.A)
    b, c = model.B / t[:, None], model.C * t
    # (I - A dt/2)^-1: Phi = (I - A dt/2)^-1 (I + A dt/2)
    inverse = np.linalg.inv(np.eye(n) - a * dt / 2) * _find_paths(a)
    phi, gamma, seen = inverse @ (np.eye(n) + a * dt / 2), inverse @ b * dt, c @ inverse
    direct = model.D + seen @ b * dt / 2
    share = np.array([f for _, f in parts])
    level = t[:, None] * gamma
    return (t[:, None] * phi / t, seen / t, level * (1 - share), level * share, (direct * (1 - share), direct * share))


# Samples in a period of an oscillating mode that a controller needs.
SAMPLES_PER_PERIOD = 10
# A mode of a lower damping ratio oscillates.
RINGING_DAMPING = 0.7
# Samples within the slowest time constant that are proposed where every mode decays within one.
SAMPLES_PER_DECAY = 5.0


def _check_sampling_time(model: Linearisation, dt: float, method: str) -> list[Finding]:
    """What is lost at this sampling time, with one that would do."""
    poles = model.poles
    poles = poles[np.abs(poles) > 0]
    findings = []
    oscillating = poles[(np.abs(poles.imag) > 0) & (-poles.real < RINGING_DAMPING * np.abs(poles))]
    if len(oscillating):
        fastest = float(np.abs(oscillating.imag).max())
        # Samples in one period of the fastest oscillation.
        samples = 2 * np.pi / (fastest * dt)
        if samples < SAMPLES_PER_PERIOD:
            values = {
                "dt": dt,
                "frequency": fastest,
                "samples": samples,
                "proposed": 2 * np.pi / (fastest * SAMPLES_PER_PERIOD),
            }
            findings.append(Finding(ExportFinding.MODE_UNDERSAMPLED, Severity.WARNING, values=values))
    slowest = float(np.abs(poles).min()) if len(poles) else 0.0
    if slowest * dt > 1 and not findings:
        values = {"dt": dt, "time_constant": 1 / slowest, "proposed": 1 / (SAMPLES_PER_DECAY * slowest)}
        findings.append(Finding(ExportFinding.DECAY_UNDERSAMPLED, Severity.WARNING, values=values))
    fastest_decay = float(np.abs(poles.real).max(initial=0.0))
    if method == "tustin" and fastest_decay * dt > 2:
        values = {"dt": dt, "pole": -fastest_decay, "proposed": 2 / fastest_decay}
        findings.append(Finding(ExportFinding.TUSTIN_RINGS, Severity.WARNING, values=values))
    return findings
