"""How to repeat what a page shows: the command, the options, the versions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from greybox.base.extensions import read_versions
from greybox.estimation.options import FitOptions
from greybox.estimation.result import Fit
from greybox.estimation.result_parts import Trace
from greybox.model.model import Model
from greybox.show.figures.figure import scale_to_prefix
from greybox.show.pages.page import Block, CodeBlock, Details, PageTable, Section, Text, format_range
from greybox.show.sentences.wording import count_noun, join_names
from greybox.simulation.simulate import Simulation


def provenance_section(command: str, versions: Mapping[str, Any] | None = None) -> Section:
    """The command and the versions: those of now, or those that were noted."""
    table = name_value_table("Versions", read_versions() if versions is None else versions)
    return Section("repeat", "How to repeat it", [*_command(command), table])


def fit_provenance_section(fit: Fit, command: str) -> Section:
    """What is needed to get the numbers of a fit again."""
    return Section("repeat", "How to repeat it", list(_of_fit(fit, command)))


def _command(command: str) -> Iterator[Block]:
    if command:
        yield CodeBlock(command, "In the shell")


def _of_fit(fit: Fit, command: str) -> Iterator[Block]:
    yield from _command(command)
    error = join_names([f"{e:.2g} of the noise in {output}" for output, e in fit.discretisation.error.items() if e])
    iterations = count_noun(int(fit.solver.statistics.get("iterations", 0)), "iteration")
    rows = [
        ["discretisation", fit.discretisation.label],
        ["its error", error or "none"],
        ["search", "" if fit.solver.strategy is None else str(fit.solver.strategy)],
        ["ended", f"{fit.status.replace('_', ' ')} after {iterations}"],
    ]
    yield PageTable("How it was computed", ["what", "how"], [row for row in rows if row[1]])
    tables = [
        _options(fit),
        name_value_table("Versions", fit.provenance.versions),
    ]
    yield Details("Options and versions", tables)


def name_value_table(title: Text, values: Mapping[str, Any]) -> PageTable:
    """Names and values as a table; a name within a group is ``group.name``."""
    return PageTable(title, ["name", "value"], [[name, value] for name, value in _flat(values)])


def _options(fit: Fit) -> PageTable:
    """The options; of the policy only what differs from the default, which the note says."""
    usual = dict(_flat(FitOptions().to_data()))
    rows = [
        [name, value]
        for name, value in _flat(fit.provenance.options)
        if not (name.startswith("policy.") and usual.get(name) == value)
    ]
    return PageTable(
        "Options", ["name", "value"], rows, "Numbers of the policy that are not listed have their default values."
    )


def _flat(values: Mapping[str, Any], group: str = "") -> Iterator[tuple[str, str]]:
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{group}{name}.")
        else:
            yield f"{group}{name}", "" if value is None else str(value)


# The data of a page: which records, what they hold, and their fingerprints.

HEAD = ["record", "use", "rows", "duration", "sampling time", "missing values", "fingerprint"]


def records_section(fitted: Sequence[Trace], validation: Sequence[Trace], fit: Fit) -> Section:
    """Names, lengths, gaps and fingerprints of the records, and what their columns hold."""
    rows = [*(_record(t, "fitted") for t in fitted), *(_record(t, "validation") for t in validation)]
    note = f"Noise: {fit.noise.source}"
    records = PageTable("Records", HEAD, rows, note)
    return Section("data", "Data", [records, _signals([*fitted, *validation], fit)])


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
    """Unit of each output and input."""
    return {o.name: o.unit for o in model.outputs} | {i.name: i.unit for i in model.inputs}


def _signals(traces: Sequence[Trace], fit: Fit) -> PageTable:
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
    return PageTable("Signals over all records", ["signal", "use", "from … to", "noise (std)"], rows)
