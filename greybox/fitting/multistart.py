"""The same fit from many random starts: how many of them end at the best optimum says how far it can be trusted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np

from greybox.errors import GreyboxError, ModelError
from greybox.experiment import Experiment
from greybox.fitting.fit import Colouring, fit
from greybox.fitting.options import FitOptions, options_given
from greybox.fitting.problem import Problem, prepare
from greybox.fitting.solve import solve
from greybox.model import Model
from greybox.noise import Noise
from greybox.parallel import Report, run
from greybox.result import Fit, StartResult
from greybox.signals import Parameter

# Ends belong together if their costs differ by at most this share, or their misfits over noise by this much.
SAME_COST, SAME_MISFIT = 0.01, 1e-3


@dataclass(frozen=True)
class MultiStart:
    """``best``: the fit from the best end, which carries the others in `Fit.starts`. ``ends``: all of them, best first.

    ``interrupted``: Ctrl-C came before all were done.
    """

    best: Fit
    ends: tuple[StartResult, ...]
    interrupted: bool = False

    @property
    def winners(self) -> int:
        """How many starts ended at the best optimum."""
        return len(groups(self.ends)[0])

    @property
    def waterfall(self) -> str:
        """How many starts ended where, in words."""
        return waterfall(self.ends)

    def __str__(self) -> str:
        return f"{self.waterfall}\n{self.best}"


def multistart(
    model: Model,
    experiments: Experiment | Sequence[Experiment],
    *,
    starts: int = 20,
    seed: int = 0,
    factor: float = 3.0,
    noise: Mapping[str, float] | Noise | None = None,
    quiet: Experiment | Sequence[Experiment] = (),
    colour: Colouring = "known",
    validation: Experiment | Sequence[Experiment] = (),
    skip: int = 0,
    options: FitOptions | None = None,
    executor: Executor | None = None,
    workers: int = 0,
    report: Report | None = None,
) -> MultiStart:
    """Fit ``model`` from its own start and ``starts - 1`` random ones, see `random_starts`; the rest as in `fit`.

    The starts are independent of each other and run on local processes, ``workers`` of them (0: one for each core), or on
    any ``executor``. ``report(done, starts)`` is called after each. Ctrl-C keeps what is finished.

    Raises GreyboxError if no start led anywhere, ModelError and DataError as `fit` does.
    """
    options = options_given(options)
    if starts < 1:
        raise ModelError(f"starts {starts}: give at least 1, the model's own")
    if model.noisy_states:
        raise ModelError(
            f"{model.title}: many starts compare free runs, which say nothing about process noise; fit it from one start, or first"
            " without its process noise"
        )
    group = (experiments,) if isinstance(experiments, Experiment) else tuple(experiments)
    known = _prepared(model, group, noise, options, quiet).noise  # looked at once; refuses here what no start can use
    own = {q.name: q.value for q in model.free_parameters}
    begins = [own, *random_starts(model, starts - 1, seed, factor)]
    results, interrupted = run(
        _one, (model, group, known, options), begins, executor=executor, workers=workers, report=report
    )
    ends = []
    for begin, done in zip(begins, results, strict=True):
        if done is not None and done.error:
            ends.append(StartResult(begin, {}, np.inf, done.error, done.seconds))
        elif done is not None:
            values, ratio, status = done.value
            ends.append(StartResult(begin, values, ratio, status, done.seconds))
    ends.sort(key=lambda end: end.noise_ratio)
    if not ends or not ends[0].values:
        reason = ends[0].status if ends else "interrupted before the first was done"
        raise GreyboxError(
            f"multi-start of {model.title}: none of {len(begins)} starts led anywhere ({reason});"
            " give start values nearer to physical ones"
        )
    best = fit(
        model.start(**ends[0].values), group, noise=noise, quiet=quiet, colour=colour, validation=validation, skip=skip,
        options=options,
    )  # fmt: skip
    best = replace(best, notes=(waterfall(ends), *best.notes), starts=tuple(ends))
    return MultiStart(best, tuple(ends), interrupted)


def random_starts(model: Model, starts: int, seed: int = 0, factor: float = 3.0) -> list[dict[str, float]]:
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
    ends = sorted((q.value / factor, q.value * factor))
    a, b = max(ends[0], low), min(ends[1], high)
    size = np.sign(q.value)
    return float(np.clip(size * np.exp(np.log(size * a) + share * np.log(b / a)), low, high))


def groups(ends: Sequence[StartResult]) -> list[list[StartResult]]:
    """Ends at the same optimum, best first; what led nowhere is left out."""
    result: list[list[StartResult]] = []
    for end in sorted((e for e in ends if e.values), key=lambda e: e.noise_ratio):
        if result and _alike(result[-1][0].noise_ratio, end.noise_ratio):
            result[-1].append(end)
        else:
            result.append([end])
    return result


def waterfall(ends: Sequence[StartResult]) -> str:
    """``18 of 20 starts ended at the best optimum (misfit 1.00 x noise), 2 at a worse one (3.4 x)``."""
    found = groups(ends)
    parts = [
        f"{len(found[0])} of {len(ends)} starts ended at the best optimum (misfit {found[0][0].noise_ratio:.3g} x noise)"
    ]
    parts += [f"{len(group)} at a worse one ({group[0].noise_ratio:.3g} x)" for group in found[1:4]]
    if len(found) > 4:
        rest = sum(map(len, found[4:]))
        parts.append(f"{rest} at still worse ones (from {found[4][0].noise_ratio:.3g} x)")
    nowhere = sum(not end.values for end in ends)
    return ", ".join([*parts, f"{nowhere} led nowhere"] if nowhere else parts)


def _alike(a: float, b: float) -> bool:
    return b**2 <= (1 + SAME_COST) * a**2 or b - a <= SAME_MISFIT


def _prepared(
    model: Model, experiments: Sequence[Experiment], noise: Mapping[str, float] | Noise | None, options: FitOptions,
    quiet: Experiment | Sequence[Experiment] = (),
) -> Problem:  # fmt: skip
    return prepare(
        model, experiments, noise, at_rest=options.at_rest, method=options.method, substeps=options.substeps, quiet=quiet,
        own=options.own, robust=options.robust,
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
