"""The value of every black-box model here: polynomials in the backward shift ``q^-1``, one output, one or more inputs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cached_property, reduce
from typing import Any, Literal, get_args

import numpy as np
from scipy.signal import lfilter

from greybox.base import numerics
from greybox.base.errors import DataError, nearest
from greybox.base.texts import to_identifiers
from greybox.base.values import Finding, Printable
from greybox.comparison.blackbox.linear_regression import (
    BlockFilter,
    Orders,
    SampledData,
    SampledRecord,
    Scaling,
    delay_rows,
    each_block,
    to_sampled_record,
)
from greybox.data.experiment import Experiment
from greybox.estimation.validate import INITIAL_STATE_SHARE
from greybox.model.signals import Input, Output, Parameter, State
from greybox.simulation.plant import PlantModel

InitialChoice = Literal["zero", "measured", "estimated"]

# Codes of what a black-box model has to say about itself.


class BlackBoxFinding(StrEnum):
    """Findings about a black-box model; their sentences are in `greybox.show.sentences.comparison`."""

    WEAK_EXCITATION = "weak_excitation"
    """An input is persistently exciting of a lower order than the structure needs."""
    UNSTABLE = "black_box_unstable"
    """A pole lies on or outside the unit circle."""
    SEARCH_UNFINISHED = "black_box_search_unfinished"
    """The search used up its iterations before it converged."""


# Polynomials in ``q^-1`` made stable: their roots brought inside the unit circle.


def reflect_roots(polynomial: np.ndarray) -> np.ndarray:
    """A polynomial in ``q^-1`` that begins with 1, its roots outside the unit circle mirrored into it.

    The magnitude of its frequency response keeps its shape; a root on the circle goes just inside.
    """
    roots = np.roots(polynomial)
    size = np.abs(roots)
    if np.all(size < 1 - numerics.REFLECTED_ROOT_MARGIN):
        return polynomial
    # z -> 1 / conj(z): |1 - z e^{-iw}| changes by a constant factor alone, and so does the spectrum.
    size = np.where(size > 1, 1 / np.maximum(size, 1), size)
    inside = np.minimum(size, 1 - numerics.REFLECTED_ROOT_MARGIN) * np.exp(1j * np.angle(roots))
    mirrored = np.real(np.poly(inside))
    return np.append(mirrored, np.zeros(len(polynomial) - len(mirrored)))


def confine_roots(polynomial: np.ndarray) -> np.ndarray:
    """A polynomial in ``q^-1`` that begins with 1, its roots on or outside the unit circle moved radially to just inside it."""
    roots = np.roots(polynomial)
    size = np.abs(roots)
    if np.all(size <= 1 - numerics.CONFINED_ROOT_MARGIN):
        return polynomial
    confined = np.real(
        np.poly(roots * np.minimum(1.0, (1 - numerics.CONFINED_ROOT_MARGIN) / np.maximum(size, numerics.TINY)))
    )
    return np.append(confined, np.zeros(len(polynomial) - len(confined)))


ONE = np.ones(1)


@dataclass(frozen=True, eq=False)
class PolynomialModel(Printable):
    """A linear difference equation of one output.

    ``A(q) y(k) = sum_i B_i(q) / F_i(q) u_i(k) + constant / F_1(q) + C(q) / D(q) e(k)`` with ``A = 1 + a1 q^-1 + ...`` and so on, and
    ``B = q^-nk (b1 + b2 q^-1 + ...)`` (Ljung, System identification, 2nd ed., equation 4.33). The constant passes ``F_1`` as an offset of
    the first input does: behind an integrator it is a drift. Before a record that begins with zeros it had always been there.

    ``kind`` is ``arx``, ``armax``, ``output error`` ...; ``sampling_time`` in seconds. ``a``, ``c``, ``d`` (n + 1,) begin with 1;
    ``b`` holds for each input its coefficients with ``nk`` zeros in front (nk + nb,), ``f`` each (nf + 1,). ``noise_std`` is the
    standard deviation of ``e`` in the output's unit. ``covariance`` (p, p) belongs to the estimated coefficients in the order of
    `transfer_function_coefficients`; None where they were not estimated. ``samples`` equations went into the estimate and ``loss``
    is the mean square
    of what it minimised (the one-step error; for ``simulation`` focus the prefiltered one). ``history`` and ``focus`` say how the
    rows were made, ``units`` name -> unit, ``findings`` what one should know before trusting it. ``origins`` (1 + nu,) are what the output
    and the inputs are measured from in the equation, in their units: zeros where nothing else is said.
    """

    kind: str
    output: str
    inputs: tuple[str, ...]
    sampling_time: float
    nk: tuple[int, ...]
    b: tuple[np.ndarray, ...]
    a: np.ndarray = field(default_factory=lambda: ONE)
    f: tuple[np.ndarray, ...] = ()
    c: np.ndarray = field(default_factory=lambda: ONE)
    d: np.ndarray = field(default_factory=lambda: ONE)
    constant: float | None = None
    noise_std: float = 0.0
    covariance: np.ndarray | None = None
    samples: int = 0
    loss: float = np.nan
    history: str = ""
    focus: str = "prediction"
    units: Mapping[str, str] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    origins: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        def frozen(values: Any) -> np.ndarray:
            array = np.array(values, dtype=float)
            array.setflags(write=False)
            return array

        for name in ("a", "c", "d"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
        object.__setattr__(self, "b", tuple(map(frozen, self.b)))
        object.__setattr__(self, "f", tuple(map(frozen, self.f or [ONE] * len(self.inputs))))
        object.__setattr__(self, "origins", tuple(self.origins) or (0.0,) * (1 + len(self.inputs)))

    @property
    def label(self) -> str:
        """Kind and orders: ``arx(2, 2, 1)``; several inputs as ``arx(2, [2 1], [1 1])``."""
        nb, nf = [len(b) - k for b, k in zip(self.b, self.nk, strict=True)], [len(f) - 1 for f in self.f]
        orders: dict[str, Any] = {
            "arx": (len(self.a) - 1, nb, self.nk),
            "armax": (len(self.a) - 1, nb, len(self.c) - 1, self.nk),
            "output error": (nb, nf, self.nk),
            "box-jenkins": (nb, nf, len(self.c) - 1, len(self.d) - 1, self.nk),
        }
        shown = orders.get(self.kind, (len(self.a) - 1, nb, len(self.c) - 1, len(self.d) - 1, nf, self.nk))
        further = ["offset"] * (self.constant is not None) + ["simulation focus"] * (
            self.kind == "arx" and self.focus == "simulation"
        )
        return f"{self.kind}({', '.join([*map(_format_orders, shown), *further])})"

    @property
    def coefficients(self) -> dict[str, float]:
        """The estimated numbers by name, in the order of ``covariance``: a1 ..., b1 ..., f1 ..., c1 ..., d1 ..., constant.

        With several inputs ``b`` and ``f`` carry the input: ``b1[u]``.
        """
        several = len(self.inputs) > 1
        marks = [f"[{name}]" if several else "" for name in self.inputs]
        named = [(f"a{i}", v) for i, v in enumerate(self.a[1:], 1)]
        for b, nk, mark in zip(self.b, self.nk, marks, strict=True):
            named += [(f"b{i}{mark}", v) for i, v in enumerate(b[nk:], 1)]
        for f, mark in zip(self.f, marks, strict=True):
            named += [(f"f{i}{mark}", v) for i, v in enumerate(f[1:], 1)]
        named += [(f"c{i}", v) for i, v in enumerate(self.c[1:], 1)] + [
            (f"d{i}", v) for i, v in enumerate(self.d[1:], 1)
        ]
        if self.constant is not None:
            named.append(("constant", self.constant))
        return {name: float(value) for name, value in named}

    def with_coefficients(self, values: Sequence[float] | np.ndarray) -> PolynomialModel:
        """The same equation with other coefficients (p,), in the order of `coefficients`."""
        rest, nothing = iter(values), [np.zeros(nk) for nk in self.nk]

        def take(before: np.ndarray, size: int) -> np.ndarray:
            return np.append(before, [next(rest) for _ in range(size)])

        a = take(ONE, len(self.a) - 1)
        b = tuple(take(zeros, len(b) - len(zeros)) for zeros, b in zip(nothing, self.b, strict=True))
        f = tuple(take(ONE, len(f) - 1) for f in self.f)
        c, d = (take(ONE, len(each) - 1) for each in (self.c, self.d))
        constant = None if self.constant is None else float(next(rest))
        return replace(self, a=a, b=b, f=f, c=c, d=d, constant=constant, covariance=None)

    def in_units(self, scaling: Scaling) -> PolynomialModel:
        """The equation of numbers as that of the signals that they are the ``scaling`` of."""
        size, *sizes = scaling.sizes
        gains = [size / each for each in sizes]
        # b in output over input, the constant in the output; A, F, C and D are plain numbers.
        factors = [1.0] * (len(self.a) - 1)
        factors += [gain for gain, b, nk in zip(gains, self.b, self.nk, strict=True) for _ in b[nk:]]
        factors += [1.0] * (sum(len(f) - 1 for f in self.f) + len(self.c) + len(self.d) - 2)
        factors += [] if self.constant is None else [size]
        return replace(
            self,
            b=tuple(gain * b for gain, b in zip(gains, self.b, strict=True)),
            constant=None if self.constant is None else size * self.constant,
            noise_std=size * self.noise_std,
            covariance=None if self.covariance is None else self.covariance * np.outer(factors, factors),
            loss=size**2 * self.loss,
            origins=scaling.origins,
        )

    def from_zero(self) -> PolynomialModel:
        """The same equation with its ``constant`` about zero: where no ``F`` of their own divides them, of inputs too.

        Behind an integrator in an ``F`` an input's origin is a drift, which the constant passes ``F_1`` for: any other stays.
        """
        if self.constant is None or not any(self.origins):
            return self
        y0, *inputs = self.origins
        gain = self.f[0].sum()
        moved = [0.0 if i and len(f) > 1 else u0 for i, (u0, f) in enumerate(zip(inputs, self.f, strict=True))]
        # A (y - y0) = sum B / F (u - u0) + c / F_1: the constant is c + A(1) F_1(1) y0 - B_1(1) u0_1 - F_1(1) sum B_i(1) u0_i.
        factors = [1.0, *(gain for _ in inputs[1:])]
        shifts = [u0 * b.sum() for u0, b in zip(moved, self.b, strict=True)]
        shift = self.a.sum() * gain * y0 - sum(k * each for k, each in zip(factors, shifts, strict=True))
        covariance = self.covariance
        if covariance is not None:
            slopes = [gain * y0] * (len(self.a) - 1)
            for k, u0, b, nk in zip(factors, moved, self.b, self.nk, strict=True):
                slopes += [-k * u0] * (len(b) - nk)
            slopes += [self.a.sum() * y0 - sum(shifts[1:])] * (len(self.f[0]) - 1)
            jacobian = np.eye(len(covariance))
            jacobian[-1, : len(slopes)] = slopes
            covariance = jacobian @ covariance @ jacobian.T
        kept = (u0 - by for u0, by in zip(inputs, moved, strict=True))
        return replace(self, constant=self.constant + float(shift), covariance=covariance, origins=(0.0, *kept))

    @property
    def model(self) -> PlantModel:
        """The equation as a plant: `greybox.fit`, profiles and whatever takes a model take it, from these coefficients on."""
        return PlantModel.of(PolynomialPlant(self))

    @property
    def parameters(self) -> int:
        """Number of estimated coefficients."""
        return len(self.coefficients)

    @property
    def std(self) -> dict[str, float]:
        """Standard deviation of each coefficient; NaN where no covariance is known."""
        deviations = np.full(self.parameters, np.nan) if self.covariance is None else np.sqrt(np.diag(self.covariance))
        return dict(zip(self.coefficients, map(float, deviations), strict=True))

    @property
    def poles(self) -> np.ndarray:
        """Roots of ``A`` and of every ``F`` in the z-plane, largest first; a pole at z = 0 (pure delay) is left out."""
        return _roots(reduce(np.convolve, self.f, self.a))

    def zeros(self, name: str | None = None) -> np.ndarray:
        """Roots of ``B`` of one input (the only one if not named) in the z-plane, largest first, without those at z = 0."""
        return _roots(np.trim_zeros(self.b[self._input(name)], "f"))

    @property
    def stable(self) -> bool:
        """Whether every pole lies inside the unit circle."""
        return bool(np.all(np.abs(self.poles) < 1))

    @property
    def rest(self) -> float:
        """The output before a record that begins at rest."""
        return self.origins[0]

    @property
    def feedthrough(self) -> dict[str, float]:
        """Direct share of each input in the output of the same row, ``B(q)`` at delay zero: 0 where ``nk`` is at least 1."""
        return {name: float(b[0]) for name, b in zip(self.inputs, self.b, strict=True)}

    def gain(self, name: str | None = None) -> float:
        """Steady-state gain ``B(1) / (A(1) F(1))`` from one input (the only one if not named); infinite for an integrator."""
        i = self._input(name)
        # q = 1: the gain is the ratio of the sums of coefficients.
        below = float(self.a.sum() * self.f[i].sum())
        return float(self.b[i].sum()) / below if below else np.inf

    def response(self, frequency: np.ndarray, name: str | None = None) -> np.ndarray:
        """Frequency response (n,), complex, at ``frequency`` (n,) in Hz from one input (the only one if not named)."""
        i = self._input(name)
        shift = np.exp(-2j * np.pi * np.asarray(frequency, float) * self.sampling_time)
        b, a, f = (np.polyval(p[::-1], shift) for p in (self.b[i], self.a, self.f[i]))
        return b / (a * f)

    def simulate(
        self, experiment: Experiment, *, initial: InitialChoice = "estimated", rows: int | None = None
    ) -> dict[str, np.ndarray]:
        """Free run over the inputs of ``experiment``: ``{output: (N,)}``; no measured output is used beyond the initial state.

        ``initial``: ``"zero"``, every signal was at its origin before the first row; ``"measured"``, the first rows as measured, as many as
        the model has states; ``"estimated"``, the state that fits the first ``rows`` rows best (None: all rows).

        Raises DataError for an experiment of another sampling time, without an input, or without the measurements that
        ``initial`` needs. The run of an unstable model grows, up to infinity.
        """
        run = simulate_free_run(self, self._to_record(experiment, initial), initial, rows)
        return {self.output: self.origins[0] + run}

    def predict(
        self, experiment: Experiment, steps: int = 1, *, initial: InitialChoice = "estimated", rows: int | None = None
    ) -> dict[str, np.ndarray]:
        """Prediction ``yhat(k | k - steps)`` as ``{output: (N,)}`` from the measured outputs up to ``steps`` rows before.

        A value that was not measured is replaced by its own prediction. ``initial`` as in `simulate`, for the predictor's state;
        with ``"measured"`` the first rows, which have no history, are NaN. Raises DataError as `simulate` does, and for ``steps``
        below one.
        """
        if steps < 1:
            raise DataError(f"steps ahead: {steps}; give a whole number from 1")
        ahead, _ = predict_ahead(self, self._to_record(experiment, "measured"), steps, initial, rows)
        return {self.output: self.origins[0] + ahead}

    def errors(self, experiment: Experiment, *, initial: InitialChoice = "estimated") -> np.ndarray:
        """One-step prediction errors ``e`` (N,), NaN in gaps and where ``initial="measured"`` has no history."""
        return predict_ahead(self, self._to_record(experiment, "measured"), 1, initial, None)[1]

    def to_control(self) -> Any:
        """A discrete `control.TransferFunction` from the inputs to the output, with signal names and the sampling time."""
        import control

        below = [np.convolve(self.a, f) for f in self.f]
        # Filled up behind: B(q^-1) / A(q^-1) times the same power of z.
        size = max(map(len, [*self.b, *below]))  # the same power of z above and below
        padded = [[[np.pad(p, (0, size - len(p))) for p in group]] for group in (self.b, below)]
        return control.TransferFunction(
            *padded,
            self.sampling_time,
            inputs=list(self.inputs),
            outputs=[self.output],
            name=self.kind.replace(" ", "_"),
        )

    def _to_record(self, experiment: Experiment, initial: InitialChoice) -> SampledRecord:
        record = to_sampled_record(experiment, self.output, self.inputs, need_output=initial != "zero")
        if any(self.origins):
            y0, *inputs = self.origins
            signals = tuple(signal[:] - u0 for signal, u0 in zip(record.signals, inputs, strict=True))
            record = replace(record, y=record.y - y0, signals=signals)
        if not np.isclose(record.sampling_time, self.sampling_time, rtol=numerics.SAME_SAMPLING_TIME):
            raise DataError(
                f"experiment {experiment.name!r} is sampled every {record.sampling_time:.6g} s, but {self.label} of"
                f" {self.output!r} was identified at {self.sampling_time:.6g} s and is valid only there; resample the record"
            )
        return record

    def _input(self, name: str | None) -> int:
        if name is None and len(self.inputs) == 1:
            return 0
        if name not in self.inputs:
            problem = "which input?" if name is None else f"no input {name!r};"
            raise DataError(f"{self.label} of {self.output!r}: {problem} {nearest(name or '', self.inputs)}")
        return self.inputs.index(name)


@dataclass(frozen=True, eq=False)
class PolynomialPlant:
    """The free run of a difference equation as a plant (`greybox.simulation.plant.Plant`).

    Its constants are the coefficients that a free run shows; those of the noise model stay as they are. Its states are what the time before
    a record adds to it (`compute_initial_responses`).
    """

    equation: PolynomialModel

    cheap = discrete = True

    @property
    def name(self) -> str:
        """The kind, as an identifier."""
        return to_identifiers([self.equation.kind])[0]

    @property
    def description(self) -> str:
        """What it is, for people."""
        return self.equation.label

    @property
    def identity(self) -> str:
        """The equation."""
        return f"{self.equation.label} {self.equation.sampling_time} {self.equation.output} {self.equation.inputs}"

    @property
    def inputs(self) -> tuple[Input, ...]:
        """Those of the equation."""
        return tuple(Input(name, self.equation.units.get(name, "1")) for name in self.equation.inputs)

    @property
    def outputs(self) -> tuple[Output, ...]:
        """The one of the equation."""
        return (Output(self.equation.output, self.equation.units.get(self.equation.output, "1")),)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The coefficients, of one sampling time and of signals as they are: plain numbers."""
        values = self.equation.coefficients
        names = to_identifiers(list(values))
        return tuple(
            Parameter(name, "1", value, fixed=key[0] in "cd" and key != "constant", source=self.equation.label)
            for name, (key, value) in zip(names, values.items(), strict=True)
        )

    @cached_property
    def states(self) -> tuple[State, ...]:
        """One for each response to what was before the record."""
        longest = sum(map(len, (self.equation.a, *self.equation.b, *self.equation.f)))
        responses = np.hstack(
            compute_initial_responses(self.equation, longest, [len(self.equation.a)], self.equation.a)
        )
        unit = self.outputs[0].unit
        return tuple(State(f"before_{k + 1}", unit) for k in range(responses.shape[1]))

    def simulate(self, record: Experiment, values: Mapping[str, float]) -> dict[str, np.ndarray]:
        """The free run (N,). Raises DataError for a record of another sampling time."""
        equation = self.equation.with_coefficients([values[q.name] for q in self.parameters])
        sampled = equation._to_record(record, "zero")
        y = simulate_free_run(equation, sampled, "zero", None)
        past = np.array([values[state.name] for state in self.states])
        if past.any():
            with np.errstate(over="ignore", invalid="ignore"):
                _add_past(equation, y, lambda _: past)
        return {equation.output: equation.origins[0] + y}


