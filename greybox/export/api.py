"""`to_control`, `to_mat`, `to_json`, `to_numpy`: a fit in one call to what a control engineer works with."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from greybox.errors import ModelError, nearest
from greybox.export.linear_files import write_json, write_mat, write_npz
from greybox.export.linearisation import Linearisation
from greybox.export.linearise import linearise
from greybox.export.model_family import ModelFamily, sample_family
from greybox.export.nonlinear import to_nonlinear_system
from greybox.export.plant import to_plant
from greybox.kernel import GreyboxWarning
from greybox.model import Model
from greybox.result import Fit

FORMS = ("state_space", "transfer_function", "nonlinear")


def to_control(
    plant: Fit | Model,
    at: Mapping[str, float] | None = None,
    *,
    dt: float | None = None,
    method: str = "zoh",
    delay: float = 0.0,
    form: str = "state_space",
    minimal: bool = False,
    pade: int = 4,
) -> Any:
    """A fit (or model) as a system of python-control, with signal names.

    ``form``: ``state_space`` and ``transfer_function`` about the operating point ``at`` (see `linearise`, also for ``dt``, ``method`` and
    ``delay``), or ``nonlinear``, a ``control.NonlinearIOSystem`` (see `to_nonlinear_system`; ``at``, ``method`` and ``delay`` do
    not apply).
    ``minimal`` takes out states that are not reached or not seen; ``pade`` is the order in which the delay of a continuous model is
    approximated. Linear systems carry their `Linearisation` as the attribute ``linearisation``: units, operating point, notes.

    Notes (no equilibrium, what stands in for dry friction, a sampling time that is too long) are given as warnings. Raises ModelError
    for unknown names, and for options that do not apply.
    """
    if form not in FORMS:
        raise ModelError(f"unknown form {form!r}; {nearest(form, FORMS)}")
    if form == "nonlinear":
        idle = [
            n for n, given in (("at", at), ("delay", delay), ("minimal", minimal), ("method", method != "zoh")) if given
        ]
        if idle:
            raise ModelError(
                f"{', '.join(idle)} cannot be given with form='nonlinear'; leave out, or take another form"
            )
        _warn(to_plant(plant).notes)
        return to_nonlinear_system(plant, dt)
    model = linearise(plant, at, dt=dt, method=method, delay=delay)
    _warn(model.notes)
    model = model.minimal() if minimal else model
    return model.state_space(pade) if form == "state_space" else model.transfer_function(pade)


def to_mat(
    plant: Fit | Model, path: str | Path, at: Mapping[str, float] | None = None, *,
    dt: float | None = None, method: str = "zoh", delay: float = 0.0, minimal: bool = False, samples: int = 0, seed: int = 0,
) -> Path:  # fmt: skip
    """Write the linear model about ``at`` as MATLAB's ``.mat`` (see `greybox.export.linear_files.write_mat`).

    ``samples`` above zero adds that many models drawn from the covariance of the constants. Other arguments, notes and errors as for
    `to_control`.
    """
    model, drawn = _linear(plant, at, dt, method, delay, minimal, samples, seed)
    return write_mat(model, path, plant=to_plant(plant), family=drawn)


def to_json(
    plant: Fit | Model, path: str | Path, at: Mapping[str, float] | None = None, *,
    dt: float | None = None, method: str = "zoh", delay: float = 0.0, minimal: bool = False, samples: int = 0, seed: int = 0,
) -> Path:  # fmt: skip
    """Write the linear model about ``at`` as JSON: matrices, names, units, poles, zeros, constants, covariance. See `to_mat`."""
    model, drawn = _linear(plant, at, dt, method, delay, minimal, samples, seed)
    return write_json(model, path, plant=to_plant(plant), family=drawn)


def to_numpy(
    plant: Fit | Model, path: str | Path, at: Mapping[str, float] | None = None, *,
    dt: float | None = None, method: str = "zoh", delay: float = 0.0, minimal: bool = False, samples: int = 0, seed: int = 0,
) -> Path:  # fmt: skip
    """Write the linear model about ``at`` as arrays of NumPy (``.npz``). See `to_mat`."""
    model, drawn = _linear(plant, at, dt, method, delay, minimal, samples, seed)
    return write_npz(model, path, plant=to_plant(plant), family=drawn)


def _linear(
    plant: Fit | Model, at: Mapping[str, float] | None, dt: float | None, method: str, delay: float, minimal: bool,
    samples: int, seed: int,
) -> tuple[Linearisation, ModelFamily | None]:  # fmt: skip
    model = linearise(plant, at, dt=dt, method=method, delay=delay)
    drawn = None
    if samples:
        if not isinstance(plant, Fit):
            raise ModelError(
                "samples need a fit, whose constants have a covariance; give what gb.fit returns, or samples=0"
            )
        drawn = sample_family(plant, at, number=samples, seed=seed, dt=dt, method=method, delay=delay, minimal=minimal)
    _warn((*model.notes, *(drawn.notes if drawn else ())))
    return model.minimal() if minimal else model, drawn


def _warn(notes: tuple[str, ...]) -> None:
    for note in notes:
        warnings.warn(note, GreyboxWarning, stacklevel=3)
