"""The best black box of each kind that a record bears: its own scan, judged on a part of the record that it was not fitted to."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import product

import numpy as np

from greybox.blackbox.sampled_data import SampledData, to_sampled_data
from greybox.blackbox.structure_fit import BlackBoxKind, OrderChoice, fit_structure
from greybox.blackbox.structure_scan import ScannedStructure, StructureScan, scan_choices
from greybox.errors import DataError
from greybox.experiment import Experiment

ALL_KINDS: tuple[BlackBoxKind, ...] = ("arx", "armax", "output error", "box-jenkins", "hammerstein")
MOST_POLES, MOST_SEARCHED_POLES = 6, 4  # of linear least squares, and where each structure needs a search
# Kinds whose scan takes delay, offset or poles from that of others
BEGIN_FROM: Mapping[BlackBoxKind, tuple[BlackBoxKind, ...]] = {
    "armax": ("arx",), "output error": ("arx",), "box-jenkins": ("arx", "output error"),
    "hammerstein": ("arx", "output error"),
}  # fmt: skip
FIRST_DELAYS, MOST_DELAY, ROWS_FOR_EACH_DELAY = (0, 1, 2), 40, 20
# Rows of all records that a scan looks at; the chosen structure is fitted to all.
MOST_SCANNED = 20_000
HELD_OUT = 0.3  # of a single record, its end, that judges
# The end of a record can judge if an input still moves there by this share of what it moves before.
LIVELY = 0.3
FEWEST_JUDGING = 60  # measured values of such an end
BENDS = {"polynomial": (2, 3, 5), "piecewise": (3, 5)}

KindProgress = Callable[[str, int, int], None]


def best_black_boxes(
    experiments: Experiment | Sequence[Experiment],
    *,
    output: str | None = None,
    inputs: Sequence[str] | str | None = None,
    kinds: Sequence[BlackBoxKind] = ALL_KINDS,
    at_rest: bool = False,
    units: Mapping[str, str] | None = None,
    report: KindProgress | None = None,
) -> dict[BlackBoxKind, StructureScan]:
    """The best model of each of ``kinds`` for one output, each chosen by a scan of its own and then fitted to all the records.

    Of several records the last third judges by its free-run error; of a single one its last 30 %, if an input still moves there;
    else (a step that has settled) the free run over the record itself. ``at_rest``: everything was zero before each record.
    ARX models are scanned with and without offset, with prediction and with simulation focus, over up to six poles and the delays
    around the best; the others start from the delay and offset found there. ``report(kind, done, of)`` is called on the way.

    A kind that these records cannot carry (a curve for an input of two levels) is left out. Raises DataError where none can be
    fitted, with the reason.
    """
    whole = to_sampled_data(experiments, output, inputs)
    scanning, judging, skip = _grounds(whole)
    data = to_sampled_data(scanning, whole.output, whole.inputs)
    scans: dict[BlackBoxKind, StructureScan] = {}
    reason = "no kinds asked for"
    for kind in ALL_KINDS:
        if kind not in kinds and not any(kind in BEGIN_FROM.get(wanted, ()) for wanted in kinds):
            continue

        def tell(done: int, of: int, candidate: ScannedStructure, kind: BlackBoxKind = kind) -> None:
            if report is not None:
                report(kind, done, of)

        choices = list(_choices(kind, data, scans, at_rest))
        if not choices:
            continue
        try:
            scans[kind] = scan_choices(
                data, kind, choices, at_rest=at_rest, judge=judging, skip=skip, units=units, report=tell, final=whole
            )
        except DataError as error:
            reason = str(error)
    if not any(k in scans for k in kinds):
        raise DataError(f"output {whole.output!r}: no black-box model of these records: {reason}")
    return {k: scans[k] for k in kinds if k in scans}


def _grounds(data: SampledData) -> tuple[tuple[Experiment, ...], tuple[Experiment, ...], int]:
    """Records to scan on, records to judge by, and how many of their first rows do not count; none to judge by where only the
    scanned ones themselves can."""
    records = data.experiments
    if len(records) > 1:
        count = max(1, len(records) // 3)
        return _shortened(records[:-count]), _shortened(records[-count:]), 0
    (record,) = _shortened(records)
    cut = round((1 - HELD_OUT) * record.rows)
    measured = min(int(np.isfinite(part).sum()) for part in np.split(record.outputs[data.output], [cut]))
    moving = any(np.ptp(u[cut:]) > LIVELY * np.ptp(u[:cut]) for u in (record.inputs[name] for name in data.inputs))
    if measured < FEWEST_JUDGING or not moving:
        return (record,), (), 0
    # The whole record is run, so that its end begins with the state that the run has there.
    return (record.window(0, cut),), (record,), cut


def _shortened(experiments: Sequence[Experiment]) -> tuple[Experiment, ...]:
    """The first rows of each record, `MOST_SCANNED` in all."""
    share = min(1.0, MOST_SCANNED / sum(e.rows for e in experiments))
    return tuple(e if share == 1 else e.window(0, max(2, int(share * e.rows))) for e in experiments)


def _choices(
    kind: BlackBoxKind, data: SampledData, scans: Mapping[BlackBoxKind, StructureScan], at_rest: bool
) -> Iterator[OrderChoice]:
    """What to scan of this kind, given the scans of the kinds before."""
    if kind == "arx":
        delay = _delay(data, at_rest)
        delays = sorted({*FIRST_DELAYS, max(delay - 1, 0), delay, delay + 1})
        for na, nk, offset in product(range(1, MOST_POLES + 1), delays, (False, True)):
            for nb, focus in product(sorted({1, 2, na, na + 1}), ("prediction", "simulation")):
                yield {"na": na, "nb": nb, "nk": nk, "offset": offset, "focus": focus}
        return
    before = scans["arx"].chosen.choice if "arx" in scans else {"nk": 1, "offset": True}
    nk, offsets = before["nk"], sorted({True, before["offset"]})
    poles = range(1, MOST_SEARCHED_POLES + 1)
    if kind == "armax":
        for n, delay, shifted in product(poles, sorted({nk, 1}), offsets):
            for nb, nc in product(sorted({1, n, n + 1}), sorted({1, n})):
                yield {"na": n, "nb": nb, "nc": nc, "nk": delay, "offset": shifted}
    elif kind == "output error":
        for n, delay, shifted in product(poles, sorted({nk, max(nk - 1, 0), 1}), offsets):
            for nb in sorted({1, n, n + 1}):
                yield {"nb": nb, "nf": n, "nk": delay, "offset": shifted}
    elif "output error" in scans:
        plain = scans["output error"].chosen.choice
        if kind == "box-jenkins":
            yield from ({**plain, "nc": nc, "nd": nd} for nc, nd in ((0, 1), (1, 1), (2, 2)))
            return
        levels = min(len(np.unique(np.concatenate([s.u[:, i] for s in data.series]))) for i in range(len(data.inputs)))
        for shape, freedoms in BENDS.items():
            for freedom in (f for f in freedoms if f < levels):
                for poles_of_curve in sorted({plain["nf"], min(plain["nf"] + 1, MOST_SEARCHED_POLES)}):
                    nb = max(plain["nb"], poles_of_curve)
                    yield {**plain, "nb": nb, "nf": poles_of_curve, "shape": shape, "freedom": freedom}


def _delay(data: SampledData, at_rest: bool) -> int:
    """Samples of delay with which two poles and two zeros predict the records best."""
    shortest = min(s.rows for s in data.series)
    best, found = np.inf, 1
    for nk in range(min(MOST_DELAY, shortest // ROWS_FOR_EACH_DELAY) + 1):
        choice = {"na": 2, "nb": 2, "nk": nk, "offset": not at_rest, "focus": "prediction"}
        try:
            model = fit_structure(data, "arx", choice, at_rest=at_rest)
        except DataError:
            continue  # such as two columns of a step; the scan itself says so
        loss = model.loss  # type: ignore[union-attr]  # an ARX model is a polynomial one
        if loss < best:
            best, found = loss, nk
    return found