def _format_orders(value: Any) -> str:
    if not isinstance(value, (list, tuple)):
        return str(value)
    return str(value[0]) if len(value) == 1 else f"[{' '.join(map(str, value))}]"


def _roots(polynomial: np.ndarray) -> np.ndarray:
    """Roots in z of a polynomial in ``q^-1``, largest first, those at the origin left out."""
    # Zeros at the end are roots at the origin, pure delay; without them the first coefficient stands for the highest
    # power.
    roots = np.roots(np.trim_zeros(polynomial, "b"))
    return roots[np.argsort(-np.abs(roots), kind="stable")]


# Which coefficients a difference equation has, and their positions in one vector.


@dataclass(frozen=True)
class PolynomialStructure:
    """Orders of ``A y = sum B / F u + constant / F_1 + C / D e``: those of ``A`` and ``B``, ``nf`` of each input, ``nc``, ``nd``."""

    kind: str
    orders: Orders
    nf: tuple[int, ...]
    nc: int = 0
    nd: int = 0
    offset: bool = False

    @property
    def sizes(self) -> tuple[int, ...]:
        """Lengths of the parts of the vector: a, each b, each f, c, d, constant."""
        return (self.orders.na, *self.orders.nb, *self.nf, self.nc, self.nd, int(self.offset))

    @property
    def size(self) -> int:
        """Number of coefficients."""
        return sum(self.sizes)

    def parts(self, theta: np.ndarray) -> list[np.ndarray]:
        """``theta`` (p,) cut into a, each b, each f, c, d, constant."""
        return np.split(theta, np.cumsum(self.sizes)[:-1])

    def model(self, theta: np.ndarray, data: SampledData) -> PolynomialModel:
        """The coefficients (p,) as a model of the output of ``data``."""
        n = len(self.nf)
        a, *rest = self.parts(theta)
        b, f, (c, d, constant) = rest[:n], rest[n : 2 * n], rest[2 * n :]
        return PolynomialModel(
            kind=self.kind,
            output=data.output,
            inputs=data.inputs,
            sampling_time=data.sampling_time,
            nk=self.orders.nk,
            a=to_monic(a),
            b=tuple(np.append(np.zeros(k), part) for k, part in zip(self.orders.nk, b, strict=True)),
            f=tuple(map(to_monic, f)),
            c=to_monic(c),
            d=to_monic(d),
            constant=float(constant[0]) if self.offset else None,
        )

    def vector(self, model: PolynomialModel) -> np.ndarray:
        """The coefficients (p,) of ``model``; polynomials that are shorter there are filled up with zeros."""
        padded = [_padded(model.a[1:], self.orders.na)]
        padded += [_padded(b[k:], n) for b, k, n in zip(model.b, self.orders.nk, self.orders.nb, strict=True)]
        padded += [_padded(f[1:], n) for f, n in zip(model.f, self.nf, strict=True)]
        padded += [_padded(model.c[1:], self.nc), _padded(model.d[1:], self.nd)]
        return np.concatenate([*padded, [model.constant or 0.0] if self.offset else []])


