"""The decision vector of a fit: scaled constants, then the free initial states of each experiment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np

from greybox.model import Model
from greybox.transcription.conditions import conditions_of, under

# A bound counts as active within this share of the distance to the other bound (or of the scale, if there is none).
ACTIVE = 1e-6


@dataclass(frozen=True)
class InitialStates:
    """How the records begin.

    ``guess`` (experiments, nx): values to start from; ``free`` (nx,): which states are estimated. A state that is not free
    has its declared start value, which may depend on the parameters.
    """

    guess: np.ndarray
    free: np.ndarray
    scale: np.ndarray


@dataclass(frozen=True)
class Variables:
    """Map between the optimiser's numbers ``z`` and physical ones.

    A constant that can only be positive is ``value * exp(z)``, another one ``value + scale * z``; an initial state is
    ``guess + scale * z``. ``z = 0`` is the start. ``conditions`` are the constants that an experiment brings itself (position in
    ``system.p`` -> value, one mapping for each experiment or none at all): they take the place of the model's and are not fitted.
    """

    model: Model
    names: tuple[str, ...]
    which: np.ndarray  # (nf,) position of each free constant in system.p
    logarithmic: np.ndarray  # (nf,) bool
    base: np.ndarray  # (nf,) value at z = 0
    scale: np.ndarray  # (nf,) used where not logarithmic
    low: np.ndarray
    high: np.ndarray
    fixed: np.ndarray  # (np,) values of all parameters at the start
    initial: InitialStates
    conditions: tuple[Mapping[int, float], ...] = ()

    @classmethod
    def of(cls, model: Model, initial: InitialStates, conditions: Sequence[Mapping[str, float]] = ()) -> Variables:
        """The free constants of ``model`` at their present values; ``conditions``: name -> value for each experiment.

        Raises ModelError for conditions that do not go with the model, see `conditions_of`.
        """
        everything = model.all_parameters
        given = conditions_of(model, conditions)
        known = {k for each in given for k in each}
        which = np.array([k for k, q in enumerate(everything) if not q.fixed and k not in known], int)
        free = [everything[k] for k in which]
        base = np.array([q.value for q in free], float)
        return cls(
            model, tuple(q.name for q in free), which, np.array([q.positive for q in free], bool), base,
            np.where(base == 0, 1.0, np.abs(base)), np.array([q.bounds[0] for q in free], float),
            np.array([q.bounds[1] for q in free], float), np.array([q.value for q in everything], float), initial, given,
        )  # fmt: skip

    @property
    def experiments(self) -> int:
        """Number of experiments."""
        return len(self.initial.guess)

    @property
    def states_each(self) -> np.ndarray:
        """Numbers of the initial states that are estimated in each experiment."""
        return np.flatnonzero(self.initial.free)

    @property
    def size(self) -> int:
        """Length of ``z``."""
        return len(self.which) + self.experiments * len(self.states_each)

    @property
    def labels(self) -> tuple[str, ...]:
        """What each entry of ``z`` stands for."""
        states = self.model.system.state_names
        return (
            *self.names,
            *(f"{states[j]}(0) of experiment {e + 1}" for e in range(self.experiments) for j in self.states_each),
        )

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Bounds on ``z``; initial states have their state's physical bounds."""
        span = np.where(self.logarithmic, 1.0, self.scale)
        with np.errstate(divide="ignore", invalid="ignore"):
            low = np.where(self.logarithmic, np.log(self.low / self.base), (self.low - self.base) / span)
            high = np.where(self.logarithmic, np.log(self.high / self.base), (self.high - self.base) / span)
        states = self.model.all_states
        for e in range(self.experiments):
            edges = np.array([states[j].bounds for j in self.states_each]).reshape(-1, 2)
            guess, scale = self.initial.guess[e, self.states_each], self.initial.scale[self.states_each]
            low = np.concatenate([low, (edges[:, 0] - guess) / scale])
            high = np.concatenate([high, (edges[:, 1] - guess) / scale])
        return low, high

    def parameters(self, z: np.ndarray, experiment: int | None = None) -> np.ndarray:
        """All parameters (np,) at ``z``, clipped to their bounds (an optimiser may overstep them by a hair).

        With ``experiment`` under the conditions of that one, else as the model has them.
        """
        n = len(self.which)
        with np.errstate(over="ignore"):
            free = self.base * np.exp(np.where(self.logarithmic, z[:n], 0.0)) + np.where(
                self.logarithmic, 0.0, self.scale * z[:n]
            )
        p = self.fixed.copy()
        with np.errstate(invalid="ignore"):
            near_low, near_high = (np.abs(free - edge) <= 1e-9 * np.abs(free) for edge in (self.low, self.high))
        free = np.where(near_low, self.low, np.where(near_high, self.high, free))  # exp(log(bound)) is not the bound
        p[self.which] = np.clip(free, self.low, self.high)
        return p if experiment is None or not self.conditions else under(p, self.conditions[experiment])

    def slopes(self, p: np.ndarray) -> np.ndarray:
        """d p / d z of the free constants (nf,) at parameters ``p``."""
        return np.where(self.logarithmic, p[self.which], self.scale)

    def columns(self, experiment: int) -> np.ndarray:
        """Which entries of ``z`` concern one experiment."""
        n, each = len(self.which), len(self.states_each)
        return np.concatenate([np.arange(n), n + experiment * each + np.arange(each)])

    def beginning(self, z: np.ndarray, p: np.ndarray, experiment: int) -> tuple[np.ndarray, np.ndarray]:
        """Initial state (nx,) of one experiment and its slopes (nx, L) along `columns`."""
        x0, slope = self._constant_start or self._start(p)
        x0 = x0.copy()
        n, free = len(self.which), self.states_each
        dx0 = np.zeros((len(x0), n + len(free)))
        dx0[:, :n] = slope[:, self.which] * self.slopes(p)
        own = z[self.columns(experiment)[n:]]
        x0[free] = self.initial.guess[experiment, free] + self.initial.scale[free] * own
        dx0[free, :n] = 0.0
        dx0[free, n + np.arange(len(free))] = self.initial.scale[free]
        return x0, dx0

    def _start(self, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The declared initial state (nx,) and its slope along all parameters."""
        x0, slope = (np.asarray(value) for value in self.model.system.start_function(p))
        return x0.ravel(), slope

    @cached_property
    def _constant_start(self) -> tuple[np.ndarray, np.ndarray] | None:
        """The declared initial state where it does not depend on the parameters: asked for in every pass."""
        system = self.model.system
        return None if ca.depends_on(system.start, system.p) else self._start(self.fixed)

    def rescaled(self, cost: float, curvature: np.ndarray) -> Variables:
        """Linear scales chosen so that a step of one in ``z`` changes the cost by about itself.

        ``curvature`` (size,) is the diagonal of the Gauss-Newton matrix at ``z = 0``. Entries without influence keep their scale.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            factor = np.sqrt(cost / curvature)
        factor = np.where(np.isfinite(factor) & (factor > 0), factor, 1.0)
        n, each = len(self.which), len(self.states_each)
        scale = np.where(self.logarithmic, self.scale, self.scale * factor[:n])
        states = self.initial.scale.copy()
        if each:
            states[self.states_each] *= np.exp(np.log(factor[n:]).reshape(-1, each).mean(axis=0))
        return replace(self, scale=scale, initial=replace(self.initial, scale=states))

    def moved(self, z: np.ndarray) -> Variables:
        """The same variables with ``z = 0`` at the given point."""
        p = self.parameters(z)
        guess = np.array([self.beginning(z, self.parameters(z, e), e)[0] for e in range(self.experiments)])
        return replace(self, base=p[self.which], fixed=p, initial=replace(self.initial, guess=guess))

    def active(self, p: np.ndarray) -> np.ndarray:
        """Which free constants lie on a bound (nf,)."""
        value = p[self.which]
        width = self.high - self.low
        reach = ACTIVE * np.where(np.isfinite(width) & ~self.logarithmic, width, np.maximum(np.abs(value), self.scale))
        return (value - self.low <= reach) | (self.high - value <= reach)
