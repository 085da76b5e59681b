"""Options of a fit about what happens from sample to sample: process noise, and the error so many samples ahead."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import typer

from greybox.cli import completion
from greybox.cli.options import Names, parse_numbers
from greybox.errors import GreyboxError

if TYPE_CHECKING:
    from greybox.experiment import Experiment
    from greybox.model import Model
    from greybox.result import Fit

# Unasked, the error one sample ahead is shown up to so many rows; telling what corrects the model takes longer with more.
UNASKED_ROWS = 50_000

ProcessNoise = Annotated[
    Names,
    typer.Option(
        "--process-noise",
        metavar="STATE[=VALUE]",
        default_factory=list,
        autocompletion=completion.states,
        help="A state that something random pushes: the fit is then one of predictions, by a Kalman filter, and estimates how"
        " strongly; VALUE is known, in the state's unit over sqrt(s).",
    ),
]
Predict = Annotated[
    list[int],
    typer.Option(
        "--predict",
        metavar="K",
        min=0,
        default_factory=list,
        help="Samples ahead of which the error is shown beside that of the free run; may be repeated, 0 for none.  [default: 1]",
    ),
]


def apply_process_noise(model: Model, texts: Sequence[str]) -> Model:
    """``model`` with process noise on the states of ``--process-noise``. Raises GreyboxError."""
    known = parse_numbers("--process-noise", (t for t in texts if "=" in t))
    estimated = dict.fromkeys(t.strip() for t in texts if "=" not in t)
    return model.with_process_noise(*estimated, **known) if texts else model


def check_prediction_steps(steps: Sequence[int], *groups: Sequence[Experiment]) -> None:
    """Refuse, before the fit, predictions so far ahead that the records hold nothing to compare with. Raises GreyboxError."""
    longest = min((max(e.rows for e in group) for group in groups if group), default=0)
    for k in steps:
        if k >= longest > 0:
            raise GreyboxError(
                f"--predict {k}: the longest record has {longest} rows, and the first {k} of each have no measurement to predict from;"
                " look fewer samples ahead"
            )


def prediction_table(result: Fit, judges: Sequence[Experiment], steps: Sequence[int], skip: int) -> list[str]:
    """Lines of a table for the fitted records, and one for those for validation: the free run beside predictions.

    No ``steps`` are one sample, where the records are not too long for an answer that was not asked for.
    """
    from greybox.residuals import score

    rows = sum(len(t.time) for t in result.traces) + sum(e.rows for e in judges)
    wanted = sorted({k for k in steps if k}) if steps else [1] if rows <= UNASKED_ROWS else []
    if not wanted or not result.success:
        return []
    lines = ["", "free run and prediction", *_indented(str(score(result, steps=wanted)))]
    if judges:
        table = score(result, judges, steps=wanted, skip=skip)
        lines += ["", "free run and prediction, validation records", *_indented(str(table))]
    return lines


def _indented(text: str) -> list[str]:
    return [f"  {line}" for line in text.splitlines()]