def to_monic(rest: Sequence[float] | np.ndarray) -> np.ndarray:
    """``1 + p1 q^-1 + ...`` from ``p1 ...``."""
    return np.append(1.0, rest)


def to_order(letter: str, value: int, kind: str) -> int:
    """``value`` as an order; DataError where it is not a whole number from 0."""
    if int(value) != value or value < 0:
        raise DataError(f"{kind}: {letter} = {value}; give a whole number from 0")
    return int(value)


def _padded(values: np.ndarray, size: int) -> np.ndarray:
    return np.append(values[:size], np.zeros(max(size - len(values), 0)))


# Free runs and predictions of a difference equation, and what its unknown past adds to them.


def simulate_free_run(
    model: PolynomialModel, record: SampledRecord, initial: InitialChoice, rows: int | None
) -> np.ndarray:
    """Output (N,) of ``A y = sum B / F u + constant / F_1`` from the ``initial`` state."""
    _check_initial(initial)
    with np.errstate(over="ignore", invalid="ignore"):
        # A y = sum B / F u + constant / F_1, hence y = sum B / (A F) u + constant / (A F_1)
        y = _drive(model, record, ONE, model.a, initial == "zero")
        if initial == "zero":
            return y
        # Errors of free runs are what this state is allowed to add.
        error = model.noise_std if model.focus == "simulation" else 0.0
        _add_past(model, y, lambda free: estimate_initial_state(free, record.y, y, initial, rows, error))
        return y


