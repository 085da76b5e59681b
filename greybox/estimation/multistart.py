"""The same fit from many random starts, kept in a journal: how many end at the best optimum says how far it can be trusted."""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from greybox.base import Finding, Printable, Severity, read_versions
from greybox.base.errors import GreyboxError, ModelError, WorkersLostError
from greybox.base.files import add_entry, read_journal
from greybox.base.parallel.jobs import JobProgressCallback, JobResult, run_jobs
from greybox.data.experiment import Experiment
from greybox.data.noise import GrowingNoise, NoiseModel
from greybox.data.read import as_experiments
from greybox.estimation.findings import LAST_DIGIT, EstimationCode
from greybox.estimation.fit import fit
from greybox.estimation.noise_loop import solve
from greybox.estimation.optim.minimisation import TerminationStatus
from greybox.estimation.optimum import SimulationOptimum
from greybox.estimation.options import ColourTreatment, FitOptions, explain_unknown, resolve_options
from greybox.estimation.result import Fit
from greybox.estimation.result_parts import StartResult
from greybox.estimation.starts import StartSearch, compute_ratio, draw_starts, measure_fresh_effects
from greybox.estimation.transcription.preparation import begin_with_known_past, prepare_problem
from greybox.estimation.transcription.problem import EstimationProblem
from greybox.model import Model
from greybox.model.effects.scales import list_effect_values
from greybox.model.equations import identify
from greybox.simulation.plant import Plant, as_model
from greybox.simulation.records import to_experiments


@dataclass
class StartJournal:
    """Where starts ended, one JSON object a line, by a hash of model, records, noise, options, versions and start.

    Raises
    ------
    DataError
        If the file is no journal.
    """

    path: Path
    known: dict[str, JobResult] = field(init=False)

    def __post_init__(self) -> None:
        def parse(data: Mapping[str, Any]) -> tuple[str, JobResult]:
            values = {str(name): float(value) for name, value in data["values"].items()}
            ratio = float("inf") if data["ratio"] is None else float(data["ratio"])
            return str(data["key"]), JobResult((values, ratio, str(data["status"])), "", float(data["seconds"]))

        self.known = dict(read_journal(self.path, parse).entries)

    def add(self, key: str, result: JobResult) -> None:
        """Keep one more, on the disk when this returns. Raises OutputError."""
        values, ratio, status = result.value
        # JSON has no infinity: null is a start without a run.
        number = ratio if abs(ratio) < float("inf") else None
        add_entry(
            self.path, {"key": key, "values": values, "ratio": number, "status": status, "seconds": result.seconds}
        )


def hash_start(
    model: Model, experiments: Sequence[Experiment], noise: NoiseModel, options: FitOptions, begin: Mapping[str, float]
) -> str:
    """The hash by which a start is known: equal if everything that decides its end is."""
    identity = [
        *identify(model),
        [e.identity for e in experiments],
        noise.std.tolist(),
        [c.reflection for c in noise.colour],
        *([repr(sorted(noise.growth.items()))] if noise.growth else []),
        repr(options),
        sorted(begin.items()),
        sorted(read_versions().items()),
    ]
    return hashlib.sha256(repr(identity).encode(errors="backslashreplace")).hexdigest()[:32]


# Two ends are the same optimum where their costs differ by at most this share of the smaller one ...
MULTISTART_SAME_COST = 0.01
# ... or their misfits over noise by this.
SAME_NOISE_RATIO = 0.001
# A constant that did not move stands elsewhere than at the best end where it differs by this share: no optimum is told so coarsely.
UNMOVED_APART = 0.01


def group_by_optimum(start_results: Sequence[StartResult]) -> list[list[StartResult]]:
    """Results at the same optimum, best first; starts without a result are left out."""
    groups: list[list[StartResult]] = []
    for result in sorted((r for r in start_results if r.values), key=lambda r: r.noise_ratio):
        best, ratio = groups[-1][0].noise_ratio if groups else 0.0, result.noise_ratio
        is_same = ratio**2 <= (1 + MULTISTART_SAME_COST) * best**2 or ratio - best <= SAME_NOISE_RATIO
        if groups and is_same:
            groups[-1].append(result)
        else:
            groups.append([result])
    return groups


def count_unmoved(group: Sequence[StartResult]) -> dict[str, int]:
    """Of starts at one optimum: constants that stayed where some were begun, though not where the best ended -> how many starts.

    Nothing drew them there: such a start says nothing of the constant.
    """
    best: Mapping[str, float] = group[0].values if group else {}
    counts: dict[str, int] = {}
    for name, value in best.items():
        stood = [
            r for r in group if abs(r.values[name] - r.start.get(name, np.nan)) <= LAST_DIGIT * abs(r.values[name])
        ]
        count = sum(abs(r.values[name] - value) > UNMOVED_APART * abs(value) for r in stood)
        counts |= {name: count} if count else {}
    return counts


