"""The gradient of a criterion along every sample of the inputs: states and sensitivities forward, their adjoint backward.

The compiled kernel runs inputs; here the same discrete step, with its sensitivities, is differentiated once more. With
``X = (x, S)``, ``S = dx/dz``, a sample is ``X' = F(X, u)`` and its outputs ``(y, dy/dz) = O(X, u)``. For a criterion with slopes
``c`` along them the adjoint ``l = F_X' l' + O_X' c`` gives the slopes ``F_u' l' + O_u' c`` along the inputs.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import casadi as ca
import numpy as np

from greybox.extensions.design.plant import PlantScenario
from greybox.simulation.integrators.step import Step
from greybox.simulation.kernel.c_compiler import CompilerError, load_library


class StepDerivatives:
    """A substep with sensitivities and its adjoint, outputs with sensitivities and theirs, as CasADi functions.

    Parameters
    ----------
    step
        The discrete step.
    directions
        Number of sensitivities.
    """

    def __init__(self, step: Step, directions: int) -> None:
        nx, nu = step.advance.size1_in(0), step.advance.size1_in(1)
        nq, np_ = step.advance.size1_in(3), step.outputs.size1_in(2)
        X = ca.SX.sym("X", nx * (1 + directions))
        x, S = X[:nx], ca.reshape(X[nx:], nx, directions)
        u = ca.SX.sym("u", nu)
        c = ca.SX.sym("c", nq * (1 + directions) + 1)
        q, dq, h = c[:nq], ca.reshape(c[nq:-1], nq, directions), c[-1]
        moved = step.advance(x, u, u, q, h)
        # S' = F_x S + F_q dq/dz
        tangent = ca.jtimes(moved, ca.vertcat(x, q), ca.vertcat(S, dq)) if directions else ca.SX(nx, 0)
        after = ca.vertcat(moved, ca.vec(tangent))
        self.forward = ca.Function("forward", [X, u, c], [after])
        costate, added = ca.SX.sym("l", X.numel()), ca.SX.sym("a", X.numel())
        # [l_X, l_u] = F_{X,u}' l': the transpose along the costate, second derivatives of the step included because
        # S is part of X.
        back = ca.jtimes(after, ca.vertcat(X, u), costate, True)
        size = X.numel()
        # l_k = F_X' l_{k+1} + O_X' c_k
        self.backward = ca.Function("backward", [costate, X, u, c, added], [back[:size] + added, back[size:]])
        d = ca.SX.sym("d", np_ * (1 + directions))
        p, dp = d[:np_], ca.reshape(d[np_:], np_, directions)
        y = step.outputs(x, u, p)
        # dy/dz = O_x S + O_p dp/dz
        slopes = ca.jtimes(y, ca.vertcat(x, p), ca.vertcat(S, dp)) if directions else ca.SX(y.numel(), 0)
        shown = ca.vertcat(y, ca.vec(slopes))
        self.outputs = ca.Function("outputs", [X, u, d], [shown])
        cotangent = ca.SX.sym("b", shown.numel())
        # O_{X,u}' c
        along = ca.jtimes(shown, ca.vertcat(X, u), cotangent, True)
        self.outputs_back = ca.Function("outputs_back", [X, u, d, cotangent], [along[:size], along[size:]])
        self.states, self.inputs, self.shown = size, nu, shown.numel()

    @property
    def all(self) -> tuple[ca.Function, ...]:
        """The four functions."""
        return self.forward, self.backward, self.outputs, self.outputs_back


class AdjointLoops:
    """The four loops of an adjoint over all samples of a record, as CasADi's maps: where there is no compiler.

    Rows are samples (or substeps); n substeps, N samples; arrays of float64, one row after the other in memory.
    """

    def __init__(self, functions: StepDerivatives) -> None:
        self.functions = functions

    def forward(self, start: np.ndarray, u: np.ndarray, c: np.ndarray) -> np.ndarray:
        """States with sensitivities (n + 1, nX) from ``start`` (nX,) under inputs (n, nu) with constants ``c``."""
        run = self.functions.forward.mapaccum(len(u))(start, u.T, np.tile(c[:, None], len(u))).full()
        return np.ascontiguousarray(np.column_stack([start, run]).T)

    def backward(self, X: np.ndarray, u: np.ndarray, c: np.ndarray, added: np.ndarray) -> np.ndarray:
        """Slopes along the inputs (n, nu), given what is ``added`` (n + 1, nX) to the costate at each row of ``X``."""
        count, backward = len(u), self.functions.backward.mapaccum(len(u))
        late = X[:-1][::-1].T, u[::-1].T, np.tile(c[:, None], count), added[:-1][::-1].T
        _, along = backward(added[-1], *late)
        return along.full().T[::-1]

    def outputs(self, X: np.ndarray, u: np.ndarray, d: np.ndarray) -> np.ndarray:
        """Outputs with sensitivities (N, nY)."""
        return self.functions.outputs.map(len(u))(X.T, u.T, np.tile(d[:, None], len(u))).full().T

    def outputs_back(
        self, X: np.ndarray, u: np.ndarray, d: np.ndarray, along: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Slopes along states with sensitivities (N, nX) and inputs (N, nu), given those along outputs (N, nY)."""
        back = self.functions.outputs_back.map(len(u))
        at_x, at_u = back(X.T, u.T, np.tile(d[:, None], len(u)), along.T)
        return at_x.full().T, at_u.full().T


