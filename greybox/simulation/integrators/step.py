"""What every integrator hands over: one discrete step of a model, ready to be run over a record."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca
import numpy as np

from greybox.base import ModelError

# CasADi functions called with numpy arrays in place.


def call_function(function: ca.Function, *arguments: np.ndarray) -> list[np.ndarray]:
    """Every output of ``function``, which must be dense, as an array (rows, columns).

    The detour over CasADi's own matrices that an ordinary call makes costs many times a small function; this has a buffer of its
    own for each call, hence for each thread.
    """
    buffer, evaluate = function.buffer()
    # CasADi stores column by column; the list keeps the arrays alive while the buffer points into them.
    columns = [np.asarray(a, dtype=np.float64).ravel(order="F") for a in arguments]
    for i, array in enumerate(columns):
        buffer.set_arg(i, array.data)
    results = [np.empty((function.size2_out(i), function.size1_out(i))) for i in range(function.n_out())]
    for i, array in enumerate(results):
        if array.size:
            buffer.set_res(i, array.data)
    evaluate()
    return [array.T for array in results]


# States from which the exact hold of a linear model is not written out as instructions, whose number grows as their square: its products
# of matrices, or the series of its exponential, take its place.
MANY_STATES = 16

# (p (np,), interval lengths (nh,), which parameters (na,)) -> coefficients q (nh, nq) and d q / d p[which] (nh, nq, na)
CoefficientFunction = Callable[[np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]

RateFunction = Callable[[ca.SX, ca.SX, ca.SX], ca.SX]  # (x, u, p) -> dx/dt
AdvanceFunction = Callable[[ca.SX, ca.SX, ca.SX, ca.SX, ca.SX], ca.SX]  # (x, ua, ub, p, h) -> x after h seconds
IntegrationMethod = Callable[[RateFunction], AdvanceFunction]  # what one substep does with smooth equations


class InputHistory(NamedTuple):
    """The past inputs that a step reads: ``rows`` earlier rows of input number ``column``, with their times where rows lie unevenly."""

    column: int
    rows: int
    uneven: bool = False


@dataclass(frozen=True, eq=False)
class AdaptiveRates:
    """What steps of any length need to know of a model: ``rates`` (x, u, p) -> dx/dt, the units of its states, the relative error of each
    state that a step may make, and number, low and high of each state that stops at limits."""

    rates: ca.Function
    units: tuple[str, ...]
    tolerance: float
    limits: tuple[tuple[int, float, float], ...] = ()


@dataclass(frozen=True, eq=False)
class Step:
    """One discrete step of a model: what every integrator makes and every kernel runs."""

    name: str
    """What the step is called, such as ``RK4``."""

    advance: ca.Function
    """``(x (nx,), ua (nu,), ub (nu,), q (nq,), h) -> x_next (nx,)``: a step of length ``h`` with the input moving from ``ua`` to ``ub``
    (equal when the input is held)."""

    outputs: ca.Function
    """``(x, u (nu,), p (np,)) -> y (ny,)``."""

    coefficients: CoefficientFunction
    """``(p, h, which) -> (q, dq)``: what the step needs to know of the parameters, one row for each interval length in ``h``, and its
    slope along the parameters numbered ``which``. RK4 takes the parameters themselves, one row for every length; the exact hold takes
    the entries of the discrete matrices of each length."""

    substeps: int = 1
    """How many such steps make a sampling interval."""

    per_interval: bool = False
    """Whether the coefficients depend on the interval length."""

    past: InputHistory | None = None
    """What of the past a delayed input needs; then ``ua``, ``ub`` and ``u`` are rows of
    `greybox.simulation.integrators.input_delay.add_input_history`, which `Record.read_by` makes."""

    generator: ca.Function | None = None
    """Of an exact hold ``p -> vec([A, B, c])`` (nx (nx + nu + 1),) per second, whose exponential has the coefficients as entries, column
    by column as `exact_hold` states them; a kernel may then compute them itself."""

    regressors: ca.Function | None = None
    """Of a step that is linear ``(ua, ub) -> r (nr,)``: ``x_next = Q [x; r]`` with ``q`` the matrix ``Q`` (nx, nx + nr), column by
    column."""

    implicit: bool = False
    """Whether it is stable however fast a mode decays."""

    adaptive: AdaptiveRates | None = None
    """Of steps whose lengths follow the error: what a kernel needs instead of ``advance``, which is RK4; ``substeps`` then says how many
    times shorter they are than the tolerance asks for."""

    reach: float | None = None
    """Largest ``|h lambda|`` of a substep where that is not as `DiscretisationPolicy` says: the method has an order of its own."""

    def __post_init__(self) -> None:
        if self.past is not None and not self.per_interval and self.substeps < 2:
            raise ModelError("a delayed input cuts the interval in two; give at least 2 substeps")

    @property
    def label(self) -> str:
        """Name with the substeps: ``RK4, 4 substeps a sample``; with the tolerance where they follow the error."""
        if self.adaptive is not None:
            shorter = "" if self.substeps == 1 else f", steps {self.substeps} times shorter"
            return f"{self.name} with steps that follow the error, {self.adaptive.tolerance:g}{shorter}"
        return self.name if self.substeps == 1 else f"{self.name}, {self.substeps} substeps a sample"
