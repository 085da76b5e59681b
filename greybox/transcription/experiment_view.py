"""One experiment's view of the decision vector: its parameters and first state at a point, and the directions they move in."""

from __future__ import annotations

import numpy as np

from greybox.transcription.conditions import apply_conditions
from greybox.transcription.decision_vector import DecisionVector


class ExperimentView:
    """The entries of ``z`` that one experiment sees: constants (the shared ones and its own), then its free initial states.

    ``columns`` (L,): where they stand in ``z``; ``square``: the same as an index of a matrix. What does not change from point to
    point is laid out once: a pass over a short record takes less time than this would.
    """

    def __init__(self, variables: DecisionVector, experiment: int) -> None:
        v, n = variables, len(variables.which)
        self.variables, self.experiment = v, experiment
        self.own = np.flatnonzero(~v.is_foreign(experiment))
        self.which, self.logarithmic, self.scale = v.which[self.own], v.logarithmic[self.own], v.scale[self.own]
        self.states, self.begins = v.free_states, v.columns(experiment)[n:]
        self.columns = np.concatenate([self.own, self.begins])
        self.square = np.ix_(self.columns, self.columns)
        self.kept = np.concatenate([self.own, n + np.arange(len(self.states))])
        self.fixed = apply_conditions(v.fixed, v.conditions[experiment]) if v.conditions else v.fixed
        self.places = self.which, np.arange(len(self.own))
        self.slope = np.zeros((len(self.fixed), len(self.columns)))
        start = v.model.system.constant_start
        self.start: np.ndarray | None = None
        if start is not None:
            guess, scale = v.initial.guess[experiment, self.states], v.initial.scale[self.states]
            own = start.copy()
            own[self.states] = guess
            self.start, self.stretch = own, scale
            self.start_slope = np.zeros((len(start), len(self.columns)))
            self.start_slope[self.states, len(self.own) + np.arange(len(self.states))] = scale

    def at(self, z: np.ndarray, free: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Parameters (np,), their slopes (np, L), first state (nx,), its slopes (nx, L); ``free`` are `DecisionVector.constants`
        at ``z``."""
        p, dp = self.fixed.copy(), self.slope.copy()
        p[self.which] = free[self.own]
        dp[self.places] = np.where(self.logarithmic, p[self.which], self.scale)
        if self.start is None:
            x0, dx0 = self.variables.compute_initial_state(z, p, self.experiment)
            return p, dp, x0, dx0[:, self.kept]
        x0 = self.start.copy()
        x0[self.states] += self.stretch * z[self.begins]
        return p, dp, x0, self.start_slope
