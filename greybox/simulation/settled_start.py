"""Where a model comes to rest under inputs that stay as they are, with its slopes: a rig under a load, a culture before its experiment."""

from __future__ import annotations

import numpy as np

from greybox.model import System
from greybox.simulation.integrators.esdirk import esdirk
from greybox.simulation.kernel.adaptive import AdaptiveKernel
from greybox.simulation.kernel.interface import check_arguments
from greybox.simulation.kernel.record import Record

# The run towards rest is first as long as a record, then each time so many times longer, ...
LONGER = 100.0
# ... so often at most: after 1e8 records what still moves has no rest.
TIMES = 5
# Change of a state, over the largest of its unit, from one of these times to the next at which it rests.
SETTLED = 1e-8
# Runs that are kept: those of an evaluation are asked for once for each record.
KEPT = 64


class SettledStart:
    """The states at which each record begins: where the model comes to rest from its declared start, under the inputs before the record.

    A long run finds it, whose steps follow the error and grow without end where nothing moves: of several resting places it is the one
    that the rig comes to, and what the equations conserve (the sum of two species) stays as it was declared. The slopes are those of that
    run.

    Parameters
    ----------
    system
        The equations. Raises ModelError for those that are not smooth.
    inputs
        What the inputs of each record are before it (experiments, nu).
    duration
        Of the records, in seconds.
    """

    def __init__(self, system: System, inputs: np.ndarray, duration: float) -> None:
        self.system, self.inputs, self.duration = system, inputs, duration
        self._kernel = AdaptiveKernel(esdirk(system))
        self._known: dict[tuple[bytes, bytes, bytes], tuple[np.ndarray, np.ndarray]] = {}

    def at(self, p: np.ndarray, experiment: int, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The state (nx,) at the parameters ``p`` (np,), and its slopes (nx, L) along those numbered ``which``; NaN where nothing rests."""
        key = p.tobytes(), self.inputs[experiment].tobytes(), which.tobytes()
        if key not in self._known:
            if len(self._known) >= KEPT:
                self._known.pop(next(iter(self._known)))
            self._known[key] = self._find(p, self.inputs[experiment], which)
        return self._known[key]

    def _find(self, p: np.ndarray, u: np.ndarray, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x, slope = (np.asarray(value) for value in self.system.start_function(p))
        x, dx, dp = x.ravel(), slope[:, which], np.eye(len(p))[:, which]
        times = self.duration * LONGER ** np.arange(TIMES + 1)
        record = Record(
            np.tile(u, (len(times) + 1, 1)),
            np.full((len(times) + 1, self._kernel.sizes.ny), np.nan),
            np.diff(times, prepend=0.0),
            np.arange(len(times)),
            np.diff(times, prepend=0.0),
        )
        nothing = np.zeros((1, self._kernel.sizes.nq)), np.zeros((1, self._kernel.sizes.nq, len(which)))
        arguments = check_arguments(self._kernel.sizes, record.read_by(self._kernel.step), *nothing, p, dp, x, dx)
        (part,) = self._kernel.run_parts(record, len(times) + 1, arguments)
        size = self._measure_sizes(part.x)
        for k in range(1, len(times)):
            if np.all(np.abs(part.x[k + 1] - part.x[k]) <= SETTLED * size):
                return part.x[k + 1], part.tangents[k + 1]
        return np.full(len(x), np.nan), np.full(dx.shape, np.nan)

    def _measure_sizes(self, x: np.ndarray) -> np.ndarray:
        """The largest size so far of the states in the unit of each (nx,)."""
        largest = np.nanmax(np.abs(x), axis=0)
        units = np.array([state.unit for state in self.system.states])
        return np.array([largest[units == unit].max() for unit in units])


def find_inputs_before(record: Record, inputs: int) -> np.ndarray:
    """What the inputs (nu,) were before a record: as it tells, else as in its first row."""
    return record.u[0, :inputs] if record.before is None else record.before[-1, :inputs]
