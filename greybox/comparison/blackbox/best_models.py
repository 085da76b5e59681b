"""The best black box of each kind for a record: a scan of its own, validated on a part of the record that it was not fitted to."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import product

import numpy as np

from greybox.base.errors import DataError
from greybox.comparison.blackbox.hammerstein import find_levels
from greybox.comparison.blackbox.linear_regression import Origin, SampledData, to_sampled_data
from greybox.comparison.blackbox.resample import hold_out
from greybox.comparison.blackbox.structure_scan import (
    DEFAULT_SCAN,
    BlackBoxKind,
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

    Orders are chosen by cross-validation of the free-run error: of several records each third validates, of a single one its end,
    its beginning and its middle, if an input moves there; else (a step that has settled) the free run over the record itself. ARX
    models are scanned with prediction and with simulation focus, over up to six poles and the delays around the best; the others
    start from the delay found there. Signals are measured from their means, or from where they rest before a record. An input that
    never moves is left out.

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
    folds = hold_out(whole.experiments, (whole.output,), whole.inputs)
    data = to_sampled_data(folds[0].estimation, whole.output, whole.inputs)
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
            scans[kind] = scan_choices(folds, whole, kind, choices, units=units, report=report_scan, policy=policy)
        except DataError as error:
            reason = str(error)
    if not any(k in scans for k in kinds):
        raise DataError(f"output {whole.output!r}: no black-box model of these records: {reason}")
    return {BlackBoxKind(k): scans[BlackBoxKind(k)] for k in kinds if k in scans}


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
    nk, beginning = arx["nk"], {name: bool(arx[name]) for name in ("at_rest", "offset")}
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
