"""A simulation: what the model did, and what it was driven by."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from greybox.base import ModelError, format_unit
from greybox.base.document import Document, FigureBlock, Later, Section, TableBlock, Tone
from greybox.base.figure import Role
from greybox.model import Model
from greybox.show.documents import tables
from greybox.show.figures.figure import scale_to_prefix, stretches_on_page
from greybox.show.figures.records import plot_signals
from greybox.show.sentences.wording import count_noun, format_number, join_names
from greybox.simulation.simulate import Simulation

if TYPE_CHECKING:
    from greybox.shell.answers import SimulationAnswer


def describe_simulation(run: Simulation, *, model: Model | None = None, command: str = "", noise: str = "") -> Document:
    """What is said of a simulation.

    Parameters
    ----------
    run
        The result of `greybox.simulate`.
    model
        What ran.
    command
        What was typed, for repeating it.
    noise
        The standard deviations of the noise that was added to the outputs that were written.

    Raises
    ------
    ModelError
        Without the model.
    """
    if model is None:
        raise ModelError("report of a simulation: no model; give model=")
    if run.overflow is not None:
        answer, tone = f"The run overflows {run.overflow:.4g} s after its start and ends there.", Tone.BAD
    else:
        duration, rows = run.time[-1] - run.time[0], count_noun(len(run.time), "row")
        period = tables.format_sampling_time(run.time)
        answer = f"{model.title} was simulated: {rows} over {duration:.4g} s, one every {period}."
        tone = Tone.GOOD
    noises = [f"the written outputs contain added white noise: {noise}"] if noise else []
    return Document(
        f"Simulation of {model.title}",
        answer,
        tone,
        [ranges_table(run, model)],
        [*noises, f"integrated by {run.discretisation}"],
        question=f"How does {model.title} respond to {join_names(list(run.inputs)) or 'no input'}?",
        sections=Later(_sections, run, model, command),
        kind="simulation",
    )


def _sections(run: Simulation, model: Model, command: str) -> Iterator[Section]:
    yield Section("run", "The run", [*run_figures(run, model), ranges_table(run, model)])
    yield Section("model", "The model", [_parameters(model), tables.typeset_equations(model)])
    yield tables.provenance_section(command)


def run_figures(
    run: Simulation, model: Model, order: Sequence[str] = ("outputs", "inputs", "states")
) -> Iterator[FigureBlock]:
    """What a model did: outputs, inputs, and the states that no output shows, in this ``order``."""
    units = tables.signal_units(model)
    groups = {
        "outputs": (run.outputs, "Simulated outputs, without sensor noise.", Role.OUTPUT),
        "inputs": (run.inputs, "Inputs.", Role.INPUT),
        "states": (tables.hidden_states(run), "States.", Role.STATE),
    }
    stretches = stretches_on_page(sum(len(signals) for signals, _, _ in groups.values()))
    for name in order:
        signals, caption, role = groups[name]
        if signals:
            held = [n for n, course in run.source.courses.items() if course == "zero"] if role is Role.INPUT else ()
            figure = plot_signals(name, run.time, signals, units, role, caption, held=held)
            yield FigureBlock(figure, stretches, group="run")


def ranges_table(run: Simulation, model: Model) -> TableBlock:
    """From where to where each signal moves."""
    units, rows = tables.signal_units(model), []
    for kind, group in (("input", run.inputs), ("output", run.outputs), ("state", run.states)):
        for name, values in group.items():
            factor, unit = scale_to_prefix(units[name], np.asarray(values))
            rows.append([name, kind, f"{tables.format_range(np.asarray(values), factor=factor)} {unit}"])
    return TableBlock("Ranges of the signals", ["signal", "kind", "from … to"], rows)


def _parameters(model: Model) -> TableBlock:
    rows = [[q.name, format_number(q.value, 7), format_unit(q.unit)] for q in model.all_parameters]
    return TableBlock("Parameters of this run", ["parameter", "value", "unit"], rows)


def describe_simulation_answer(answer: SimulationAnswer) -> Document:
    """The same as of the run."""
    return describe_simulation(answer.run, model=answer.model, noise=answer.noise)
