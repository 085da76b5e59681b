"""The decision vector of a prediction-error fit: that of a free-run fit, and the logarithm of each output's noise."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from greybox.estimation.problem import EstimationProblem
from greybox.transcription import DecisionVector

# The noise of an output is not followed below this share of what the records' differences say, nor above its level at ``z = 0`` times
# the exponential of this.
LEAST, GREATEST = 1e-4, 25.0


@dataclass(frozen=True)
class LikelihoodUnknowns:
    """``z = [z of the variables; log(noise / level)]``; the second part for the outputs whose noise is estimated.

    ``level`` (ny,) standard deviation of each output's noise at ``z = 0``, ``estimated`` (ny,) bool, ``least`` (ny,) below which it is
    not followed.
    """

    variables: DecisionVector
    level: np.ndarray
    estimated: np.ndarray
    least: np.ndarray

    @property
    def size(self) -> int:
        """Length of ``z``."""
        return self.variables.size + int(self.estimated.sum())

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Bounds on ``z``."""
        low, high = self.variables.bounds()
        floor = np.minimum(np.log(self.least / self.level)[self.estimated], 0.0)
        return np.concatenate([low, floor]), np.concatenate([high, np.full(len(floor), GREATEST)])

    def noise(self, z: np.ndarray) -> np.ndarray:
        """Standard deviation of each output's noise (ny,)."""
        level = self.level.copy()
        level[self.estimated] *= np.exp(z[self.variables.size :])
        return level

    def columns(self, experiment: int) -> np.ndarray:
        """Which entries of ``z`` concern one experiment."""
        return np.concatenate([self.variables.columns(experiment), np.arange(self.variables.size, self.size)])

    def parameters(self, z: np.ndarray, experiment: int) -> np.ndarray:
        """What the filter calls parameters, ``[p; noise]`` (np + ny,), in one experiment."""
        return np.concatenate([self.variables.parameters(z[: self.variables.size], experiment), self.noise(z)])

    def slopes(self, pn: np.ndarray, experiment: int) -> np.ndarray:
        """Slopes (np + ny, L) of ``parameters`` along `columns`."""
        v = self.variables
        n, constants = len(pn) - len(self.level), len(v.which)
        lanes = self.columns(experiment)
        result = np.zeros((len(pn), len(lanes)))
        result[v.which, np.arange(constants)] = v.slopes(pn[:n], experiment)
        outputs = np.flatnonzero(self.estimated)
        result[n + outputs, len(lanes) - len(outputs) + np.arange(len(outputs))] = pn[n + outputs]
        return result

    def compute_initial_state(self, z: np.ndarray, pn: np.ndarray, experiment: int) -> tuple[np.ndarray, np.ndarray]:
        """First states (nx,) of an experiment and their slopes (nx, L) along `columns`."""
        v = self.variables
        x0, dx0 = v.compute_initial_state(z[: v.size], pn[: len(pn) - len(self.level)], experiment)
        return x0, np.hstack([dx0, np.zeros((len(x0), int(self.estimated.sum())))])

    def moved(self, z: np.ndarray) -> LikelihoodUnknowns:
        """The same with ``z = 0`` at the given point."""
        return replace(self, variables=self.variables.moved(z[: self.variables.size]), level=self.noise(z))

    def rescale(self, count: int, curvature: np.ndarray) -> LikelihoodUnknowns:
        """Linear scales such that a step of one changes ``-2 log L`` by about ``count``.

        ``curvature`` (size,) is the diagonal of half its Hessian.
        """
        v = self.variables
        return replace(self, variables=v.rescale(float(count), curvature[: v.size]))


def make_likelihood_unknowns(problem: EstimationProblem, variables: DecisionVector) -> LikelihoodUnknowns:
    """``variables`` with the noise of the outputs: known where it is given or a quiet record tells it, else estimated."""
    measured = np.any([np.isfinite(r.y).any(axis=0) for r in problem.records], axis=0)
    sources = problem.noise.sources
    known = np.array([o.name in sources and sources[o.name].is_independent for o in problem.model.outputs])
    return LikelihoodUnknowns(variables, problem.noise.std, measured & ~known, LEAST * problem.noise.std)
