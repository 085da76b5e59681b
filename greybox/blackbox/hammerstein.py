"""Hammerstein models: each input passes a static curve before a linear difference equation."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import get_args

import numpy as np

from greybox.blackbox.initial_estimates import estimate_armax_starts, estimate_output_error_starts
from greybox.blackbox.linear_regression import Orders, refuse_few_rows, to_orders
from greybox.blackbox.polynomial import PolynomialModel
from greybox.blackbox.prediction_error import (
    PredictionErrorMinimum,
    PredictionErrors,
    compute_prediction_errors,
    minimise,
    split_records,
    stabilise,
)
from greybox.blackbox.prediction_error_fit import HistoryTreatment, SearchEffort, check_history, refuse_collinear
from greybox.blackbox.responses import InitialChoice
from greybox.blackbox.rounding import find_instability
from greybox.blackbox.sampled_data import SampledData, SampledRecord, to_sampled_data
from greybox.blackbox.static_nonlinearity import NonlinearityShape, StaticNonlinearity, make_linear_nonlinearity
from greybox.blackbox.structure import PolynomialStructure, to_order
from greybox.errors import DataError, nearest
from greybox.experiment import Experiment


@dataclass(frozen=True, eq=False)
class HammersteinModel:
    """``curves`` (one for each input) followed by ``linear``, whose inputs are the curves' values.

    The curve and the gain behind it share one scale: each curve is as large (rms over the records) as its input, and goes up.
    """

    curves: tuple[StaticNonlinearity, ...]
    linear: PolynomialModel

    @property
    def kind(self) -> str:
        """``hammerstein``; ``linear.kind`` is ``output error`` or ``arx``."""
        return "hammerstein"

    @property
    def output(self) -> str:
        """Name of the output."""
        return self.linear.output

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the inputs."""
        return self.linear.inputs

    @property
    def sampling_time(self) -> float:
        """Seconds from sample to sample."""
        return self.linear.sampling_time

    @property
    def label(self) -> str:
        """Kind, the curves' degree or number of pieces, and the linear part's orders."""
        said = [f"{'degree' if c.shape == 'polynomial' else 'pieces'} {len(c.shares)}" for c in self.curves]
        return f"hammerstein({', '.join(said)}; {self.linear.label})"

    @property
    def parameters(self) -> int:
        """Number of estimated numbers; each curve's scale is not one."""
        return self.linear.parameters + sum(len(c.shares) - 1 for c in self.curves)

    @property
    def stable(self) -> bool:
        """Whether every pole lies inside the unit circle."""
        return self.linear.stable

    @property
    def feedthrough(self) -> dict[str, float]:
        """Direct share of each curve in the output of the same row."""
        return self.linear.feedthrough

    @property
    def notes(self) -> tuple[str, ...]:
        """What one should know before trusting it."""
        return self.linear.notes

    def simulate(
        self, experiment: Experiment, *, initial: InitialChoice = "estimated", rows: int | None = None
    ) -> dict[str, np.ndarray]:
        """Free run ``{output: (N,)}``, as `PolynomialModel.simulate`."""
        return self.linear.simulate(self._bent(experiment), initial=initial, rows=rows)

    def predict(
        self, experiment: Experiment, steps: int = 1, *, initial: InitialChoice = "estimated", rows: int | None = None
    ) -> dict[str, np.ndarray]:
        """Prediction ``{output: (N,)}``, as `PolynomialModel.predict`."""
        return self.linear.predict(self._bent(experiment), steps, initial=initial, rows=rows)

    def __str__(self) -> str:
        from greybox.blackbox.text import describe_nonlinearity

        curves = [describe_nonlinearity(n, c, self.linear.units) for n, c in zip(self.inputs, self.curves, strict=True)]
        return "\n".join([self.label, *curves, "", str(self.linear)])

    def _bent(self, experiment: Experiment) -> Experiment:
        absent = [name for name in self.inputs if name not in experiment.inputs]
        if absent:
            raise DataError(
                f"experiment {experiment.name!r}: no input {absent[0]!r}; {nearest(absent[0], experiment.inputs)}"
            )
        bent = {name: curve(experiment.inputs[name]) for name, curve in zip(self.inputs, self.curves, strict=True)}
        return replace(experiment, inputs={**experiment.inputs, **bent})


