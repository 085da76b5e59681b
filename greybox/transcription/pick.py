"""Which transcription suits a model and its record, and why."""

from __future__ import annotations

import math

import numpy as np

from greybox.kernel import Record
from greybox.model.system import System

TRANSCRIPTIONS = ("single", "multiple", "collocation")
# Eigenvalues are looked at in so many places along the record.
PLACES = 9
# A free run loses the constants where errors grow by more than this factor, ...
GROWN = 20.0
# ... and drifts far where an integrator (which forgets less than this share over the record) runs for so many of the plant's
# own time constants.
FORGETS, LONG = 0.03, 50.0
# So many explicit substeps a sample are too many; collocation is for at most so many samples.
SUBSTEPS, EXPLICIT, MOST_SAMPLES = 32, 0.5, 10_000


def pick(system: System, p: np.ndarray, record: Record, *, integrating: str = "multiple") -> tuple[str, str]:
    """The transcription for ``system`` at the parameters ``p`` (np,) over ``record``, and the reason in words.

    ``multiple`` shooting where errors grow along the record (an unstable or chaotic plant) or an integrator makes them drift
    over a long one; ``collocation`` where the fastest mode asks for more explicit steps than are sensible (stiff, nonlinear,
    smooth, and not too long); else ``single`` shooting on a growing record. Judged by the eigenvalues of the equations
    linearised in several places of the record (measured states as measured, hidden ones as declared). ``integrating`` says what
    an integrator asks for: on smooth plants with little noise a free run over a growing part of the record gets there as
    surely and several times faster, ``integrating="single"``.
    """
    eigenvalues = _eigenvalues(system, p, record)
    duration = float(record.h.sum())
    growth = _growth(eigenvalues)
    if growth * duration > math.log(GROWN):
        return "multiple", (
            f"unstable: errors grow at {growth:.3g} 1/s, by e^{growth * duration:.3g} over the record of {duration:.4g} s;"
            " a free run cannot be followed that far"
        )
    stiff = _stiff(system, eigenvalues, record)
    if stiff:
        return stiff
    parts = np.concatenate(eigenvalues)
    decays = -parts.real[-parts.real * duration > FORGETS]
    keeps = np.abs(parts) * duration <= FORGETS
    slowest = 1 / decays.min() if len(decays) else 0.0
    if keeps.any() and duration > LONG * slowest:
        rest = f", and {duration:.4g} s are {duration / slowest:.0f} times its slowest other mode" if slowest else ""
        return integrating, f"integrating: what is wrong adds up along the record and is never forgotten{rest}"
    return "single", "stable and not stiff: a free run over a growing part of the record needs the fewest unknowns"


def growth_of(system: System, p: np.ndarray, record: Record) -> float:
    """Mean rate (1/s) at which small errors grow along ``record``; negative where they decay. See `rows_of_segment`."""
    return _growth(_eigenvalues(system, p, record))


def _growth(eigenvalues: list[np.ndarray]) -> float:
    return float(np.mean([e.real.max(initial=-np.inf) for e in eigenvalues])) if eigenvalues else 0.0


def _stiff(system: System, eigenvalues: list[np.ndarray], record: Record) -> tuple[str, str] | None:
    """Collocation, or single shooting with an implicit step, where a fast mode rules the explicit one out."""
    fastest = max((float((-e.real).max(initial=0.0)) for e in eigenvalues), default=0.0)
    period = float(np.median(record.h)) if len(record.h) else 0.0
    needed = fastest * period / EXPLICIT
    if system.linear or needed <= SUBSTEPS:
        return None
    why = f"stiff: the fastest mode decays within {1 / fastest:.2g} s, {needed:.0f} explicit steps a sample"
    if system.dry or system.updates or system.delays:
        return "single", f"{why}; its equations stick, switch or are delayed, so it is shot with an implicit step"
    samples = len(record.samples(record.u))
    if samples > MOST_SAMPLES:
        return "single", f"{why}; {samples} samples are too many for collocation, so it is shot with an implicit step"
    return "collocation", f"{why}; Radau points take it in one"


def _eigenvalues(system: System, p: np.ndarray, record: Record) -> list[np.ndarray]:
    """Eigenvalues (nx,) in several places of the record, those that can be computed."""
    start = np.asarray(system.start_function(p)[0]).ravel()
    names = {system.outputs[j].name(): j for j in range(system.outputs.numel()) if system.outputs[j].is_symbolic()}
    found = []
    for row in np.unique(np.linspace(0, len(record.u) - 1, PLACES).astype(int)):
        x = start.copy()
        for k, name in enumerate(system.state_names):
            if name in names:
                values = record.y[row:, names[name]]
                known = values[np.isfinite(values)]
                x[k] = known[0] if len(known) else x[k]
        matrix = system.jacobian(x, record.u[row, : system.u.numel()], p).full()
        if np.isfinite(matrix).all():
            found.append(np.linalg.eigvals(matrix))
    return found
