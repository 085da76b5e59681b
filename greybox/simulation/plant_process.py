"""A plant that runs machine code of others, in a process of its own: a run that ends that process is a run that failed.

An FMU that aborts, or reads beyond its arrays, would take the whole command along without a word.
"""

from __future__ import annotations

import shutil
import tempfile
import weakref
from collections import Counter
from collections.abc import Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.util import Finalize
from typing import Any

import numpy as np

from greybox.base.packing import pack, pack_values, unpack, unpack_shared
from greybox.base.parallel.local_pool import LocalPool, quiet_children
from greybox.data.experiment import Experiment
from greybox.simulation.plant import PlantLostError, PlantRunError

# A search draws back from constants at which the code breaks; a record at which it did so often breaks it at any.
MOST_DEATHS = 3


class PlantProcess:
    """Runs a plant elsewhere; the process ends, and what it left on the disk is removed, with this value.

    Parameters
    ----------
    plant
        The plant; other processes get it by value.
    """

    def __init__(self, plant: Any) -> None:
        self._title, self._plant = plant.name, pack(plant)
        self._folder, self._pool = tempfile.mkdtemp(prefix="greybox-plant-"), LocalPool(1)
        self._deaths: Counter[str] = Counter()
        # Nothing that waits for another thread: a collector may come at any time. The pool ends its process when it is let go of.
        weakref.finalize(self, shutil.rmtree, self._folder, ignore_errors=True)

    @classmethod
    def of(cls, plant: Any) -> PlantProcess:
        """The one of this plant, for as long as the plant is known."""
        if plant not in _PROCESSES:
            _PROCESSES[plant] = cls(plant)
        return _PROCESSES[plant]

    def simulate(self, record: Experiment, values: Mapping[str, float]) -> dict[str, np.ndarray]:
        """As the plant's own. Raises PlantRunError where it ended its process, PlantLostError where it did so again and again."""
        return self._call("simulate", record, values)

    def differentiate(
        self, record: Experiment, values: Mapping[str, float], names: Sequence[str], outputs: Mapping[str, np.ndarray]
    ) -> np.ndarray | None:
        """As the plant's own, and as `simulate`."""
        return self._call("differentiate", record, values, names, outputs)

    def end(self) -> None:
        """End the process; the next run starts another."""
        self._pool.abandon()

    def _call(self, method: str, record: Experiment, *arguments: Any) -> Any:
        try:
            with quiet_children():
                call = pack_values((method, record, *arguments))
                future = self._pool.submit(_run_there, self._plant, self._folder, call)
            return unpack(future.result())
        except BrokenProcessPool as error:
            self._deaths[record.name] += 1
            what = f"{self._title}: its code ended its process in the run over {record.name!r}"
            if self._deaths[record.name] < MOST_DEATHS:
                raise PlantRunError(what) from error
            raise PlantLostError(
                f"{what}, {MOST_DEATHS} times; look at that record, leave it out, or ask the maker of the code"
            ) from error


_PROCESSES: weakref.WeakKeyDictionary[Any, PlantProcess] = weakref.WeakKeyDictionary()


def _end_all() -> None:
    for process in list(_PROCESSES.values()):
        process.end()


# A worker waits for its children before anything else that is done at its end.
Finalize(None, _end_all, exitpriority=0)


def _run_there(plant: bytes, folder: str, call: bytes) -> bytes:
    # What the code unpacks and leaves when it dies lies where its owner removes it.
    tempfile.tempdir = folder
    method, *arguments = unpack(call)
    return pack_values(getattr(unpack_shared(plant), method)(*arguments))
