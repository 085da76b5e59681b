"""From a problem to its optimum, by the transcription that was asked for or that suits the model."""

from __future__ import annotations

from dataclasses import replace

from greybox.fitting.arcs import solve_arcs
from greybox.fitting.choose import choose
from greybox.fitting.collocated import solve_collocation
from greybox.fitting.lifted import solve_multiple
from greybox.fitting.options import FitOptions, Report
from greybox.fitting.problem import Problem
from greybox.fitting.single import solve_single
from greybox.fitting.solution import Solution

__all__ = ["Solution", "solve"]

JOINED = {
    "multiple": solve_multiple, "collocation-radau": solve_collocation, "collocation-legendre": solve_collocation,
    "arcs": solve_arcs,
}  # fmt: skip


def solve(problem: Problem, options: FitOptions, report: Report | None = None) -> Solution:
    """Minimise the noise-weighted simulation error of ``problem``; `Solution.strategy` says how, and why so.

    Raises ModelError for a transcription that the model does not allow.
    """
    choice = choose(problem, options)
    if choice.transcription in JOINED:
        return JOINED[choice.transcription](choice, options, report)
    found = solve_single(choice.problem, options, report)
    return replace(found, strategy=choice.told(found.strategy))
