"""What every integrator hands over: one discrete step of a model, ready to be run over a record."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca
import numpy as np

from greybox.errors import ModelError

# (p (np,), interval lengths (nh,), which parameters (na,)) -> coefficients q (nh, nq) and d q / d p[which] (nh, nq, na)
CoefficientFunction = Callable[[np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]

RateFunction = Callable[[ca.SX, ca.SX, ca.SX], ca.SX]  # (x, u, p) -> dx/dt
AdvanceFunction = Callable[[ca.SX, ca.SX, ca.SX, ca.SX, ca.SX], ca.SX]  # (x, ua, ub, p, h) -> x after h seconds
IntegrationMethod = Callable[[RateFunction], AdvanceFunction]  # what one substep does with smooth equations


class InputHistory(NamedTuple):
    """What a step sees of the past: ``rows`` earlier rows of input number ``column``."""

    column: int
    rows: int


@dataclass(frozen=True, eq=False)
class Step:
    """One discrete step of a model.

    ``advance``: CasADi function ``(x (nx,), ua (nu,), ub (nu,), q (nq,), h) -> x_next (nx,)``, a step of length ``h`` with the input
    moving from ``ua`` to ``ub`` (equal when the input is held). A sampling interval is ``substeps`` such steps.

    ``outputs``: CasADi function ``(x, u (nu,), p (np,)) -> y (ny,)``.

    ``coefficients(p, h, which)``: what the step needs to know of the parameters, one row for each interval length in ``h``, and its
    slope along the parameters numbered ``which``. RK4 takes the parameters themselves (one row serves every length:
    ``per_interval`` is false); the exact hold takes the entries of the discrete matrices of each length.

    ``generator``: None, or for an exact hold the CasADi function ``p -> vec([A, B, c])`` (nx (nx + nu + 1),) per second whose exponential
    has the coefficients as entries, column by column as `exact_hold` states them; a kernel may then compute them itself.

    ``past``: None, or what of the past a delay needs; then ``ua``, ``ub`` and ``u`` are rows of
    `greybox.integrators.input_delay.add_input_history`,
    which `Record.seen_by` makes.
    """

    name: str
    advance: ca.Function
    outputs: ca.Function
    coefficients: CoefficientFunction
    substeps: int = 1
    per_interval: bool = False
    past: InputHistory | None = None
    generator: ca.Function | None = None

    def __post_init__(self) -> None:
        if self.past is not None and not self.per_interval and self.substeps < 2:
            raise ModelError("a delayed input cuts the interval in two; give at least 2 substeps")

    @property
    def label(self) -> str:
        """Name with the substeps: ``RK4, 4 substeps a sample``."""
        return self.name if self.substeps == 1 else f"{self.name}, {self.substeps} substeps a sample"