def hammerstein(
    experiments: Experiment | Sequence[Experiment],
    *,
    nb: int | Sequence[int],
    nk: int | Sequence[int] = 1,
    nf: int | Sequence[int] = 0,
    na: int = 0,
    shape: NonlinearityShape = "polynomial",
    freedom: int = 3,
    output: str | None = None,
    inputs: Sequence[str] | str | None = None,
    history: HistoryTreatment = "estimated",
    offset: bool = False,
    units: Mapping[str, str] | None = None,
) -> HammersteinModel:
    """Fit ``y = sum_i B_i(q) / F_i(q) v_i + e`` with static curves ``v_i = g_i(u_i)`` by minimising the mean square free-run error.

    With ``na`` in place of ``nf`` the linear part is an ARX model, ``A(q) y = sum_i B_i(q) v_i + e``, and the one-step error is
    minimised. ``shape``: ``"polynomial"`` of degree ``freedom``, or ``"piecewise"`` straight with ``freedom`` pieces (a dead zone, a
    saturation). Everything else as in `output_error`. The search moves curve and linear part together; it starts from linear estimates
    in which every function of the curve is an input of its own.

    Raises DataError as `arx` does.
    """
    check_history(history)
    if shape not in get_args(NonlinearityShape):
        raise DataError(f"unknown shape {shape!r}; {nearest(shape, get_args(NonlinearityShape))}")
    if int(freedom) != freedom or freedom < 1:
        raise DataError(f"hammerstein: freedom = {freedom}; give a whole number from 1 (1: a straight line)")
    data = to_sampled_data(experiments, output, inputs)
    o = to_orders(data, nb, nk, na, "hammerstein")
    poles = (nf,) * len(o.nb) if isinstance(nf, (int, np.integer)) else tuple(nf)
    if na and any(poles):
        raise DataError(
            f"hammerstein: na = {na} and nf = {nf}; the linear part is an ARX model (na) or an output error (nf)"
        )
    if len(poles) != len(o.nb):
        raise DataError(
            f"hammerstein: nf has {len(poles)} numbers for {len(o.nb)} inputs; give one number, or one for each"
        )
    structure = PolynomialStructure(
        "arx" if na else "output error", o, tuple(to_order("nf", n, "hammerstein") for n in poles), offset=offset
    )
    return fit_hammerstein(structure, data, shape, freedom, history, units)


def fit_hammerstein(
    structure: PolynomialStructure,
    data: SampledData,
    shape: NonlinearityShape,
    freedom: int,
    history: HistoryTreatment,
    units: Mapping[str, str] | None = None,
    effort: SearchEffort | None = None,
) -> HammersteinModel:
    """The model of this structure with curves of ``freedom`` functions in front."""
    curves = tuple(
        make_linear_nonlinearity(shape, np.concatenate([s.u[:, i] for s in data.series]), freedom)
        for i in range(len(data.inputs))
    )
    bases = (tuple(c.basis(s.u[:, i]) for i, c in enumerate(curves)) for s in data.series)
    data = replace(data, series=tuple(replace(s, basis=b) for s, b in zip(data.series, bases, strict=True)))
    problem = _Bent(structure, data, split_records(data, structure), history == "zero", curves)
    label = HammersteinModel(curves, structure.model(np.zeros(structure.size), data)).label
    count = int(sum(np.isfinite(part.y).sum() for part in problem.parts))
    refuse_few_rows(data, label, count, problem.size, history)
    effort = effort or SearchEffort()
    starts = sorted(problem.starts(), key=lambda start: start[0].evaluate(start[1], False).squares)[: effort.starts]
    races = [(p, p.minimum(theta, effort.race, effort.enough)) for p, theta in starts]
    problem, best = min(races, key=lambda race: race[1].errors.squares)
    if not best.converged:
        best = problem.minimum(best.theta, effort.iterations, effort.enough)
    return _finished(problem, best, count, label, history, units or {})


