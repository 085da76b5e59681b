"""A fitted model on records that were not used to fit it: constants kept, only the initial state estimated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from greybox.errors import DataError
from greybox.experiment import Experiment
from greybox.fitting.options import FitOptions
from greybox.fitting.problem import Problem, prepare
from greybox.fitting.solve import solve
from greybox.fitting.traces import misfits, traces
from greybox.model import Model
from greybox.result import Misfit, Trace

# Rows from which the initial state of a validation record is estimated, if `skip` does not say.
FIRST_ROWS = 50


@dataclass(frozen=True)
class Validation:
    """Free-run misfit by output, and the runs."""

    misfit: Mapping[str, Misfit]
    traces: Sequence[Trace]


def validate(
    model: Model,
    experiments: Experiment | Sequence[Experiment],
    *,
    noise: Mapping[str, float] | None = None,
    skip: int = 0,
    options: FitOptions | None = None,
) -> Validation:
    """Run ``model`` freely over each experiment and measure the error.

    The initial state is the declared one (``options.at_rest``), or estimated from the first rows: the ``skip`` rows that are left
    out of the errors, or the first 50. The constants are not touched.
    """
    options = options or FitOptions()
    frozen = model.fix(*model.values)
    problem = prepare(
        frozen, experiments, noise, at_rest=options.at_rest, method=options.method, substeps=options.substeps
    )  # fmt: skip
    shortest = min(len(r.u) for r in problem.records)
    if skip < 0 or skip >= shortest:
        raise DataError(f"skip: {skip} rows, but the shortest validation record has {shortest}; leave out fewer rows")
    variables = problem.variables
    if not options.at_rest:
        beginning = _beginning(problem, skip or FIRST_ROWS)
        variables = solve(beginning, replace(options, progressive=False)).variables
    found = traces(problem, variables)
    return Validation(misfits(problem, found, skip), found)


def _beginning(problem: Problem, rows: int) -> Problem:
    """The same problem on the first rows only, as many as there are unknown states at least."""
    least = max(rows, 2 * len(problem.model.system.state_names))
    return replace(problem, records=tuple(r.first(min(least, len(r.u))) for r in problem.records), experiments=())
