"""Many structures fitted in one call, tabulated, and the best of them chosen."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, Literal, get_args

import numpy as np

from greybox.blackbox.prediction_error_fit import SearchEffort
from greybox.blackbox.sampled_data import SampledData, to_sampled_data
from greybox.blackbox.structure_fit import (
    ORDERS_BY_KIND,
    BlackBox,
    BlackBoxKind,
    OrderChoice,
    fit_structure,
    get_linear_part,
    with_units,
)
from greybox.errors import DataError, nearest
from greybox.experiment import Experiment
from greybox.result.summary import format_table

SelectionCriterion = Literal["aic", "bic", "free run"]

FIRST_ROWS = 50  # of a judging record, that tell the initial state if `skip` does not say
AS_GOOD = 0.005  # of the best free-run error, within which another structure is as good
SHOWN = 12  # structures in a printed table
# While scanning; what is chosen is searched again in full.
QUICK = SearchEffort(starts=2, race=4, iterations=15, enough=1e-6)


@dataclass(frozen=True, eq=False)
class ScannedStructure:
    """One structure of a scan: its ``choice`` of orders, and the fitted ``model``, or why there is none (``refused``).

    ``aic = N ln(loss) + 2 p`` and ``bic = N ln(loss) + p ln N`` with the same N for all candidates, where ``loss`` is the mean
    square that the structure minimises; infinite for ``simulation`` focus, whose loss is another one. ``free_run``: root mean
    square error of the free run over the judging records, in the output's unit; infinite where it leaves all bounds.
    """

    label: str
    choice: OrderChoice
    model: BlackBox | None = None
    aic: float = np.inf
    bic: float = np.inf
    free_run: float = np.inf
    refused: str = ""


@dataclass(frozen=True, eq=False)
class StructureScan:
    """All candidates, and ``best``, the chosen one's model. ``by`` is the criterion, ``judged`` says on which records the free run
    was measured, ``seconds`` how long it took."""

    candidates: tuple[ScannedStructure, ...]
    chosen: ScannedStructure
    best: BlackBox
    by: SelectionCriterion
    judged: str
    unit: str = ""
    seconds: float = 0.0

    def __str__(self) -> str:
        key = {"aic": lambda c: c.aic, "bic": lambda c: c.bic, "free run": lambda c: c.free_run}[self.by]
        fitted = sorted((c for c in self.candidates if c.model is not None), key=key)
        shown = fitted[:SHOWN] if self.chosen in fitted[:SHOWN] else [*fitted[: SHOWN - 1], self.chosen]
        rows = [
            [
                c.label, f"{c.model.parameters}", *("-" if np.isposinf(v) else f"{v:.1f}" for v in (c.aic, c.bic)),
                f"{c.free_run:.4g} {self.unit}".rstrip(),
                "" if c.model.stable else "unstable", "<- chosen" if c is self.chosen else "",
            ]
            for c in shown if c.model is not None
        ]  # fmt: skip
        refused = [c for c in self.candidates if c.model is None]
        lines = [
            f"{len(self.candidates)} structures, chosen by {self.by}; free run over {self.judged}",
            *format_table(["structure", "coefficients", "AIC", "BIC", "free run", "", ""], rows),
        ]
        if len(fitted) > len(shown):
            lines.append(f"  and {len(fitted) - len(shown)} more")
        if refused:
            lines.append(f"  {len(refused)} could not be fitted, the first: {refused[0].refused}")
        return "\n".join(lines)


def scan_structures(
    experiments: Experiment | Sequence[Experiment],
    kind: BlackBoxKind = "arx",
    *,
    na: Any = range(1, 5),
    nb: Any = range(1, 5),
    nc: Any = (1, 2),
    nd: Any = (1, 2),
    nf: Any = range(1, 4),
    nk: Any = (1, 2, 3),
    offset: Any = False,
    focus: Any = "prediction",
    shape: Any = "polynomial",
    freedom: Any = 3,
    at_rest: bool = False,
    output: str | None = None,
    inputs: Sequence[str] | str | None = None,
    judge: Experiment | Sequence[Experiment] = (),
    skip: int = 0,
    by: SelectionCriterion = "free run",
    units: Mapping[str, str] | None = None,
    report: Callable[[int, int, ScannedStructure], None] | None = None,
) -> StructureScan:
    """Fit every combination of the given orders, and choose.

    ``kind`` is ``arx``, ``armax``, ``output error``, ``box-jenkins`` or ``hammerstein``; of the choices those count that it has (see
    `arx`, `armax`, `output_error`, `box_jenkins`, `hammerstein`). Each is one value, or several to try: ``na=range(1, 6)``,
    ``offset=(False, True)``; for several inputs ``nb``, ``nf`` and ``nk`` may hold tuples, one number for each input. ``at_rest``:
    everything was zero before each record (``history="zero"``).

    ``judge``: other records, on which the free run is measured, without their first ``skip`` rows and from the initial state
    that those tell (the first 50 if 0); without any the free run over ``experiments`` themselves counts. ``by``: ``"free run"``
    takes, of all stable structures within 0.5 % of the smallest error, the one of smallest BIC (for output errors, whose BIC
    trusts a white free-run error, the one of fewest coefficients); ``"aic"`` and ``"bic"`` the smallest criterion.
    ``report(done, of, candidate)`` is called after each.

    Raises DataError where no structure could be fitted, with the reason of the first.
    """
    if kind not in ORDERS_BY_KIND:
        raise DataError(f"unknown kind {kind!r}; {nearest(kind, ORDERS_BY_KIND)}")
    if by not in get_args(SelectionCriterion):
        raise DataError(f"unknown criterion {by!r}; {nearest(by, get_args(SelectionCriterion))}")
    given = {
        "na": na, "nb": nb, "nc": nc, "nd": nd, "nf": nf, "nk": nk, "offset": offset, "focus": focus, "shape": shape,
        "freedom": freedom,
    }  # fmt: skip
    axes = {letter: _several(given[letter]) for letter in ORDERS_BY_KIND[kind]}
    choices = [dict(zip(axes, values, strict=True)) for values in product(*axes.values())]
    data = to_sampled_data(experiments, output, inputs)
    return scan_choices(data, kind, choices, at_rest=at_rest, judge=judge, skip=skip, by=by, units=units, report=report)


def scan_choices(
    data: SampledData,
    kind: BlackBoxKind,
    choices: Iterable[OrderChoice],
    *,
    at_rest: bool,
    judge: Experiment | Sequence[Experiment] = (),
    skip: int = 0,
    by: SelectionCriterion = "free run",
    units: Mapping[str, str] | None = None,
    report: Callable[[int, int, ScannedStructure], None] | None = None,
    final: SampledData | None = None,
) -> StructureScan:
    """`scan_structures` over a list of ``choices``; the chosen one is fitted to ``final`` (None: to the same records)."""
    judges = (judge,) if isinstance(judge, Experiment) else tuple(judge)
    listed, found, began = list(choices), [], time.perf_counter()
    for done, choice in enumerate(listed, 1):
        try:
            model = fit_structure(data, kind, choice, at_rest=at_rest, effort=QUICK)
        except DataError as error:
            said = ", ".join(f"{letter} {choice[letter]}" for letter in ORDERS_BY_KIND[kind] if letter in choice)
            candidate = ScannedStructure(f"{kind}({said})", choice, refused=str(error))
        else:
            candidate = ScannedStructure(
                model.label, choice, model, free_run=_free_run(model, data, judges, skip, at_rest)
            )
        found.append(candidate)
        if report is not None:
            report(done, len(listed), candidate)
    if all(c.model is None for c in found):
        raise DataError(
            found[0].refused if found else f"{kind}: no structure to fit; give at least one order of each kind"
        )
    found = _with_criteria(found)
    chosen = _chosen([c for c in found if c.model is not None], by)
    best = with_units(fit_structure(final or data, kind, chosen.choice, at_rest=at_rest), units or {})
    judged = ", ".join(e.name for e in judges) or "the fitted records"
    return StructureScan(
        tuple(found), chosen, best, by, judged, (units or {}).get(data.output, ""), time.perf_counter() - began
    )


def _several(value: Any) -> list[Any]:
    return [value] if isinstance(value, (bool, int, np.integer, str)) else list(value)


def _free_run(model: BlackBox, data: SampledData, judges: Sequence[Experiment], skip: int, at_rest: bool) -> float:
    """Root mean square error of the free run over the judging records, or over the fitted ones without any."""
    squares, count = 0.0, 0
    rows, left_out = ((skip or FIRST_ROWS), skip) if judges else (None, 0)
    for experiment in judges or data.experiments:
        run = model.simulate(experiment, initial="zero" if at_rest else "estimated", rows=rows)[model.output][left_out:]
        measured = experiment.outputs[model.output][left_out:]
        there = np.isfinite(measured)
        with np.errstate(over="ignore", invalid="ignore"):
            error = measured[there] - run[there]
            squares += float(error @ error)
        count += len(error)
    return float(np.sqrt(squares / count)) if np.isfinite(squares) and count else np.inf


def _with_criteria(candidates: Sequence[ScannedStructure]) -> list[ScannedStructure]:
    """The same with AIC and BIC on a common number of equations, so that losing a few rows to history is no gain."""
    n = min(get_linear_part(c.model).samples for c in candidates if c.model is not None)
    result = []
    for c in candidates:
        if c.model is None or c.choice.get("focus") == "simulation":
            result.append(c)  # the prefiltered loss is not comparable
            continue
        loss = get_linear_part(c.model).loss
        fit = n * np.log(loss) if loss > 0 else -np.inf
        result.append(replace(c, aic=fit + 2 * c.model.parameters, bic=fit + c.model.parameters * np.log(n)))
    return result


def _chosen(candidates: Sequence[ScannedStructure], by: SelectionCriterion) -> ScannedStructure:
    if by != "free run":
        return min(candidates, key=lambda c: c.aic if by == "aic" else c.bic)
    stable = [c for c in candidates if c.model is not None and c.model.stable and np.isfinite(c.free_run)]
    pool = stable or list(candidates)
    smallest = min(c.free_run for c in pool)
    near = [c for c in pool if c.free_run <= (1 + AS_GOOD) * smallest] or pool
    return min(near, key=_preference)


def _preference(candidate: ScannedStructure) -> tuple[float, float, float]:
    """Of structures that run equally well: the smallest BIC where it is about a one-step error, which can be white; else, because a
    free-run error is not and its BIC would go on praising coefficients, the fewest of these."""
    model = candidate.model
    count = float(model.parameters) if model is not None else np.inf
    one_step = model is not None and get_linear_part(model).kind != "output error"
    return (candidate.bic if one_step else count, count, candidate.free_run)
