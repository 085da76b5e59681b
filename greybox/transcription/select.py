"""Which transcription suits a model and its record, and why."""

from __future__ import annotations

import math
from typing import NamedTuple

import casadi as ca
import numpy as np
from scipy.linalg import expm

from greybox.integrators.exponential_relaxation import compute_fastest_rate
from greybox.integrators.policy import DEFAULT_POLICY as DISCRETISATION
from greybox.kernel import Record
from greybox.model.system import System

# The equations are linearised in so many places along the record; where one of them is unstable, in so many.
PLACES, MANY_PLACES = 9, 1000
# A free run loses the constants where errors grow by more than this factor, ...
GROWN = 20.0
# ... and drifts far where an integrator (which forgets less than this share over the record) runs for so many of the plant's
# own time constants.
FORGETS, LONG = 0.03, 50.0
# So many explicit substeps a sample are too many; collocation is for at most so many samples.
SUBSTEPS, EXPLICIT, MOST_SAMPLES = 32, 0.5, 10_000


class TranscriptionProposal(NamedTuple):
    """The transcription (``single``, ``multiple`` or ``collocation``), the reason in words, and whether it needs implicit steps."""

    transcription: str
    reason: str
    implicit: bool = False


def propose_transcription(
    system: System, p: np.ndarray, record: Record, *, integrating: str = "multiple"
) -> TranscriptionProposal:
    """The transcription for ``system`` at the parameters ``p`` (np,) over ``record``, and the reason in words.

    ``multiple`` shooting where errors grow along the record (an unstable or chaotic plant) or an integrator makes them drift
    over a long one. Where the fastest mode asks for more explicit steps than are sensible (stiff, nonlinear) ``single`` shooting
    with implicit steps, or ``collocation`` if there are too many states for those (smooth, and not too long). Else ``single``
    shooting on a growing record. Judged by the equations linearised in several places of the record (measured states as measured,
    hidden ones as declared). ``integrating`` says what an integrator asks for: on smooth plants with little noise a free run over
    a growing part of the record gets there as surely and several times faster, ``integrating="single"``.
    """
    slopes = _slopes(system, p, record, PLACES)
    duration = float(record.h.sum())
    growth = _growth(system, p, record, slopes)
    if growth * duration > math.log(GROWN):
        return TranscriptionProposal(
            "multiple",
            f"unstable: errors grow at {growth:.3g} 1/s, by e^{growth * duration:.3g} over the record of {duration:.4g} s;"
            " a free run cannot be followed that far",
        )
    stiff = _stiff(system, slopes, record)
    if stiff:
        return stiff
    parts = np.linalg.eigvals(slopes).ravel()
    decays = -parts.real[-parts.real * duration > FORGETS]
    slowest = 1 / decays.min() if len(decays) else 0.0
    if not (np.abs(parts) * duration <= FORGETS).any():
        return TranscriptionProposal("single", "the model is stable and not stiff")
    times = (
        f"{duration:.4g} s are {duration / slowest:.2g} times its slowest other mode"
        if slowest
        else f"for {duration:.4g} s"
    )
    if duration <= LONG * slowest:
        return TranscriptionProposal(
            "single", f"integrating, but not for long ({times}): a free run stays near the data"
        )
    how = "a growing part of the record keeps the free run near the data"
    far = "what is wrong adds up along the record and is never forgotten"
    return TranscriptionProposal(integrating, f"integrating ({times}): {how if integrating == 'single' else far}")


def estimate_error_growth(system: System, p: np.ndarray, record: Record) -> float:
    """Mean rate (1/s) at which small errors grow along ``record``; negative where they decay. See `choose_segment_rows`."""
    return _growth(system, p, record, _slopes(system, p, record, PLACES))


def _growth(system: System, p: np.ndarray, record: Record, slopes: np.ndarray) -> float:
    """The largest real part of an eigenvalue; where that changes along the record, the growth that is left of it over the record."""
    if not len(slopes):
        return 0.0
    rates = np.linalg.eigvals(slopes).real.max(axis=1)
    duration = float(record.h.sum())
    if system.linear or rates.max() * duration <= math.log(GROWN):
        return float(rates.mean())
    return _growth_along(_slopes(system, p, record, MANY_PLACES), duration)


def _growth_along(slopes: np.ndarray, duration: float) -> float:
    """Largest Lyapunov exponent (1/s) over the second half of the record, from the product of the transitions.

    The first half turns the errors into the direction that grows most. What grows like a power of time (a chain of integrators)
    gains a factor of two or four in the second half, which is not instability.
    """
    errors, logarithm = np.eye(slopes.shape[1]), 0.0
    for k, transition in enumerate(expm(slopes * (duration / len(slopes)))):
        errors = transition @ errors
        size = float(np.linalg.norm(errors))
        if not 0 < size < math.inf:
            return math.inf if size else -math.inf
        errors /= size
        logarithm += math.log(size) if k >= len(slopes) // 2 else 0.0
    return logarithm / (duration * (len(slopes) - len(slopes) // 2) / len(slopes))


def _stiff(system: System, slopes: np.ndarray, record: Record) -> TranscriptionProposal | None:
    """Implicit steps or collocation, where a fast mode rules the explicit step out."""
    fastest = max((compute_fastest_rate(slope, system.relaxing) for slope in slopes), default=0.0)
    period = float(np.median(record.h)) if len(record.h) else 0.0
    needed = fastest * period / EXPLICIT
    if system.linear or needed <= SUBSTEPS:
        return None
    why = f"stiff: the fastest mode moves within {1 / fastest:.2g} s, {needed:.0f} explicit steps a sample"
    if system.x.numel() <= DISCRETISATION.max_implicit_states:
        return TranscriptionProposal("single", f"{why}; implicit ones take it in a few", True)
    if system.dry or system.updates or system.delays:
        return TranscriptionProposal(
            "single", f"{why}; its equations stick, switch or are delayed, so they are taken all the same"
        )
    samples = len(record.samples(record.u))
    if samples > MOST_SAMPLES:
        return TranscriptionProposal(
            "single", f"{why}; {samples} samples are too many for collocation, so they are taken all the same"
        )
    return TranscriptionProposal("collocation", f"{why}; Radau points take it in one")


def _slopes(system: System, p: np.ndarray, record: Record, places: int) -> np.ndarray:
    """Jacobians (k, nx, nx) of the equations in several places of the record, those that can be computed; a linear model has one."""
    start = np.asarray(system.start_function(p)[0]).ravel()
    if system.linear:
        slope = system.jacobian(start, record.u[0, : system.u.numel()], p).full()
        return slope[None][: int(np.isfinite(slope).all())]
    names = {system.outputs[j].name(): j for j in range(system.outputs.numel()) if system.outputs[j].is_symbolic()}
    rows = np.unique(np.linspace(0, len(record.u) - 1, places).astype(int))
    x = np.tile(start, (len(rows), 1))
    for k, name in enumerate(system.state_names):
        if name in names:
            values = record.y[:, names[name]]
            known = np.flatnonzero(np.isfinite(values))
            if len(known):
                x[:, k] = values[known[np.minimum(np.searchsorted(known, rows), len(known) - 1)]]
    u = record.u[rows, : system.u.numel()]
    found = system.jacobian.map(len(rows))(x.T, u.T, ca.repmat(ca.DM(p), 1, len(rows))).full()
    slopes = found.reshape(len(start), len(rows), len(start)).swapaxes(0, 1)
    return slopes[np.isfinite(slopes).all(axis=(1, 2))]
