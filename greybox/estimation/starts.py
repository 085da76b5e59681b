"""Starts of a search: how they are drawn, which of them end at the same optimum, and a file that keeps those that are finished."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from greybox.base.errors import ModelError
from greybox.base.findings import Finding, Severity
from greybox.base.journal import add_entry, read_journal
from greybox.base.parallel.jobs import JobResult
from greybox.data.experiment import Experiment
from greybox.data.noise.noise_model import NoiseModel
from greybox.estimation.findings import EstimationCode
from greybox.estimation.options import FitOptions
from greybox.estimation.result_parts import StartResult
from greybox.estimation.versions import read_versions
from greybox.model.model import Model
from greybox.model.signals import Parameter

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


def draw_starts(model: Model, starts: int, seed: int = 0, factor: float = 3.0) -> list[dict[str, float]]:
    """Start values about the model's own: each free constant log-uniform between value / factor and value x factor, within its bounds.

    A constant at zero has no size to vary: it is uniform within its bounds, and stays where they are open. Raises ModelError
    for a factor of one or less.
    """
    if not factor > 1:
        raise ModelError(f"factor {factor:g} of the random starts: it must be greater than one; 3 is usual")
    rng = np.random.default_rng(seed)
    return [{q.name: _draw(q, factor, rng.uniform()) for q in model.free_parameters} for _ in range(max(starts, 0))]


def _draw(q: Parameter, factor: float, share: float) -> float:
    low, high = q.bounds
    if q.value == 0:
        return float(low + share * (high - low)) if np.isfinite(low) and np.isfinite(high) else 0.0
    smaller, larger = sorted((q.value / factor, q.value * factor))
    a, b = max(smaller, low), min(larger, high)
    size = np.sign(q.value)
    return float(np.clip(size * np.exp(np.log(size * a) + share * np.log(b / a)), low, high))


def group_by_optimum(start_results: Sequence[StartResult]) -> list[list[StartResult]]:
    """Results at the same optimum, best first; starts without a result are left out."""
    groups: list[list[StartResult]] = []
    for result in sorted((r for r in start_results if r.values), key=lambda r: r.noise_ratio):
        if groups and _is_same_optimum(groups[-1][0].noise_ratio, result.noise_ratio):
            groups[-1].append(result)
        else:
            groups.append([result])
    return groups


def summarise_starts(start_results: Sequence[StartResult]) -> Finding:
    """How many starts ended at each optimum, the best first, and how many have no result."""
    groups = group_by_optimum(start_results)
    values = {
        "counts": [len(group) for group in groups],
        "ratios": [group[0].noise_ratio for group in groups],
        "without_result": sum(not result.values for result in start_results),
    }
    return Finding(EstimationCode.STARTS, Severity.NOTE, "", values)


# Difference of two costs over the smaller one.
MULTISTART_SAME_COST = 0.01
# Or difference of two misfits over noise.
SAME_NOISE_RATIO = 0.001


def _is_same_optimum(a: float, b: float) -> bool:
    return b**2 <= (1 + MULTISTART_SAME_COST) * a**2 or b - a <= SAME_NOISE_RATIO
