"""Finished starts of a multi-start, kept in a file so that an interrupted run goes on."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import casadi as ca

from greybox.estimation.options import FitOptions
from greybox.estimation.versions import read_versions
from greybox.experiment import Experiment
from greybox.journal import add_entry, read_journal
from greybox.model import Model
from greybox.noise import NoiseModel
from greybox.parallel import JobResult

StartEnd = tuple[dict[str, float], float, str]
"""Where a start ended: values, misfit over noise, status."""


@dataclass
class StartJournal:
    """Where starts ended, one JSON object a line, by a hash of model, records, noise, options, versions and start.

    Raises
    ------
    DataError
        If the file is no journal.
    """

    path: Path
    known: dict[str, JobResult] = field(init=False)

    def __post_init__(self) -> None:
        self.known = dict(read_journal(self.path, _parse).entries)

    def add(self, key: str, result: JobResult) -> None:
        """Keep one more, on the disk when this returns. Raises OutputError."""
        values, ratio, status = result.value
        number = ratio if abs(ratio) < float("inf") else None
        add_entry(
            self.path, {"key": key, "values": values, "ratio": number, "status": status, "seconds": result.seconds}
        )


def hash_start(
    model: Model,
    experiments: Sequence[Experiment],
    noise: NoiseModel,
    options: FitOptions,
    begin: Mapping[str, float],
) -> str:
    """The hash by which a start is known: equal if everything that decides its end is."""
    system = model.system
    identity = [
        str(ca.vertcat(*map(ca.vec, system.free_run_expressions))),
        [(q.name, q.value, q.bounds, q.fixed, q.prior) for q in model.all_parameters],
        [(tie.name, tie.formula) for tie in model.ties],
        [(s.name, s.bounds) for s in model.all_states],
        [e.hold for e in model.effects],
        [(e.fingerprint, e.hold, sorted(e.conditions.items())) for e in experiments],
        noise.std.tolist(),
        [c.reflection for c in noise.colour],
        repr(options),
        sorted(begin.items()),
        sorted(read_versions().items()),
    ]
    return hashlib.sha256(repr(identity).encode(errors="backslashreplace")).hexdigest()[:32]


def _parse(data: Mapping[str, Any]) -> tuple[str, JobResult]:
    values = {str(name): float(value) for name, value in data["values"].items()}
    ratio = float("inf") if data["ratio"] is None else float(data["ratio"])
    return str(data["key"]), JobResult((values, ratio, str(data["status"])), "", float(data["seconds"]))