def _add_past(model: PolynomialModel, y: np.ndarray, find_shares: Callable[[np.ndarray], np.ndarray]) -> None:
    """Add to a free run (N,) what the time before it adds, by its shares (m,) of the responses to that time (k, m)."""
    memory = count_rows_of_memory(model, len(y), model.a)
    free = np.hstack(compute_initial_responses(model, memory, [len(model.a)], model.a))
    y[:memory] += free @ find_shares(free)


def predict_ahead(
    model: PolynomialModel, record: SampledRecord, steps: int, initial: InitialChoice, rows: int | None
) -> tuple[np.ndarray, np.ndarray]:
    """``yhat(k | k - steps)`` (N,), the measurement less the last ``steps`` innovations' share in it, and the innovations (N,).

    ``e = D / C (A y - sum B / F u - constant / F_1)``. Where nothing was measured the innovation is zero and the prediction takes the
    measurement's place. With ``initial="measured"`` the rows without a history are NaN.
    """
    _check_initial(initial)
    alpha, gaps = np.convolve(model.a, model.d), np.isnan(record.y)
    responses = in_gaps = np.empty((0, 0))
    with np.errstate(over="ignore", invalid="ignore"):
        driven = _drive(model, record, model.d, ONE, initial == "zero")
        e, filled = _innovations(alpha, model.c, gaps, record.y, driven[:, None])
        if initial != "zero":
            # In a gap what was before the record lives on in the value that takes the measurement's place, as long as A and D have it.
            memory = count_rows_of_memory(model, record.rows, model.c, *[alpha] * bool(gaps.any()))
            past = np.hstack(compute_initial_responses(model, memory, [len(alpha), len(model.c)]))
            responses, in_gaps = _innovations(alpha, model.c, gaps[:memory], np.zeros(memory), past)
        memory = len(responses)
        state = estimate_initial_state(-responses, e[:, 0], np.zeros(memory), initial, rows)
        innovation, complete = e[:, 0], filled[:, 0]
        innovation[:memory] += responses @ state
        if gaps.any():
            complete[:memory] += in_gaps @ state
        # y(k) less the part of e(k), ..., e(k - steps + 1): the first ``steps`` coefficients of C / (A D) (Ljung
        # 1999, section 3.2).
        share = BlockFilter(lfilter(model.c, alpha, np.eye(1, steps)[0]), ONE)
        ahead = np.empty(record.rows)
        for part in each_block(record.rows):
            ahead[part] = complete[part] - share(innovation[part])
    innovation[gaps] = np.nan
    if initial == "measured":
        without_history = np.flatnonzero(~gaps[: len(state) + int(gaps.sum())])[: len(state)]
        innovation[without_history] = np.nan
        ahead[: without_history.max(initial=-1) + 1] = np.nan
    return ahead, innovation


