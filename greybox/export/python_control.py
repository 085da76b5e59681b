"""Hand-over to python-control: linear models with signal names."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.signal import tf2ss

from greybox.errors import ModelError
from greybox.export.identifiers import to_identifier, to_identifiers
from greybox.export.linearisation import Linearisation

MOST_PADE = 10


def to_state_space(model: Linearisation, pade: int = 4) -> Any:
    """``control.StateSpace`` of ``model``; its attribute ``linearisation`` is ``model``, with units, operating point and notes.

    A delay of a continuous model is not in its matrices: it becomes a Pade approximation of order ``pade``, whose states come last.
    Raises ModelError for an order outside 1 to 10.
    """
    import control

    whole = approximate_delays(model, pade) if model.delay.any() else model
    system = control.StateSpace(
        whole.A, whole.B, whole.C, whole.D, whole.dt,
        states=to_identifiers(whole.state_names), inputs=to_identifiers(whole.input_names),
        outputs=to_identifiers(whole.output_names), name=to_identifier(whole.name), remove_useless_states=False,
    )  # fmt: skip
    system.linearisation = model
    return system


def to_transfer_function(model: Linearisation, pade: int = 4) -> Any:
    """``control.TransferFunction`` of ``model``, each channel cancelled by itself; delays as in `to_state_space`."""
    import control

    whole = approximate_delays(model, pade) if model.delay.any() else model
    rows = [[whole.channel(o, i) for i in whole.input_names] for o in whole.output_names]

    def each(of: str) -> list[list[np.ndarray]]:
        return [[getattr(channel, of) for channel in row] for row in rows]

    system = control.TransferFunction(
        each("numerator"), each("denominator"), whole.dt, inputs=to_identifiers(whole.input_names),
        outputs=to_identifiers(whole.output_names), name=to_identifier(whole.name),
    )  # fmt: skip
    system.linearisation = model
    return system


def approximate_delays(model: Linearisation, order: int) -> Linearisation:
    """A continuous ``model`` with its delays as Pade approximations of this ``order``, and a note up to which frequency they hold.

    The phase of an approximation of order n is right to within a degree up to ``w delay`` of about ``1.6 n - 1``.
    """
    if not 1 <= order <= MOST_PADE:
        raise ModelError(f"order {order} of a Pade approximation: give 1 to {MOST_PADE}")
    unit = _pade(order)
    A, B, C, D = model.A, model.B.copy(), model.C, model.D.copy()
    names, units, notes = list(model.state_names), list(model.state_units), list(model.notes)
    for j, seconds in enumerate(model.delay):
        if not seconds:
            continue
        a, b, c, d = unit[0] / seconds, unit[1] / seconds, unit[2], unit[3]
        corner = np.zeros((len(a), len(A)))
        A = np.block([[A, np.outer(B[:, j], c)], [corner, a]])
        C = np.hstack([C, np.outer(D[:, j], c)])
        D[:, j] *= d
        B = np.vstack([B, np.zeros((len(a), B.shape[1]))])
        B[:, j] *= d
        B[-len(a) :, j] = b.ravel()
        names += [f"{model.input_names[j]}_late_{i + 1}" for i in range(len(a))]
        units += [model.input_units[j]] * len(a)
        good = (1.6 * order - 1) / seconds
        notes.append(
            f"the delay of {seconds:.4g} s of {model.input_names[j]} is a Pade approximation of order {order}, good up to about"
            f" {good:.3g} rad/s; a sampled model (dt) holds it exactly"
        )
    extra = len(A) - len(model.A)
    return replace(
        model, A=A, B=B, C=C, D=D, state_names=tuple(names), state_units=tuple(units), delay=np.zeros_like(model.delay),
        x0=np.append(model.x0, np.zeros(extra)), rates=np.append(model.rates, np.zeros(extra)), notes=tuple(notes),
    )  # fmt: skip


def _pade(order: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """State space of the Pade approximation of a delay of one second; another delay only changes the unit of time."""
    import control

    a, b, c, d = tf2ss(*control.pade(1.0, order))
    return a, b, c, float(d[0, 0])
