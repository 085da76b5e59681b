"""The best black box of each kind for a record: a scan of its own, validated on a part of the record that it was not fitted to."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import product

import numpy as np

from greybox.base.errors import DataError
from greybox.comparison.blackbox.hammerstein import find_levels
from greybox.comparison.blackbox.linear_regression import Origin, SampledData, to_sampled_data
from greybox.comparison.blackbox.structure_scan import (
    DEFAULT_SCAN,
    BlackBoxKind,
    Fold,
    OrderChoice,
    ScannedStructure,
    StructureScan,
    StructureScanPolicy,
    fit_structure,
    scan_choices,
)
from greybox.data.experiment import Experiment

ALL_KINDS: tuple[BlackBoxKind, ...] = tuple(BlackBoxKind)
# Kinds whose scan takes delay, offset or poles from that of others.
STARTS_FROM: Mapping[BlackBoxKind, tuple[BlackBoxKind, ...]] = {
    BlackBoxKind.ARMAX: (BlackBoxKind.ARX,),
    BlackBoxKind.OUTPUT_ERROR: (BlackBoxKind.ARX,),
    BlackBoxKind.BOX_JENKINS: (BlackBoxKind.ARX, BlackBoxKind.OUTPUT_ERROR),
    BlackBoxKind.HAMMERSTEIN: (BlackBoxKind.ARX, BlackBoxKind.OUTPUT_ERROR),
}

KindProgress = Callable[[str, int, int], None]


def best_black_boxes(
    experiments: Experiment | Sequence[Experiment],
    *,
    output: str | None = None,
    inputs: Sequence[str] | str | None = None,
    kinds: Sequence[str] = ALL_KINDS,
    at_rest: bool = False,
    units: Mapping[str, str] | None = None,
    report: KindProgress | None = None,
    policy: StructureScanPolicy = DEFAULT_SCAN,
) -> dict[BlackBoxKind, StructureScan]:
    """Find the best model of each kind for one output, each by a scan of its own, and fit it to all the records.

    Orders are chosen by cross-validation of the free-run error: of several records the last third validates, then the first; of a
    single one its last 30 %, then its first, if an input moves there; else (a step that has settled) the free run over the record
    itself. ARX models are scanned with prediction and with simulation focus, over up to six poles and the delays around the best; the
    others start from the delay found there. Signals are measured from their means, or from where they rest before a record. An input
    that never moves is left out.

    Parameters
    ----------
    experiments
        One or more records of the same sampling time.
    output
        Name of the output; needed where the records have several.
    inputs
        Names of the inputs; None takes all.
    kinds
        Which of ``arx``, ``armax``, ``output error``, ``box-jenkins``, ``hammerstein``.
    at_rest
        The plant rests before each record: its output at the first reading, each input at what it was before (`Experiment.before`; zero
        where the record does not say). Models that begin so compete with those whose first state is estimated.
    units
        Name of a signal -> unit.
    report
        Called as ``report(kind, done, total)`` on the way.
    policy
        Which structures are tried, and what counts as equally good.

    Returns
    -------
    dict
        Kind -> scan. A kind that these records cannot support (a nonlinearity for an input of two levels) is left out.

    Raises
    ------
    DataError
        Where none can be fitted, with the reason.

    Examples
    --------
    >>> scans = gb.blackbox.best_black_boxes(record, kinds=("arx", "output error"))  # doctest: +SKIP
    >>> print(scans["arx"])  # doctest: +SKIP
    """
    whole = to_sampled_data(experiments, output, inputs)
    moving = find_moving_inputs(whole, at_rest)
    whole = to_sampled_data(whole.experiments, whole.output, moving)
    folds = [
        Fold(to_sampled_data(estimation, whole.output, whole.inputs), validation, skip)
        for estimation, validation, skip in hold_out(whole.experiments, (whole.output,), whole.inputs)
    ]
    data = folds[0].data
    scans: dict[BlackBoxKind, StructureScan] = {}
    reason = "no kinds asked for"
    for kind in ALL_KINDS:
        # A kind that nobody asked for is scanned where another one starts from it.
        if kind not in kinds and not any(kind in STARTS_FROM.get(BlackBoxKind(wanted), ()) for wanted in kinds):
            continue

        def report_scan(done: int, total: int, structure: ScannedStructure, kind: BlackBoxKind = kind) -> None:
            if report is not None:
                report(kind, done, total)

        choices = list(_choices(kind, data, scans, at_rest, policy))
        if not choices:
            continue
        try:
            scans[kind] = scan_choices(
                folds,
                kind,
                choices,
                units=units,
                report=report_scan,
                final=whole,
                policy=policy,
            )
        except DataError as error:
            reason = str(error)
    if not any(k in scans for k in kinds):
        raise DataError(f"output {whole.output!r}: no black-box model of these records: {reason}")
    return {BlackBoxKind(k): scans[BlackBoxKind(k)] for k in kinds if k in scans}


# Share of a single record, its end and then its beginning, that is held out for validation.
HOLDOUT_SHARE = 0.3
# A part of a record validates if an input moves there by this share of its range.
HOLDOUT_EXCITATION = 0.3
# Measured values that such a part must hold.
HOLDOUT_VALUES = 60


def find_moving_inputs(data: SampledData, at_rest: bool) -> list[str]:
    """The inputs that move within the records; where none does, those that stepped as the records began from rest.

    Raises DataError where there is none either.
    """
    origins: tuple[Origin, ...] = ("mean", "rest") if at_rest else ("mean",)
    for origin in origins:
        records = data.scaled(origin).records
        moving = [name for i, name in enumerate(data.inputs) if any(np.any(r.signals[i][:]) for r in records)]
        if moving:
            return moving
    raise DataError(
        f"output {data.output!r}: no input ever moves ({', '.join(data.inputs)}); a black box needs one that does"
    )


def hold_out(
    experiments: Sequence[Experiment], outputs: Sequence[str], inputs: Sequence[str]
) -> list[tuple[tuple[Experiment, ...], tuple[Experiment, ...], int]]:
    """Folds of a cross-validation: estimation records, validation records, and how many first rows of these do not count.

    The end of the records is held out, then their beginning. Without validation records where only the estimation records themselves
    can serve.
    """
    if len(experiments) > 1:
        shortened, count = _shorten(experiments), max(1, len(experiments) // 3)
        return [(shortened[:-count], shortened[-count:], 0), (shortened[count:], shortened[:count], 0)]
    (record,) = _shorten(experiments)
    if record.rows < 2 * HOLDOUT_VALUES:
        return [((record,), (), 0)]
    cut = round((1 - HOLDOUT_SHARE) * record.rows)
    # Of the end the whole record is run, so that it begins with the state that the run has there.
    folds = [
        ((record.window(0, cut),), (record,), cut),
        ((record.window(record.rows - cut, record.rows),), (record.window(0, record.rows - cut),), 0),
    ]
    spans = {name: np.ptp(record.inputs[name]) for name in inputs}

    def shows(part: Experiment) -> bool:
        """Whether a part of the record can judge: an end at rest would praise any model with the right gain."""
        values = min(int(np.isfinite(part.outputs[name]).sum()) for name in outputs)
        moving = any(np.ptp(part.inputs[name]) > HOLDOUT_EXCITATION * span for name, span in spans.items())
        return values >= HOLDOUT_VALUES and moving

    kept = [(e, v, skip) for e, v, skip in folds if shows(v[0].window(skip, v[0].rows)) and shows(e[0])]
    return kept or [((record,), (), 0)]


# Rows of all records that a scan uses; the chosen structure is fitted to all.
SCANNED_ROWS = 20000


def _shorten(experiments: Sequence[Experiment]) -> tuple[Experiment, ...]:
    """The first rows of each record, `SCANNED_ROWS` in all."""
    share = min(1.0, SCANNED_ROWS / sum(e.rows for e in experiments))
    return tuple(e if share == 1 else e.window(0, max(2, int(share * e.rows))) for e in experiments)


def _choices(
    kind: BlackBoxKind,
    data: SampledData,
    scans: Mapping[BlackBoxKind, StructureScan],
    at_rest: bool,
    policy: StructureScanPolicy,
) -> Iterator[OrderChoice]:
    """What to scan of this kind, given the scans of the kinds before."""
    # From rest a further constant would be a drift.
    beginnings = [{"at_rest": False, "offset": True}, *([{"at_rest": True, "offset": False}] if at_rest else [])]
    if kind == BlackBoxKind.ARX:
        # ARX is a linear problem: delays are cheap to try here, and the other kinds take them over.
        delay = _find_delay(data, at_rest)
        delays = sorted({*policy.first_delays, max(delay - 1, 0), delay, delay + 1})
        for na, nk, beginning in product(range(1, policy.largest_poles + 1), delays, beginnings):
            # Both ways of fitting: the one-step error favours noise models, the free run is what is judged.
            for nb, focus in product(sorted({1, 2, na, na + 1}), ("prediction", "simulation")):
                yield {"na": na, "nb": nb, "nk": nk, "focus": focus, **beginning}
        return
    arx = scans[BlackBoxKind.ARX].chosen.orders if BlackBoxKind.ARX in scans else {"nk": 1, **beginnings[-1]}
    nk, beginning = arx["nk"], {name: arx[name] for name in ("at_rest", "offset")}
    poles = range(1, policy.largest_searched_poles + 1)
    if kind == BlackBoxKind.ARMAX:
        for n, delay in product(poles, sorted({nk, 1})):
            for nb, nc in product(sorted({1, n, n + 1}), sorted({1, n})):
                yield {"na": n, "nb": nb, "nc": nc, "nk": delay, **beginning}
    elif kind == BlackBoxKind.OUTPUT_ERROR:
        for n, delay in product(poles, sorted({nk, max(nk - 1, 0), 1})):
            for nb in sorted({1, n, n + 1}):
                yield {"nb": nb, "nf": n, "nk": delay, **beginning}
    elif BlackBoxKind.OUTPUT_ERROR in scans:
        linear = scans[BlackBoxKind.OUTPUT_ERROR].chosen.orders
        if kind == BlackBoxKind.BOX_JENKINS:
            yield from ({**linear, "nc": nc, "nd": nd} for nc, nd in ((0, 1), (1, 1), (2, 2)))
            return
        levels = min(len(find_levels([r.signals[i] for r in data.records])) for i in range(len(data.inputs)))
        for shape, sizes in policy.nonlinearities.items():
            for basis_size in (size for size in sizes if size < levels):
                for nf in sorted({linear["nf"], min(linear["nf"] + 1, policy.largest_searched_poles)}):
                    nb = max(linear["nb"], nf)
                    yield {**linear, "nb": nb, "nf": nf, "shape": shape, "basis_size": basis_size}


# Longest delay in samples that is looked for.
LARGEST_DELAY = 40
# Rows of the shortest record for each sample of delay, at least.
ROWS_PER_DELAY = 20


def _find_delay(data: SampledData, at_rest: bool) -> int:
    """Samples of delay with which two poles and two zeros predict the records best."""
    shortest = min(r.rows for r in data.records)
    least, delay = np.inf, 1
    for nk in range(min(LARGEST_DELAY, shortest // ROWS_PER_DELAY) + 1):
        orders = {"na": 2, "nb": 2, "nk": nk, "offset": not at_rest, "at_rest": at_rest}
        try:
            model = fit_structure(data, BlackBoxKind.ARX, orders)
        except DataError:
            continue  # such as two columns of a step; the scan itself says so
        loss = model.loss  # type: ignore[union-attr]  # an ARX model is a polynomial one
        if loss < least:
            least, delay = loss, nk
    return delay