def summarise_starts(start_results: Sequence[StartResult]) -> Finding:
    """How many starts ended at each optimum, the best first, how many have no result, and which constants stayed where they were drawn."""
    groups = group_by_optimum(start_results)
    values: dict[str, Any] = {
        "counts": [len(group) for group in groups],
        "ratios": [group[0].noise_ratio for group in groups],
        "without_result": sum(not result.values for result in start_results),
    }
    if unmoved := count_unmoved(groups[0] if groups else []):
        values["unmoved"] = unmoved
    return Finding(EstimationCode.STARTS, Severity.NOTE, "", values)


@dataclass(frozen=True)
class MultiStartResult(Printable):
    """Where several starts ended.

    Attributes
    ----------
    best
        The fit from the best end, which carries the others in `Fit.starts`.
    start_results
        Where each start ended, best first.
    interrupted
        Whether Ctrl-C came before all were done.
    policy
        When two ends are the same optimum.
    """

    best: Fit
    start_results: tuple[StartResult, ...]
    interrupted: bool = False

    @property
    def best_optimum_count(self) -> int:
        """How many starts ended at the best optimum."""
        return len(group_by_optimum(self.start_results)[0])

    @property
    def summary(self) -> Finding:
        """How many starts ended where."""
        return summarise_starts(self.start_results)


@explain_unknown
def multistart(
    model: Model | Plant,
    experiments: Experiment | Sequence[Experiment],
    *,
    starts: int = 20,
    seed: int = 0,
    factor: float = 3.0,
    noise: Mapping[str, float | GrowingNoise] | NoiseModel | None = None,
    quiet: Experiment | Sequence[Experiment] = (),
    colour: ColourTreatment | str = ColourTreatment.KNOWN,
    validation: Experiment | Sequence[Experiment] = (),
    skip: int = 0,
    beginning: int = 0,
    per_experiment: str | Sequence[str] = (),
    options: FitOptions | None = None,
    executor: Executor | None = None,
    workers: int = 0,
    report: JobProgressCallback | None = None,
    journal: str | Path | None = None,
    time_limit: float = math.inf,
) -> MultiStartResult:
    """Fit ``model`` from its own start and from random ones.

    Parameters
    ----------
    model
        The model, or a plant as in `greybox.fit`; its values are the first start.
    experiments
        Estimation records.
    starts
        How many starts, the model's own included, which is searched from as `greybox.fit` does: several are never worse than one. The
        others are drawn by `greybox.estimation.multistart.draw_starts`, constants of an effect that changes nothing yet about what the
        records can show of it.
        Where the best of them explains nothing, `FitOptions.other_starts` follow, and count as well.
    seed
        Seed of the draws.
    factor
        Random starts lie between value / factor and value x factor.
    noise, quiet, colour, validation, skip, beginning, per_experiment, options
        As in `greybox.fit`.
    executor
        Where the starts run; None for processes of this machine.
    workers
        How many local processes, 0 for one on each core.
    report
        Called as ``report(done, starts)`` after each start.
    journal
        File that keeps every finished start; the same call continues from it.
    time_limit
        Seconds after which no start begins. The first one always does.

    Returns
    -------
    MultiStartResult
        The best fit and where each start ended. Ctrl-C keeps what is finished.

    Raises
    ------
    GreyboxError
        If no start leads to a result.
    ModelError, DataError
        As `greybox.fit`.
    WorkersLostError
        If a cluster is lost. The starts that are finished are in the journal.
    """
    began, options = time.perf_counter(), resolve_options(options)
    model = as_model(model)
    if not time_limit > 0:
        raise ModelError(f"a time limit of {time_limit:g} s: give a number of seconds above 0")
    if starts < 1:
        raise ModelError(f"starts {starts}: give at least 1, the model's own")
    if model.noisy_states:
        raise ModelError(
            f"{model.title}: several starts compare free runs, which do not determine process noise; fit it from one start, or first"
            " without its process noise"
        )
    group, validation, quiet = (as_experiments(records, model) for records in (experiments, validation, quiet))
    names = (per_experiment,) if isinstance(per_experiment, str) else per_experiment
    options = replace(options, per_experiment=(*options.per_experiment, *names))
    group = begin_with_known_past(model, to_experiments(group), options)
    problem = prepare_problem(model, group, noise, options, quiet=quiet)  # once; refuses here what no start can use
    known_noise = problem.noise
    begins = [
        {q.name: q.value for q in model.free_parameters},
        *_draw_others(problem, options, starts - 1, seed, factor),
    ]
    kept = None if journal is None else StartJournal(Path(journal))
    keys = [hash_start(model, group, known_noise, options, begin) if kept else "" for begin in begins]
    results: list[JobResult | None] = [kept.known.get(key) if kept else None for key in keys]
    # What the journal has is not fitted again: the numbers of the jobs are those of the starts that are left.
    remaining = [k for k, result in enumerate(results) if result is None]
    before = len(begins) - len(remaining)

    def receive(number: int, result: JobResult) -> None:
        k = remaining[number]
        results[k] = result
        if kept is not None and not result.error:
            kept.add(keys[k], result)

    try:
        _, interrupted = run_jobs(
            _fit_from,
            (model, group, known_noise, options),
            [begins[k] for k in remaining],
            executor=executor,
            workers=workers,
            report=None if report is None else lambda done, _: report(before + done, len(begins)),
            receive=receive,
            deadline=began + time_limit,
        )
    except WorkersLostError as error:
        raise WorkersLostError(error.fault, results) from error
    start_results = []
    for begin, job in zip(begins, results, strict=True):
        if job is not None and job.error:
            start_results.append(StartResult(begin, {}, np.inf, job.error, job.seconds))
        elif job is not None:
            values, ratio, status = job.value
            start_results.append(StartResult(begin, values, ratio, status, job.seconds))
    left = len(begins) - len(start_results)
    is_late = not interrupted and left > 0
    # Failed starts have an infinite ratio and come last.
    start_results.sort(key=lambda result: result.noise_ratio)
    if not start_results or not start_results[0].values:
        reason = (
            f"the first was not done within {time_limit:g} s" if is_late else "interrupted before the first was done"
        )
        reason = start_results[0].status if start_results else reason
        raise GreyboxError(
            f"multi-start of {model.title}: none of {len(begins)} starts has a result ({reason}); give start values nearer to physical"
            " ones"
        )
    ends: list[tuple[float, Fit]] = []
    promised = (1 + MULTISTART_SAME_COST) ** 0.5 * start_results[0].noise_ratio + SAME_NOISE_RATIO
    # Fitted anew from its own end, in this process: starts bring back values alone, not a whole fit. Where that does not end as well
    # (first states are not brought back), from where it began, and at last from the model's own start, whose search is this very one.
    again_from: tuple[Mapping[str, float], ...] = (start_results[0].values, start_results[0].start, begins[0])
    for again_begin in again_from:
        again = fit(
            model.start(**again_begin),
            group,
            noise=noise,
            quiet=quiet,
            colour=colour,
            validation=validation,
            skip=skip,
            beginning=beginning,
            # Where none of them explains anything the fit begins others; none after the time limit or Ctrl-C.
            options=replace(options, other_starts=0, exchange=False) if left else options,
        )
        ends.append((compute_ratio(again.solver.cost, again.misfit, known_noise), again))
        if ends[-1][0] <= promised or left:
            break
    best = min(ends, key=lambda end: end[0])[1]
    others = (result for result in best.starts if result.start != start_results[0].values)
    start_results = sorted([*start_results, *others], key=lambda result: result.noise_ratio)
    # As the caller gave them, the number of starts included.
    best = replace(best, provenance=replace(best.provenance, options=options.to_data()))
    summary = summarise_starts(start_results)
    values = {"left": left, "starts": len(begins), "seconds": time_limit}
    late = (Finding(EstimationCode.STARTS_NOT_BEGUN, Severity.WARNING, "", values),) if is_late else ()
    best = replace(best, findings=(summary, *late, *best.findings), starts=tuple(start_results))
    return MultiStartResult(best, tuple(start_results), interrupted)


