"""What stands at the end of a page: its records, and how to repeat it with the same command, options and versions."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from greybox.base.document import Block, CodeBlock, Details, Facts, Section, TableBlock
from greybox.base.extensions import read_versions
from greybox.estimation.options import FitOptions
from greybox.estimation.result import Fit
from greybox.estimation.result_parts import Trace
from greybox.model.model import Model
from greybox.show.documents.tables import flatten, named_values
from greybox.show.figures.figure import scale_to_prefix
from greybox.show.sentences.wording import count_noun, join_names
from greybox.simulation.simulate import Simulation


def provenance_section(command: str, versions: Mapping[str, Any] | None = None) -> Section:
    """The command and the versions: those of now, or those that were noted."""
    table = named_values("Versions", read_versions() if versions is None else versions)
    return Section("repeat", "How to repeat it", [*_command(command), table])


def fit_provenance_section(fit: Fit, command: str) -> Section:
    """What is needed to get the numbers of a fit again."""
    iterations = count_noun(int(fit.solver.statistics.get("iterations", 0)), "iteration")
    ended = f"{fit.status.replace('_', ' ')} after {iterations}"
    computed = Facts([*computation_facts(fit), ("ended", ended)], "How it was computed")
    tables: list[Block] = [_options(fit), named_values("Versions", fit.provenance.versions)]
    return Section(
        "repeat", "How to repeat it", [*_command(command), computed, Details("Options and versions", tables)]
    )


def _command(command: str) -> list[Block]:
    return [CodeBlock(command, "In the shell")] if command else []


def computation_facts(fit: Fit) -> list[tuple[str, str]]:
    """How a fit was integrated and searched for; nothing of the integrator's error where the discretisation is exact."""
    error = max((e for e in fit.discretisation.error.values() if math.isfinite(e)), default=0.0)
    shift = max((s for s in fit.discretisation.shift.values() if math.isfinite(s)), default=0.0)
    left = f"; error {error:.2g} x noise, half the step changes no parameter by more than {shift:.2g} std"
    search = [] if fit.solver.strategy is None else [("search", str(fit.solver.strategy))]
    return [("discretisation", fit.discretisation.label + (left if error or shift else "")), *search]


def _options(fit: Fit) -> TableBlock:
    """The options; of the policy only what differs from the default, which the note says."""
    usual = flatten(FitOptions().to_data())
    rows = [
        [name, value]
        for name, value in flatten(fit.provenance.options).items()
        if not (name.startswith("policy.") and usual.get(name) == value)
    ]
    note = "Numbers of the policy that are not listed have their default values."
    return TableBlock("Options", ["name", "value"], rows, note)


# The data of a page: which records, what they hold, and their fingerprints.


def records_section(fit: Fit) -> Section:
    """Names, lengths, gaps and fingerprints of the records, and what their columns hold."""
    fitted, validation = [*fit.traces], [*fit.validation.traces]
    rows = [*(_record(t, "fitted") for t in fitted), *(_record(t, "validation") for t in validation)]
    note = f"Noise: {fit.noise}"
    head = ["record", "use", "rows", "duration", "sampling time", "missing values", "fingerprint"]
    records = TableBlock("Records", head, rows, note)
    return Section("data", "Data", [records, _signals(fitted + validation, fit)])


def hidden_states(run: Simulation) -> dict[str, np.ndarray]:
    """The states of a run that no output of the same name shows already."""
    return {
        name: values
        for name, values in run.states.items()
        if name not in run.outputs or not np.array_equal(run.outputs[name], values)
    }


def _record(trace: Trace, use: str) -> list[str]:
    missing = {name: int(np.isnan(v).sum()) for name, v in trace.measured.items()}
    gaps = join_names([f"{count} of {name}" for name, count in missing.items() if count])
    return [
        trace.name,
        use,
        str(len(trace.time)),
        f"{trace.time[-1] - trace.time[0]:.6g} s",
        format_sampling_time(trace.time),
        gaps or "none",
        trace.fingerprint[:12],
    ]


def format_sampling_time(time: np.ndarray) -> str:
    """The sampling time, or its range where it varies."""
    steps = np.diff(time)
    if not len(steps):
        return ""
    even = float(np.ptp(steps)) < 1e-6 * float(steps.mean())
    return f"{float(steps.mean()):.6g} s" if even else f"{float(steps.min()):.4g} to {float(steps.max()):.4g} s"


def signal_units(model: Model) -> dict[str, str]:
    """Unit of each output, input and state."""
    units = {s.name: s.unit for s in model.all_states} | {i.name: i.unit for i in model.inputs}
    return units | {o.name: o.unit for o in model.outputs}


def format_range(values: np.ndarray) -> str:
    """``-3.1 to 2.7``, of the finite ``values`` (N,)."""
    known = values[np.isfinite(values)]
    return f"{known.min():.4g} to {known.max():.4g}" if len(known) else "nothing"


def _signals(traces: list[Trace], fit: Fit) -> TableBlock:
    rows = []
    for use, signals in (("input", fit.model.inputs), ("measured", fit.model.outputs)):
        for signal in signals:
            groups = [t.inputs if use == "input" else t.measured for t in traces]
            values = [np.asarray(g[signal.name]) for g in groups if signal.name in g]
            std = fit.noise.std.get(signal.name) if use == "measured" else None
            every = np.concatenate(values) if values else np.array([])
            factor, unit = scale_to_prefix(signal.unit, every)
            noise = f"{factor * std:.3g} {unit}" if std is not None and np.isfinite(std) else ""
            limits = f"{format_range(factor * every)} {unit}" if values else "not recorded"
            rows.append([signal.name, use, limits, noise])
    return TableBlock("Signals over all records", ["signal", "use", "from … to", "noise (std)"], rows)
