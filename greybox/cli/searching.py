"""Options about how a fit is searched for: the transcription, arcs, many starts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated

import typer

from greybox.cli.progress import show_progress
from greybox.errors import GreyboxError

if TYPE_CHECKING:
    from greybox.estimation import FitOptions, MultiStartResult
    from greybox.experiment import Experiment
    from greybox.model import Model


class TranscriptionName(StrEnum):
    """How a record becomes a cost."""

    automatic = "automatic"
    single = "single"
    multiple = "multiple"
    collocation_radau = "collocation-radau"
    collocation_legendre = "collocation-legendre"
    arcs = "arcs"


Transcription = Annotated[
    TranscriptionName,
    typer.Option(
        "--transcription",
        help="single: one free run a record. multiple: segments that meet (unstable plants). collocation: the equations solved at"
        " points, states within their bounds. arcs: pieces of --arc-length that need not meet. automatic picks by the model.",
    ),
]
ArcLength = Annotated[
    float,
    typer.Option(
        "--arc-length",
        metavar="SECONDS",
        help="Fit arcs of this length, each from a state of its own: short ones show structure, long ones drift.",
        show_default=False,
    ),
]
Starts = Annotated[
    int,
    typer.Option(
        "--starts",
        metavar="N",
        min=1,
        help="Fit from N starts, the model's own and random ones, on all cores; says where each ended.",
    ),
]
Seed = Annotated[
    int | None,
    typer.Option("--seed", metavar="N", min=0, help="Of the random --starts; 0 if left out.", show_default=False),
]


def check_seed(starts: int, seed: int | None) -> int:
    """The seed of the random starts. Raises GreyboxError where there are none."""
    if seed is not None and starts == 1:
        raise GreyboxError(f"--seed {seed} has no effect: there are no random starts; give --starts N too")
    return seed or 0


def fit_from_many_starts(
    model: Model, records: Sequence[Experiment], starts: int, seed: int, *, noise: Mapping[str, float],
    quiet: Sequence[Experiment], validation: Sequence[Experiment], skip: int, options: FitOptions,
) -> MultiStartResult:  # fmt: skip
    """A fit from many starts, with a line on a terminal that says how many are done."""
    from greybox.estimation import multistart

    with show_progress() as show:
        return multistart(
            model, records, starts=starts, seed=seed, noise=noise, quiet=quiet, validation=validation, skip=skip,
            options=options, report=lambda done, jobs: show(f"{model.title}: {done} of {jobs} starts done", done / jobs),
        )  # fmt: skip
