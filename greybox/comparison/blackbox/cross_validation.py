"""Cross-validation of free runs: parts of the records that a model was not fitted to judge it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from greybox.data.experiment import Experiment
from greybox.estimation.errors import OutputRun, OutputScore
from greybox.estimation.predictor import PredictingModel

# Rows of a record for validation that tell its first state, where nothing else is said.
FIRST_ROWS = 50


@dataclass(frozen=True, eq=False)
class Fold:
    """One division of the records.

    Attributes
    ----------
    estimation
        What a model is fitted to.
    judged
        The records with the readings that judge it.
    known
        The same records with the readings that tell their first state, from the first ``rows`` (None: all).
    skip
        First rows of each record that do not count.
    """

    estimation: tuple[Experiment, ...]
    judged: tuple[Experiment, ...]
    known: tuple[Experiment, ...]
    rows: int | None = None
    skip: int = 0

    @classmethod
    def of(cls, estimation: Sequence[Experiment], validation: Sequence[Experiment] = (), skip: int = 0) -> Fold:
        """One with records for validation; without them the estimation records judge, and all their rows tell the first state."""
        records = tuple(estimation)
        if not validation:
            return cls(records, records, records)
        others = tuple(validation)
        return cls(records, others, others, skip or FIRST_ROWS, skip)

    def score(self, model: PredictingModel, output: str) -> OutputScore:
        """Errors of the free runs, from rest for a model that was fitted from rest."""
        initial = "zero" if getattr(model, "history", "") == "zero" else "estimated"
        runs = []
        for judged, known in zip(self.judged, self.known, strict=True):
            run = model.simulate(known, initial=initial, rows=self.rows)[output]  # type: ignore[call-arg]
            runs.append(OutputRun(judged.name, output, judged.time, judged.outputs[output], run, self.skip))
        return OutputScore.of(runs)


# Ends of the parts of a single record that are held out in turn, as shares of its rows: its end first.
PARTS = ((0.7, 1.0), (0.0, 0.35), (0.35, 0.7))
# A part judges if an input moves there by this share of its range: one at rest would praise any model with the right gain.
MOVING_SHARE = 0.3
# Measured values that such a part must hold.
FEWEST_VALUES = 60
# Rows of all records that are looked at.
SCANNED_ROWS = 20000


def hold_out(experiments: Sequence[Experiment], outputs: Sequence[str], inputs: Sequence[str]) -> list[Fold]:
    """Of several records each third is held out in turn, the last first; of a single one each part, its readings left out.

    The inputs of a part stay, so that a run over the whole record reaches it with the state that it has there. Where no part can judge,
    such as behind a step that has settled, the records that a model is fitted to do.
    """
    records = _shorten(experiments)
    if len(records) > 1:
        thirds = [third.tolist() for third in np.array_split(np.arange(len(records)), min(3, len(records)))]
        return [
            Fold.of([r for k, r in enumerate(records) if k not in third], [records[k] for k in third])
            for third in (thirds[-1], *thirds[:-1])
        ]
    (record,) = records
    folds = []
    for begin, end in PARTS:
        held = np.zeros(record.rows, bool)
        held[round(begin * record.rows) : round(end * record.rows)] = True
        # The first reading stays: it says where a record rests.
        held[0] = False
        moving = any(
            np.ptp(u[held]) > MOVING_SHARE * np.ptp(u) for u in (record.inputs[n] for n in inputs) if held.any()
        )
        if moving and all(_count(record, n, rows) >= FEWEST_VALUES for n in outputs for rows in (held, ~held)):
            kept = _with_readings(record, ~held)
            folds.append(Fold((kept,), (_with_readings(record, held),), (kept,)))
    return folds or [Fold.of(records)]


def _count(record: Experiment, output: str, rows: np.ndarray) -> int:
    return int(np.isfinite(record.outputs[output][rows]).sum())


def _with_readings(record: Experiment, rows: np.ndarray) -> Experiment:
    """The record with its readings in these ``rows`` (N,) alone."""
    return record.with_outputs({name: np.where(rows, y, np.nan) for name, y in record.outputs.items()})


def _shorten(experiments: Sequence[Experiment]) -> tuple[Experiment, ...]:
    """The first rows of each record, `SCANNED_ROWS` in all."""
    share = min(1.0, SCANNED_ROWS / sum(e.rows for e in experiments))
    return tuple(e if share == 1 else e.window(0, max(2, int(share * e.rows))) for e in experiments)