@dataclass(frozen=True, eq=False)
class _Bent:
    """The unknowns: the linear part's coefficients, then each curve's shares without its largest one, which sets the scale."""

    structure: PolynomialStructure
    data: SampledData
    parts: tuple[SampledRecord, ...]
    rest: bool
    curves: tuple[StaticNonlinearity, ...]

    @property
    def held(self) -> list[int]:
        """Of each curve, the share that is not moved."""
        return [int(np.argmax(np.abs(c.shares))) for c in self.curves]

    @property
    def size(self) -> int:
        return self.structure.size + sum(len(c.shares) - 1 for c in self.curves)

    def joined(self, linear: np.ndarray) -> np.ndarray:
        moved = [np.delete(c.shares, k) for c, k in zip(self.curves, self.held, strict=True)]
        return np.concatenate([linear, *moved])

    def shares(self, theta: np.ndarray) -> list[np.ndarray]:
        counts = [len(c.shares) - 1 for c in self.curves]
        moved = np.split(theta[self.structure.size :], np.cumsum(counts)[:-1])
        return [np.insert(part, k, c.shares[k]) for part, k, c in zip(moved, self.held, self.curves, strict=True)]

    def admissible(self, theta: np.ndarray) -> np.ndarray:
        n = self.structure.size
        return np.append(stabilise(self.structure, theta[:n]), theta[n:])

    def evaluate(self, theta: np.ndarray, slopes: bool) -> PredictionErrors:
        n, shares = self.structure.size, self.shares(theta)
        parts = [
            replace(p, u=np.column_stack([b @ s for b, s in zip(p.basis, shares, strict=True)])) for p in self.parts
        ]
        found = compute_prediction_errors(self.structure, theta[:n], self.data, parts, rest=self.rest, slopes=slopes)
        if not slopes:
            return found
        held = (n + np.cumsum([0, *(len(c.shares) for c in self.curves)])[:-1] + self.held).astype(int)
        return replace(found, slopes=np.delete(found.slopes, held, axis=1))

    def minimum(self, theta: np.ndarray, iterations: int, enough: float) -> PredictionErrorMinimum:
        """The search from ``theta`` (p,)."""
        return minimise(self.evaluate, self.admissible, theta, iterations=iterations, enough=enough)

    def starts(self) -> Iterator[tuple[_Bent, np.ndarray]]:
        """Linear estimates with every function of a curve as an input of its own, their numerators then made multiples of one
        (the nearest matrix of rank one, Bai 1998)."""
        o, counts = self.structure.orders, [len(c.shares) for c in self.curves]
        spread = Orders(o.na, tuple(np.repeat(o.nb, counts)), tuple(np.repeat(o.nk, counts)))
        wide = replace(self.structure, orders=spread, nf=tuple(np.repeat(self.structure.nf, counts)))
        series = tuple(replace(s, u=np.hstack(s.basis), basis=()) for s in self.data.series)
        names = tuple(f"{name} {j}" for name, m in zip(self.data.inputs, counts, strict=True) for j in range(m))
        data = replace(self.data, inputs=names, series=series)
        for start in (estimate_armax_starts if o.na else estimate_output_error_starts)(wide, data, self.rest):
            a, *parts = wide.parts(start)
            b, f, rest = parts[: len(names)], parts[len(names) : 2 * len(names)], parts[2 * len(names) :]
            shares, numerators, poles = [], [], []
            for first, m in zip(np.cumsum([0, *counts[:-1]]), counts, strict=True):
                left, size, right = np.linalg.svd(np.stack(b[first : first + m]), full_matrices=False)
                shares.append(left[:, 0])
                numerators.append(size[0] * right[0])
                poles.append(f[first + int(np.argmax(np.abs(left[:, 0])))])
            curves = tuple(c.with_shares(s) for c, s in zip(self.curves, shares, strict=True))
            there = replace(self, curves=curves)
            yield there, there.admissible(there.joined(np.concatenate([a, *numerators, *poles, *rest])))


def _finished(
    problem: _Bent, best: PredictionErrorMinimum, count: int, label: str, history: str, units: Mapping[str, str]
) -> HammersteinModel:
    structure, data = problem.structure, problem.data
    names = list(structure.model(best.theta[: structure.size], data).coefficients)
    several = len(data.inputs) > 1
    for name, c in zip(data.inputs, problem.curves, strict=True):
        names += [f"curve{f'[{name}]' if several else ''} {j}" for j in range(1, len(c.shares))]
    refuse_collinear(best.errors.slopes, names, label)
    model = structure.model(best.theta[: structure.size], data)
    curves, b = [], []
    for i, (curve, shares) in enumerate(zip(problem.curves, problem.shares(best.theta), strict=True)):
        found = curve.with_shares(shares)
        u = np.concatenate([s.u[:, i] for s in data.series])
        v = found(u)
        scale = np.sqrt(np.mean(u**2) / np.mean(v**2)) * (1.0 if u @ v >= 0 else -1.0)
        curves.append(curve.with_shares(shares * scale))
        b.append(model.b[i] / scale)
    freedom = count - problem.size - best.errors.states
    notes = () if best.converged else (f"the search stopped after {best.iterations} iterations, before it had settled",)
    linear = replace(
        model, b=tuple(b), noise_std=float(np.sqrt(best.errors.squares / max(freedom, 1))), samples=count,
        loss=best.errors.squares / count, history=history, units=dict(units),
        focus="prediction" if structure.orders.na else "simulation", notes=(*notes, *find_instability(model)),
    )  # fmt: skip
    return HammersteinModel(tuple(curves), linear)
