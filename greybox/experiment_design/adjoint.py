"""The gradient of a criterion along every sample of the inputs: states and sensitivities forward, their adjoint backward.

The compiled kernel runs inputs; here the same discrete step, with its sensitivities, is differentiated once more. With
``X = (x, S)``, ``S = dx/dz``, a sample is ``X' = F(X, u)`` and its outputs ``(y, dy/dz) = O(X, u)``. For a criterion with slopes
``c`` along them the adjoint ``l = F_X' l' + O_X' c`` gives the slopes ``F_u' l' + O_u' c`` along the inputs.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from greybox.experiment_design.adjoint_loops import make_loops
from greybox.experiment_design.plant import PlantScenario


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
        As of `greybox.experiment_design.plant.PlantRun`, with zeros in place of NaN.
    """

    def __init__(self, plant: PlantScenario, inputs: Mapping[str, np.ndarray], sensitive: bool = True) -> None:
        point, step = plant.point, plant.problem.step
        self.plant, self.substeps = plant, step.substeps
        self.nx, self.directions = len(point.x0), point.dx0.shape[1] if sensitive else 0
        self._loops = make_loops(step, self.directions)
        self._u = np.ascontiguousarray(np.array([inputs[i.name] for i in plant.model.inputs], float).T)
        rows = len(self._u)
        h = float(plant.template.sampling_time or 0.0) / step.substeps
        self._constants = np.concatenate([point.q[0], point.dq[0][:, : self.directions].ravel(order="F"), [h]])
        self._parameters = np.concatenate([point.p, point.dp[:, : self.directions].ravel(order="F")])
        start = np.concatenate([point.x0, point.dx0[:, : self.directions].ravel(order="F")])
        self._fine_u = np.repeat(self._u[:-1], step.substeps, axis=0)
        self._fine = self._loops.forward(start, self._fine_u, self._constants)
        self._samples = np.ascontiguousarray(self._fine[:: step.substeps])
        y = self._loops.outputs(self._samples, self._u, self._parameters)
        ny = len(plant.model.outputs)
        self.outputs, self.states = y[:, :ny], self._samples[:, : self.nx]
        shown = y[:, ny:].reshape(rows, self.directions, ny).transpose(0, 2, 1)
        self.slopes = shown * np.where(plant.measured, plant.weight, 0.0)[None, :, None]
        self.finite = bool(np.isfinite(y).all() and np.isfinite(self._fine).all())

    def gradient(self, outputs: np.ndarray, slopes: np.ndarray, states: np.ndarray) -> np.ndarray:
        """Slopes (nu, N) along the inputs of a criterion with these slopes along outputs (N, ny), `slopes` (N, ny, L), states (N, nx)."""
        rows = len(outputs)
        weight = np.where(self.plant.measured, self.plant.weight, 0.0)
        along = (slopes * weight[None, :, None]).transpose(0, 2, 1).reshape(rows, -1)
        cotangent = np.ascontiguousarray(np.hstack([outputs, along]))
        at_x, result = self._loops.outputs_back(self._samples, self._u, self._parameters, cotangent)
        at_x[:, : self.nx] += states
        added = np.zeros_like(self._fine)
        added[:: self.substeps] = at_x
        fine = self._loops.backward(self._fine, self._fine_u, self._constants, added)
        result[:-1] += fine.reshape(rows - 1, self.substeps, -1).sum(axis=1)
        return result.T


def is_differentiable(plant: PlantScenario) -> bool:
    """Whether the gradient can be had: not of a delayed input, whose step reads the past."""
    return plant.problem.step.past is None