def _draw_others(
    problem: EstimationProblem, options: FitOptions, count: int, seed: int, factor: float
) -> list[dict[str, float]]:
    """Random starts; the constants of effects that change nothing yet are drawn about values that the records can show."""
    model, rng = problem.model, np.random.default_rng(seed)
    begins = draw_starts(model, count, seed, factor)
    fresh = measure_fresh_effects(StartSearch(problem, problem.experiments, options)) if begins else None
    if fresh is None:
        return begins
    for effect in fresh.effects:
        values = list(list_effect_values(model, effect, fresh.scales))
        for begin in begins:
            value = values[rng.integers(len(values))]
            (near,) = draw_starts(model.start(**value), 1, rng, factor)
            begin.update({name: near[name] for name in value if name in begin})
    return begins


def _fit_from(common: tuple, begin: Mapping[str, float]) -> tuple[dict[str, float], float, str]:
    """One start, where it runs: the values it ended with, misfit over noise, status. The model's own is searched from as `fit` does."""
    model, experiments, noise, options = common
    result: Fit | SimulationOptimum
    if begin == {q.name: q.value for q in model.free_parameters}:
        result = fit(model, experiments, noise=noise, options=options)
        cost, status, fitted = result.solver.cost, result.status, result.model
    else:
        end = solve(prepare_problem(model.start(**begin), experiments, noise, options), options)
        result = SimulationOptimum(model, end)
        cost, status, fitted = end.evaluation.cost, str(end.status), result.fitted_model
    if status == TerminationStatus.INTERRUPTED:  # the search hears Ctrl-C itself
        raise KeyboardInterrupt
    ratio = compute_ratio(cost, result.misfit, noise) if np.isfinite(cost) else np.inf
    if not np.isfinite(ratio):
        return {}, np.inf, status
    return {q.name: float(fitted.values[q.name]) for q in model.free_parameters}, ratio, status