def _drive(
    model: PolynomialModel, record: SampledRecord, above: np.ndarray, below: np.ndarray, rest: bool
) -> np.ndarray:
    """``sum B / F u + constant / F_1`` behind the filter ``above / below`` (N,), all from ``rest`` but the constant."""
    driven = np.empty(record.rows)
    course, constant = ConstantCourse(model.f[0] if model.f else ONE, rest), BlockFilter(above, below)
    inputs = [BlockFilter(np.convolve(b, above), np.convolve(below, f)) for b, f in zip(model.b, model.f, strict=True)]
    for part in each_block(record.rows):
        driven[part] = constant((model.constant or 0.0) * course(part.stop - part.start))
        for through, signal in zip(inputs, record.signals, strict=True):
            driven[part] += through(signal[part])
    return driven


@dataclass(eq=False)
class ConstantCourse:
    """``1 / F`` of a constant one, block by block: from the first row on, or of one that had always been there, at ``rest``."""

    f: np.ndarray
    rest: bool

    def __post_init__(self) -> None:
        self.through = BlockFilter(ONE, self.f)

    def __call__(self, rows: int) -> np.ndarray:
        """The next block."""
        return np.full(rows, 1.0 / self.f.sum()) if self.rest else self.through(np.ones(rows))


def count_rows_of_memory(model: PolynomialModel, rows: int, *through: np.ndarray) -> int:
    """Rows after which what was before the record is forgotten, at most ``rows``: by then the slowest root has faded, of every ``F`` and of
    the polynomials that errors or outputs pass ``through``."""
    slowest = max((float(np.abs(np.roots(p)).max(initial=0.0)) for p in (*through, *model.f)), default=0.0)
    longest = max(len(model.a) + len(model.d), len(model.c), *(len(b) + len(model.d) for b in model.b)) + len(model.d)
    if slowest <= 0:
        return min(rows, longest)
    if slowest >= 1:
        return rows
    # Half as long again, for roots of several filters that meet.
    return int(min(rows, longest + 10 + 1.5 * np.log(numerics.FADED_RESPONSE) / np.log(slowest)))