class CompiledLoops(AdjointLoops):
    """The loops in C (``adjoint.c``). Raises CompilerError where that cannot be made."""

    def __init__(self, functions: StepDerivatives) -> None:
        super().__init__(functions)
        key = " ".join(f.serialize() for f in functions.all)
        self.loops = Path(__file__).with_name("adjoint.c").read_text(encoding="utf-8")
        self.library = load_library(lambda: self.source, f"adjoint {self.loops} {key}")
        self._iw = np.zeros(max(f.sz_iw() for f in functions.all) + 1, np.int64)
        self._w = np.zeros(max(f.sz_w() for f in functions.all) + 1)
        self._work = _find_address(self._iw), _find_address(self._w)
        # Sizes and arrays of each loop. Types are declared once: a search calls the loops some hundred thousand times.
        for name, sizes, arrays in (
            ("run_forward", 3, 3),
            ("run_backward", 3, 6),
            ("run_outputs", 4, 4),
            ("run_outputs_back", 4, 6),
        ):
            function = getattr(self.library, name)
            function.argtypes = [ctypes.c_longlong] * sizes + [ctypes.c_void_p] * (arrays + len(self._work))
            function.restype = None

    @cached_property
    def source(self) -> str:
        """The C of the functions and loops."""
        generator = ca.CodeGenerator("adjoint", {"with_header": False, "casadi_int": "long long"})
        for function in self.functions.all:
            generator.add(function)
        return str(generator.dump()) + self.loops

    def forward(self, start: np.ndarray, u: np.ndarray, c: np.ndarray) -> np.ndarray:
        """See `AdjointLoops.forward`."""
        X = np.empty((len(u) + 1, self.functions.states))
        X[0] = start
        self._call("run_forward", (len(u), self.functions.states, self.functions.inputs), u, c, X)
        return X

    def backward(self, X: np.ndarray, u: np.ndarray, c: np.ndarray, added: np.ndarray) -> np.ndarray:
        """See `AdjointLoops.backward`."""
        costate, along = np.zeros_like(added), np.zeros_like(u)
        costate[-1] = added[-1]
        sizes = (len(u), self.functions.states, self.functions.inputs)
        self._call("run_backward", sizes, X, u, c, added, costate, along)
        return along

    def outputs(self, X: np.ndarray, u: np.ndarray, d: np.ndarray) -> np.ndarray:
        """See `AdjointLoops.outputs`."""
        y = np.zeros((len(u), self.functions.shown))
        self._call("run_outputs", self._sizes(u), X, u, d, y)
        return y

    def outputs_back(
        self, X: np.ndarray, u: np.ndarray, d: np.ndarray, along: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """See `AdjointLoops.outputs_back`."""
        at_x, at_u = np.zeros((len(u), self.functions.states)), np.zeros_like(u)
        self._call("run_outputs_back", self._sizes(u), X, u, d, along, at_x, at_u)
        return at_x, at_u

    def _sizes(self, u: np.ndarray) -> tuple[int, ...]:
        return len(u), self.functions.states, self.functions.inputs, self.functions.shown

    def _call(self, name: str, sizes: tuple[int, ...], *arrays: np.ndarray) -> None:
        for array in arrays:
            assert array.flags.c_contiguous and array.dtype == np.float64  # C reads them as they lie
        getattr(self.library, name)(*sizes, *map(_find_address, arrays), *self._work)


def _find_address(array: np.ndarray) -> int:
    """Where the numbers of an array begin."""
    address: int = array.__array_interface__["data"][0]
    return address


@lru_cache(maxsize=64)
def make_loops(step: Step, directions: int) -> AdjointLoops:
    """The fastest loops that this machine can make; ``GREYBOX_KERNEL`` decides as for kernels."""
    functions = StepDerivatives(step, directions)
    if os.environ.get("GREYBOX_KERNEL") == "interpreted":
        return AdjointLoops(functions)
    try:
        return CompiledLoops(functions)
    except CompilerError:  # the kernel has warned of it, with its reason
        return AdjointLoops(functions)


@dataclass(frozen=True, eq=False)
class PreparedPlant:
    """What the loops need of a plant, the same for every input: the first state, constants, parameters, and the weight of its outputs."""

    loops: AdjointLoops
    directions: int
    start: np.ndarray
    constants: np.ndarray
    parameters: np.ndarray
    weight: np.ndarray


@lru_cache(maxsize=64)
def _prepare(plant: PlantScenario, sensitive: bool) -> PreparedPlant:
    point, step = plant.point, plant.problem.step
    directions = point.dx0.shape[1] if sensitive else 0
    # h of a substep
    h = float(plant.template.sampling_time or 0.0) / step.substeps
    return PreparedPlant(
        make_loops(step, directions),
        directions,
        np.concatenate([point.x0, point.dx0[:, :directions].ravel(order="F")]),
        np.concatenate([point.q[0], point.dq[0][:, :directions].ravel(order="F"), [h]]),
        np.concatenate([point.p, point.dp[:, :directions].ravel(order="F")]),
        np.where(plant.measured, plant.weight, 0.0),
    )


class SensitivityRun:
    """A run of one plant over an input with its sensitivities, and what makes a gradient from them.

    Parameters
    ----------
    plant
        The plant.
    inputs
        By name, each (N,), held over each sampling interval.
    sensitive
        Whether it carries sensitivities; without them it is cheaper, and ``slopes`` is empty.

    Attributes
    ----------
    outputs, states, slopes
        As of `greybox.extensions.design.plant.PlantRun`, with zeros in place of NaN.
    """

    def __init__(self, plant: PlantScenario, inputs: Mapping[str, np.ndarray], sensitive: bool = True) -> None:
        prepared = _prepare(plant, sensitive)
        self.plant, self.substeps = plant, plant.problem.step.substeps
        self.nx, self.directions = len(plant.point.x0), prepared.directions
        self._loops, self._constants, self._parameters = prepared.loops, prepared.constants, prepared.parameters
        self._weight = prepared.weight
        self._u = np.ascontiguousarray(np.array([inputs[i.name] for i in plant.model.inputs], float).T)
        rows = len(self._u)
        # Held inputs: every substep of an interval has the same one, and the slopes of its substeps add up.
        self._fine_u = self._u[:-1] if self.substeps == 1 else np.repeat(self._u[:-1], self.substeps, axis=0)
        # Kept at every substep: the backward pass linearises where the forward pass was. Memory grows with the
        # record, hence `DESIGN_MOST_ROWS`.
        self._fine = self._loops.forward(prepared.start, self._fine_u, self._constants)
        self._samples = np.ascontiguousarray(self._fine[:: self.substeps])
        y = self._loops.outputs(self._samples, self._u, self._parameters)
        ny = len(plant.model.outputs)
        self.outputs, self.states = y[:, :ny], self._samples[:, : self.nx]
        shown = y[:, ny:].reshape(rows, self.directions, ny).transpose(0, 2, 1)
        # As rows of samples and outputs they are multiplied with many matrices.
        self.slopes = np.ascontiguousarray(shown * self._weight[None, :, None])
        self.finite = bool(np.isfinite(y).all() and np.isfinite(self._fine).all())

    def gradient(self, outputs: np.ndarray, slopes: np.ndarray, states: np.ndarray) -> np.ndarray:
        """Slopes (nu, N) along the inputs of a criterion with these slopes along outputs (N, ny), `slopes` (N, ny, L), states (N, nx)."""
        rows = len(outputs)
        along = (slopes * self._weight[None, :, None]).transpose(0, 2, 1).reshape(rows, -1)
        cotangent = np.ascontiguousarray(np.hstack([outputs, along]))
        at_x, result = self._loops.outputs_back(self._samples, self._u, self._parameters, cotangent)
        at_x[:, : self.nx] += states
        added = at_x
        if self.substeps > 1:
            # Outputs are seen at samples alone: what they add to the costate stands in those rows.
            added = np.zeros_like(self._fine)
            added[:: self.substeps] = at_x
        fine = self._loops.backward(self._fine, self._fine_u, self._constants, added)
        result[:-1] += fine.reshape(rows - 1, self.substeps, -1).sum(axis=1) if self.substeps > 1 else fine
        return result.T


def is_differentiable(plant: PlantScenario) -> bool:
    """Whether the gradient can be had: not of a delayed input, whose step reads the past."""
    return plant.problem.step.past is None
