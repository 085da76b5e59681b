"""The same fit from many random starts: how many of them end at the best optimum says how far it can be trusted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np

from greybox.errors import GreyboxError, ModelError
from greybox.estimation.fit import ColourTreatment, fit
from greybox.estimation.options import FitOptions, resolve_options
from greybox.estimation.problem import EstimationProblem, prepare_problem
from greybox.estimation.solve import solve
from greybox.experiment import Experiment
from greybox.model import Model
from greybox.model.signals import Parameter
from greybox.noise import NoiseModel
from greybox.parallel import JobProgressCallback, run_jobs
from greybox.result import Fit, StartResult

# Ends belong together if their costs differ by at most this share, or their misfits over noise by this much.
SAME_COST, SAME_MISFIT = 0.01, 1e-3


@dataclass(frozen=True)
class MultiStartResult:
    """``best``: the fit from the best end, which carries the others in `Fit.starts`. ``ends``: all of them, best first.

    ``interrupted``: Ctrl-C came before all were done.
    """

    best: Fit
    start_results: tuple[StartResult, ...]
    interrupted: bool = False

    @property
    def best_optimum_count(self) -> int:
        """How many starts ended at the best optimum."""
        return len(group_by_optimum(self.start_results)[0])

    @property
    def waterfall(self) -> str:
        """How many starts ended where, in words."""
        return describe_starts(self.start_results)

    def __str__(self) -> str:
        return f"{self.waterfall}\n{self.best}"


def multistart(
    model: Model,
    experiments: Experiment | Sequence[Experiment],
    *,
    starts: int = 20,
    seed: int = 0,
    factor: float = 3.0,
    noise: Mapping[str, float] | NoiseModel | None = None,
    quiet: Experiment | Sequence[Experiment] = (),
    colour: ColourTreatment = "known",
    validation: Experiment | Sequence[Experiment] = (),
    skip: int = 0,
    options: FitOptions | None = None,
    executor: Executor | None = None,
    workers: int = 0,
    report: JobProgressCallback | None = None,
) -> MultiStartResult:
    """Fit ``model`` from its own start and ``starts - 1`` random ones, see `draw_starts`; the rest as in `fit`.

    The starts are independent of each other and run on local processes, ``workers`` of them (0: one for each core), or on
    any ``executor``. ``report(done, starts)`` is called after each. Ctrl-C keeps what is finished.

    Raises GreyboxError if no start led anywhere, ModelError and DataError as `fit` does.
    """
    options = resolve_options(options)
    if starts < 1:
        raise ModelError(f"starts {starts}: give at least 1, the model's own")
    if model.noisy_states:
        raise ModelError(
            f"{model.title}: many starts compare free runs, which say nothing about process noise; fit it from one start, or first"
            " without its process noise"
        )
    group = (experiments,) if isinstance(experiments, Experiment) else tuple(experiments)
    known = _prepared(model, group, noise, options, quiet).noise  # looked at once; refuses here what no start can use
    per_experiment = {q.name: q.value for q in model.free_parameters}
    begins = [per_experiment, *draw_starts(model, starts - 1, seed, factor)]
    results, interrupted = run_jobs(
        _one, (model, group, known, options), begins, executor=executor, workers=workers, report=report
    )
    start_results = []
    for begin, done in zip(begins, results, strict=True):
        if done is not None and done.error:
            start_results.append(StartResult(begin, {}, np.inf, done.error, done.seconds))
        elif done is not None:
            values, ratio, status = done.value
            start_results.append(StartResult(begin, values, ratio, status, done.seconds))
    start_results.sort(key=lambda end: end.noise_ratio)
    if not start_results or not start_results[0].values:
        reason = start_results[0].status if start_results else "interrupted before the first was done"
        raise GreyboxError(
            f"multi-start of {model.title}: none of {len(begins)} starts led anywhere ({reason});"
            " give start values nearer to physical ones"
        )
    best = fit(
        model.start(**start_results[0].values), group, noise=noise, quiet=quiet, colour=colour, validation=validation, skip=skip,
        options=options,
    )  # fmt: skip
    best = replace(best, notes=(describe_starts(start_results), *best.notes), starts=tuple(start_results))
    return MultiStartResult(best, tuple(start_results), interrupted)


def draw_starts(model: Model, starts: int, seed: int = 0, factor: float = 3.0) -> list[dict[str, float]]:
    """Start values about the model's own: each free constant log-uniform between value / factor and value x factor, within its bounds.

    A constant at zero has no size to vary: it is uniform within its bounds, and stays where they are open. Raises ModelError
    for a factor of one or less.
    """
    if not factor > 1:
        raise ModelError(f"factor {factor:g} of the random starts: it must be greater than one; 3 is usual")
    rng = np.random.default_rng(seed)
    return [{q.name: _drawn(q, factor, rng.uniform()) for q in model.free_parameters} for _ in range(max(starts, 0))]


def _drawn(q: Parameter, factor: float, share: float) -> float:
    low, high = q.bounds
    if q.value == 0:
        return float(low + share * (high - low)) if np.isfinite(low) and np.isfinite(high) else 0.0
    start_results = sorted((q.value / factor, q.value * factor))
    a, b = max(start_results[0], low), min(start_results[1], high)
    size = np.sign(q.value)
    return float(np.clip(size * np.exp(np.log(size * a) + share * np.log(b / a)), low, high))


def group_by_optimum(start_results: Sequence[StartResult]) -> list[list[StartResult]]:
    """Ends at the same optimum, best first; what led nowhere is left out."""
    result: list[list[StartResult]] = []
    for end in sorted((e for e in start_results if e.values), key=lambda e: e.noise_ratio):
        if result and _alike(result[-1][0].noise_ratio, end.noise_ratio):
            result[-1].append(end)
        else:
            result.append([end])
    return result


def describe_starts(start_results: Sequence[StartResult]) -> str:
    """``18 of 20 starts ended at the best optimum (misfit 1.00 x noise), 2 at a worse one (3.4 x)``."""
    found = group_by_optimum(start_results)
    parts = [
        f"{len(found[0])} of {len(start_results)} starts ended at the best optimum (misfit {found[0][0].noise_ratio:.3g} x noise)"
    ]
    parts += [f"{len(group)} at a worse one ({group[0].noise_ratio:.3g} x)" for group in found[1:4]]
    if len(found) > 4:
        rest = sum(map(len, found[4:]))
        parts.append(f"{rest} at still worse ones (from {found[4][0].noise_ratio:.3g} x)")
    nowhere = sum(not end.values for end in start_results)
    return ", ".join([*parts, f"{nowhere} led nowhere"] if nowhere else parts)


def _alike(a: float, b: float) -> bool:
    return b**2 <= (1 + SAME_COST) * a**2 or b - a <= SAME_MISFIT


def _prepared(
    model: Model, experiments: Sequence[Experiment], noise: Mapping[str, float] | NoiseModel | None, options: FitOptions,
    quiet: Experiment | Sequence[Experiment] = (),
) -> EstimationProblem:  # fmt: skip
    return prepare_problem(
        model, experiments, noise, at_rest=options.at_rest, method=options.method, substeps=options.substeps, quiet=quiet,
        per_experiment=options.per_experiment, robust=options.robust,
    )  # fmt: skip


def _one(common: tuple, begin: Mapping[str, float]) -> tuple[dict[str, float], float, str]:
    """One start, where it runs: the values it ended with, misfit over noise, status."""
    model, experiments, noise, options = common
    solution = solve(_prepared(model.start(**begin), experiments, noise, options), options)
    e = solution.evaluation
    if not np.isfinite(e.cost):
        return {}, np.inf, solution.status.value
    values = dict(zip(model.values, solution.variables.fixed, strict=True))
    found = {q.name: float(values[q.name]) for q in model.free_parameters}
    return found, float(np.sqrt(e.cost / max(e.count, 1))), solution.status.value