def compute_initial_responses(
    model: PolynomialModel, rows: int, reach: Sequence[int], through: Sequence[float] | np.ndarray = (1.0,)
) -> list[np.ndarray]:
    """What everything before the first row can add to ``A y``: for each input the responses ``q^-j / F`` (N, m).

    ``reach``: lengths of the polynomials through which past outputs and errors act; the responses are those behind the filter
    ``1 / through``. Inputs of one ``F`` share theirs, which stand with the first of them.
    """
    counts: dict[tuple[float, ...], int] = {}
    for b, f in zip(model.b, model.f, strict=True):
        longest = max(len(b) + len(model.d) - 1, *(n + len(f) - 1 for n in reach)) - 1
        # Inputs with the same F respond alike to their past: together they have one set of states, the longest of
        # them.
        counts[tuple(f)] = max(counts.get(tuple(f), 0), min(longest, rows))
    blocks = []
    for f in model.f:
        response = lfilter([1.0], np.convolve(through, f), np.eye(1, rows)[0])
        count = counts.pop(tuple(f), 0)
        blocks.append(np.column_stack([np.empty((rows, 0)), *(delay_rows(response, j) for j in range(count))]))
    return blocks


# How much larger than on the rows that tell it the rest of a record may show a part of the initial state.
LARGEST_AMPLIFICATION = 10.0


def estimate_initial_state(
    free: np.ndarray,
    measured: np.ndarray,
    run: np.ndarray,
    initial: InitialChoice,
    rows: int | None,
    error: float = 0.0,
) -> np.ndarray:
    """Shares (m,) of the free responses (k, m), over after k rows, that meet ``measured - run`` (N,), NaN in gaps, on the first rows.

    ``"measured"`` meets as many rows as there are responses exactly; ``"estimated"`` the first ``rows`` by least squares (None: all),
    doubled as `lengthen_first_rows` does. A direction that these rows barely determine is left at zero: one that the rest of the record
    would show more than `LARGEST_AMPLIFICATION` times larger than these rows, and larger than the ``error`` that its run has anyway.
    """
    if not free.shape[1]:
        return np.zeros(0)
    memory = len(free)
    target = measured[:memory] - run[:memory]
    # Responses of an unstable predictor grow beyond what least squares can tell apart.
    bounded = np.all(np.abs(free) < numerics.FREE_RESPONSE_GROWTH, axis=1)
    usable = np.isfinite(target) & bounded
    if initial == "measured":
        first = usable & (np.cumsum(usable) <= free.shape[1])
        return np.linalg.lstsq(free[first], target[first], rcond=None)[0]
    if rows is not None:
        rows = lengthen_first_rows(np.where(usable[:, None], free, 0.0), rows)
        usable[rows:] = False
    # Rows behind the memory have no response, and count.
    later = slice(memory, rows)
    count = int(usable.sum()) + int(np.isfinite(measured[later]).sum())
    if not count:
        return np.zeros(free.shape[1])
    # Coordinates of responses that are of unit size, rms, over the whole record.
    back = find_orthogonal_directions(free[bounded]) * np.sqrt(len(measured) - np.count_nonzero(~bounded))
    seen, wanted = free[usable] @ back / np.sqrt(count), target[usable] / np.sqrt(count)
    u, s, v = np.linalg.svd(seen, full_matrices=False)
    # Coordinates of unit size over the whole record: a small singular value on the first rows is what the rest would
    # amplify.
    amplification = LARGEST_AMPLIFICATION
    spare = count - len(s)
    if error and spare > len(s):
        # What no state explains on these rows is all that there is to amplify.
        unexplained = np.linalg.norm(wanted - u @ (u.T @ wanted)) * np.sqrt(count / spare)
        amplification = max(amplification, error / max(unexplained, numerics.TINY))
    shown = s * amplification > 1
    z = v[shown].T @ (u[:, shown].T @ wanted / s[shown])
    return back @ z


def find_orthogonal_directions(responses: np.ndarray) -> np.ndarray:
    """Directions (m, d) along which ``responses`` (k, m) are orthonormal, without those that are lost in rounding.

    Fewer rows than responses, where these grow fast, tell of as many directions alone.
    """
    # With A = Q R and R = U S V', A (V / S) = Q U has orthonormal columns.
    _, size, right = np.linalg.svd(np.linalg.qr(responses, mode="r"), full_matrices=False)
    significant = size > numerics.NEGLIGIBLE_SINGULAR_VALUE * size[0]
    return right[significant].T / size[significant]


def lengthen_first_rows(responses: np.ndarray, rows: int) -> int:
    """The first ``rows``, doubled until they hold `INITIAL_STATE_SHARE` of what all rows tell of an initial state along every direction.

    As many as a physical model gets. ``responses``: the responses (k, m) to the state, zero where nothing was measured.
    """
    if not responses.any():
        return rows
    # Coordinates in which the information of all rows, seen' seen, is the identity.
    seen = responses @ find_orthogonal_directions(responses)
    while rows < len(responses) and np.linalg.norm(seen[:rows].T @ seen[:rows], -2) < INITIAL_STATE_SHARE:
        rows = 2 * rows or 1
    return rows


def _innovations(
    alpha: np.ndarray, c: np.ndarray, gaps: np.ndarray, y: np.ndarray, driven: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """``C e = alpha y - driven`` for every column of ``driven`` (N, m), and of ``y`` (N,); e and y (N, m).

    In ``gaps`` (N,) of ``y`` the innovation is zero and ``y`` what follows from that. ``driven`` may hold e then.
    """
    if not gaps.any():
        measured, through = BlockFilter(alpha, ONE), BlockFilter(ONE, c)
        for part in each_block(len(y)):
            driven[part] = through(measured(y[part])[:, None] - driven[part])
        return driven, np.broadcast_to(y[:, None], driven.shape)
    before = max(len(alpha), len(c)) - 1
    e, filled = np.zeros((2, before + len(y), driven.shape[1]))
    for k in range(before, before + len(y)):
        moving_average = sum(c[j] * e[k - j] for j in range(1, len(c)))
        regression = sum(alpha[j] * filled[k - j] for j in range(1, len(alpha)))
        expected = driven[k - before] + moving_average - regression
        if gaps[k - before]:
            filled[k] = expected
        else:
            filled[k] = y[k - before]
            e[k] = filled[k] - expected
    return e[before:], filled[before:]


def _check_initial(initial: str) -> None:
    if initial not in get_args(InitialChoice):
        raise DataError(f"unknown initial state {initial!r}; {nearest(initial, get_args(InitialChoice))}")
