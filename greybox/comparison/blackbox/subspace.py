"""Subspace identification: a state-space model of several inputs and outputs without a search.

The combined algorithm of Van Overschee and De Moor (Subspace Identification for Linear Systems, 1996, chapter 4): what past inputs and
outputs say of future outputs, given the future inputs, is an oblique projection whose rank is the order. With the weights of N4SID
(none) or CVA (canonical variates). From the observability matrix come A and C; B, D and the first states follow by least squares of
the simulated output, and the gain of the predictor from the covariance of the residuals.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NoReturn

import numpy as np
from scipy.signal import lfilter

from greybox.base import numerics
from greybox.base.errors import DataError, ModelError, nearest
from greybox.base.values import Finding, Printable
from greybox.comparison.blackbox.linear_regression import SampledRecord, Scaling, find_mean, to_sampled_record
from greybox.comparison.blackbox.polynomial import InitialChoice, estimate_initial_state
from greybox.data.experiment import Experiment, as_records

WEIGHTS = ("cva", "n4sid")


@dataclass(frozen=True, eq=False)
class StateSpaceModel(Printable):
    """``x[k+1] = A x[k] + B (u[k] - origin) + K e[k]``, ``y[k] = C x[k] + D (u[k] - origin) + offset + e[k]``.

    Attributes
    ----------
    inputs, outputs
        Names of the signals.
    sampling_time
        Seconds.
    A, B, C, D, K
        Matrices (n, n), (n, nu), (ny, n), (ny, nu), (n, ny).
    noise_covariance
        Covariance (ny, ny) of ``e``.
    origin
        What the inputs are measured from (nu,): their means over the records.
    offset
        The outputs (ny,) at rest under these inputs.
    singular_values
        Of the projection: where they fall is the order.
    weight
        ``cva`` or ``n4sid``.
    samples
        Rows that were used.
    """

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    sampling_time: float
    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    K: np.ndarray
    noise_covariance: np.ndarray
    origin: np.ndarray
    offset: np.ndarray
    singular_values: np.ndarray
    weight: str
    samples: int

    @property
    def order(self) -> int:
        """Number of states."""
        return len(self.A)

    @property
    def poles(self) -> np.ndarray:
        """Eigenvalues of ``A`` in the z-plane, by size."""
        poles = np.linalg.eigvals(self.A)
        return poles[np.argsort(-np.abs(poles))]

    @property
    def stable(self) -> bool:
        """Whether every pole lies inside the unit circle."""
        return bool(np.all(np.abs(self.poles) < 1))

    def response(self, frequency: np.ndarray) -> np.ndarray:
        """Complex response (nf, ny, nu) at frequencies (nf,) in Hz."""
        # G = C (z I - A)^-1 B + D
        z = np.exp(2j * np.pi * np.asarray(frequency) * self.sampling_time)
        whole = np.linalg.solve(
            z[:, None, None] * np.eye(self.order) - self.A, np.broadcast_to(self.B, (len(z), *self.B.shape))
        )
        return np.asarray(self.C @ whole + self.D)

    @property
    def model(self) -> NoReturn:
        """None: as a plant it would have constants of its own. Raises ModelError."""
        raise ModelError(
            f"{self.weight} model of order {self.order}: its matrices are known up to a change of its states, so that none of their entries"
            " is a constant that could be fitted; fit greybox.blackbox.output_error of one output instead"
        )

    def boxes(self) -> tuple[SubspaceOutput, ...]:
        """One model for each output, as `greybox.compare` takes them."""
        return tuple(SubspaceOutput(self, name) for name in self.outputs)

    def to_control(self) -> Any:
        """A ``control.StateSpace`` with signal names."""
        import control

        return control.StateSpace(
            self.A, self.B, self.C, self.D, self.sampling_time, inputs=list(self.inputs), outputs=list(self.outputs)
        )


@dataclass(frozen=True, eq=False)
class SubspaceOutput:
    """One output of a `StateSpaceModel`, with what every black box has."""

    model: StateSpaceModel
    output: str
    kind: str = field(default="subspace", init=False)
    history: str = field(default="estimated", init=False)
    findings: tuple[Finding, ...] = field(default=(), init=False)

    @property
    def label(self) -> str:
        """Kind and order: ``cva(4)``."""
        return f"{self.model.weight}({self.model.order})"

    @property
    def sampling_time(self) -> float:
        """Seconds."""
        return self.model.sampling_time

    @property
    def parameters(self) -> int:
        """Numbers of a canonical form, shared evenly by the outputs."""
        m = self.model
        whole = m.order * (len(m.inputs) + 2 * len(m.outputs)) + len(m.inputs) * len(m.outputs) + len(m.outputs)
        return round(whole / len(m.outputs))

    @property
    def stable(self) -> bool:
        """Whether every pole lies inside the unit circle."""
        return self.model.stable

    @cached_property
    def feedthrough(self) -> Mapping[str, float]:
        """Input -> what it adds to the output at once."""
        row = self.model.D[self.model.outputs.index(self.output)]
        return {name: float(v) for name, v in zip(self.model.inputs, row, strict=True)}

    def simulate(
        self, experiment: Experiment, *, initial: InitialChoice = "estimated", rows: int | None = None
    ) -> dict[str, np.ndarray]:
        """Free run over a record.

        Parameters
        ----------
        experiment
            The record.
        initial
            ``zero``, or the state that the first ``rows`` (None: all) of the measured outputs show.
        rows
            Rows that show it.

        Returns
        -------
        dict
            Output -> values (N,).
        """
        u, y = _take_arrays(self.model, experiment)
        x0 = np.zeros(self.model.order) if initial == "zero" else _estimate_start(self.model, u, y, rows)
        return {self.output: _simulate(self.model, u, x0)[:, self.model.outputs.index(self.output)]}

    def predict(
        self, experiment: Experiment, steps: int = 1, *, initial: InitialChoice = "estimated", rows: int | None = None
    ) -> dict[str, np.ndarray]:
        """Predictions ``steps`` samples ahead.

        Parameters
        ----------
        experiment
            The record.
        steps
            Samples ahead.
        initial, rows
            As of `simulate`.

        Returns
        -------
        dict
            Output -> values (N,).
        """
        m = self.model
        u, y = _take_arrays(m, experiment)
        x = np.zeros(m.order) if initial == "zero" else _estimate_start(m, u, y, rows)
        column = m.outputs.index(self.output)
        result = np.full(len(u), np.nan)
        for k in range(len(u)):
            ahead = x
            for j in range(min(steps - 1, len(u) - 1 - k)):
                ahead = m.A @ ahead + m.B @ u[k + j]
            if k + steps - 1 < len(u):
                result[k + steps - 1] = (m.C @ ahead + m.D @ u[k + steps - 1] + m.offset)[column]
            if k == 0:
                first = x
                for j in range(min(steps - 1, len(u))):
                    result[j] = (m.C @ first + m.D @ u[j] + m.offset)[column]
                    first = m.A @ first + m.B @ u[j]
            # x+ = A x + B u + K e; without a measurement e counts as zero.
            e = y[k] - m.C @ x - m.D @ u[k] - m.offset
            x = m.A @ x + m.B @ u[k] + m.K @ np.where(np.isfinite(e), e, 0.0)
        return {self.output: result}


# Highest order that is chosen by itself.
LARGEST_ORDER = 20
# A singular value below this share of the first is rounding: records without noise show their order so.
ZERO_SHARE = 1e-06


def subspace(
    experiments: Experiment | Sequence[Experiment],
    order: int | None = None,
    *,
    outputs: Sequence[str] | None = None,
    inputs: Sequence[str] | None = None,
    weight: str = "cva",
    feedthrough: bool = True,
) -> StateSpaceModel:
    """Identify a state-space model of several inputs and outputs.

    Parameters
    ----------
    experiments
        Records of one sampling time; gaps are left out.
    order
        Number of states; None takes that of the smallest criterion on the singular values.
    outputs, inputs
        Names; None takes all.
    weight
        ``cva`` or ``n4sid``.
    feedthrough
        Whether an input may act on an output at once.

    Returns
    -------
    StateSpaceModel
        The model; its `boxes` can be compared with others.

    Raises
    ------
    DataError
        For unknown names, records that are too short, and an order beyond what past and future can show.

    Examples
    --------
    >>> model = gb.blackbox.subspace(records)  # doctest: +SKIP
    >>> gb.compare({"physics": fit, "subspace": model.boxes()}, validation)  # doctest: +SKIP
    """
    group = as_records(experiments)
    if not group:
        raise DataError("no experiment; give at least one record")
    if weight not in WEIGHTS:
        raise DataError(f"unknown weight {weight!r}; {nearest(weight, WEIGHTS)}")
    return _RecordProjection.of(
        group, tuple(outputs or group[0].outputs), tuple(inputs or group[0].inputs), order, weight
    ).identify(order, feedthrough)


def scan_orders(
    experiments: Sequence[Experiment], outputs: Sequence[str], inputs: Sequence[str]
) -> Iterator[StateSpaceModel]:
    """Models of every order that the records support, with the weights of N4SID and of CVA. Raises DataError as `subspace` does."""
    for weight in WEIGHTS:
        projection = _RecordProjection.of(experiments, tuple(outputs), tuple(inputs), None, weight)
        for order in range(1, projection.most + 1):
            yield projection.identify(order)


@dataclass(frozen=True, eq=False)
class _RecordProjection:
    """The observability matrix of records by its columns, the most important first, and what a model of some order is made of."""

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    sampling_time: float
    scaling: Scaling
    parts: Sequence[tuple[np.ndarray, np.ndarray]]
    horizon: int
    weight: str
    observability: np.ndarray
    singular: np.ndarray
    columns: int

    @classmethod
    def of(
        cls,
        group: Sequence[Experiment],
        outputs: tuple[str, ...],
        inputs: tuple[str, ...],
        order: int | None,
        weight: str,
    ) -> _RecordProjection:
        """That of the records; ``order``: the one that is wanted."""
        recorded, step = _collect_segments(group, outputs, inputs)
        if not recorded:
            raise DataError(
                f"no row in which {', '.join(outputs)} were all measured; give records that have them together"
            )
        # A movement of one each, about zero: what is negligible must not hang on units.
        signals = [
            [each[k][:, j] for each in recorded] for k, names in ((1, outputs), (0, inputs)) for j in range(len(names))
        ]
        scaling = Scaling.of(signals, [find_mean(records) for records in signals])
        ny, nu = len(outputs), len(inputs)
        y0, u0 = np.split(np.array(scaling.origins), [ny])
        y_size, u_size = np.split(np.array(scaling.sizes), [ny])
        parts = [((u - u0) / u_size, (y - y0) / y_size) for u, y in recorded]
        rows = max((len(u) for u, _ in parts), default=0)
        wanted = max(SUBSPACE_HORIZON, 2 * (order or 0) // ny + 2)
        # Every projection has to be overdetermined.
        most = (rows + 1) // (COLUMNS_PER_ROW * (2 * ny + 2 * nu) + 2)
        if most < LEAST_HORIZON:
            raise DataError(
                f"{rows} rows without a gap are too few for {ny} outputs and {nu} inputs; give longer records"
            )
        horizon = min(wanted, most)
        observability, singular, columns = _project(parts, horizon, weight)
        return cls(inputs, outputs, step, scaling, parts, horizon, weight, observability, singular, columns)

    @property
    def most(self) -> int:
        """The highest order that is tried."""
        return min(LARGEST_ORDER, len(self.outputs) * (self.horizon - 1), len(self.singular) - 1)

    def choose_order(self) -> int:
        """That of the smallest criterion on the singular values."""
        ny, nu, singular = len(self.outputs), len(self.inputs), self.singular
        # Singular value criterion: the first one left out, plus a BIC-like price for the parameters of a model of order n.
        price = np.log(self.columns) / self.columns
        costs = [singular[n] ** 2 + price * (2 * n * ny + n * nu + nu * ny) for n in range(1, self.most + 1)]
        # Without noise the values fall to rounding, where no criterion is needed, nor sound.
        noise_free = singular[1 : self.most + 1] < ZERO_SHARE * singular[0]
        return 1 + (int(np.argmax(noise_free)) if noise_free.any() else int(np.argmin(costs)))

    def identify(self, order: int | None, feedthrough: bool = True) -> StateSpaceModel:
        """The model of this order (None: `choose_order`). Raises DataError for one that past and future cannot show."""
        ny, nu, n = len(self.outputs), len(self.inputs), order or self.choose_order()
        if not 1 <= n <= ny * (self.horizon - 1):
            raise DataError(
                f"order {n}: with {ny} outputs and a horizon of {self.horizon} rows give 1 to {ny * (self.horizon - 1)}"
            )
        # Gamma = [C; CA; CA^2; ...]: its first block row is C, and a shift by one block row is A.
        observability = self.observability[:, :n]
        C = observability[:ny]
        A = confine_modes(np.linalg.lstsq(observability[:-ny], observability[ny:], rcond=None)[0])
        B, D, offset = _estimate_inputs(self.parts, A, C, nu, feedthrough)
        names = self.inputs, self.outputs
        model = StateSpaceModel(
            *names,
            self.sampling_time,
            A,
            B,
            C,
            D,
            np.zeros((n, ny)),
            np.eye(ny),
            np.zeros(nu),
            offset,
            self.singular,
            self.weight,
            self.columns,
        )
        # Last: it takes the free run of the model as it stands.
        K, noise = _estimate_gain(model, self.parts, self.horizon)
        y0, u0 = np.split(np.array(self.scaling.origins), [ny])
        y_size, u_size = np.split(np.array(self.scaling.sizes), [ny])
        return replace(
            model,
            B=B / u_size,
            C=y_size[:, None] * C,
            D=y_size[:, None] * D / u_size,
            K=K / y_size,
            noise_covariance=noise * np.outer(y_size, y_size),
            origin=u0,
            offset=y0 + y_size * offset,
        )


def confine_modes(A: np.ndarray) -> np.ndarray:
    """``A`` (n, n) with its eigenvalues on or outside the unit circle moved radially to just inside: a free run must not grow."""
    values, vectors = np.linalg.eig(A)
    size = np.abs(values)
    if np.all(size <= 1 - numerics.CONFINED_ROOT_MARGIN):
        return A
    confined = values * np.minimum(1.0, (1 - numerics.CONFINED_ROOT_MARGIN) / np.maximum(size, numerics.TINY))
    if np.linalg.cond(vectors) > 1 / np.sqrt(np.finfo(float).eps):
        # Modes that are nearly one have no directions of their own: all are slowed alike.
        return A * ((1 - numerics.CONFINED_ROOT_MARGIN) / size.max())
    return np.asarray(np.real(vectors @ np.diag(confined) @ np.linalg.inv(vectors)))


def _collect_segments(
    group: Sequence[Experiment], outputs: Sequence[str], inputs: Sequence[str]
) -> tuple[list[tuple[np.ndarray, np.ndarray]], float]:
    """Inputs (N, nu) and outputs (N, ny) of each part without gaps, and the sampling time."""
    parts, steps = [], []
    for e in group:
        for name in outputs:
            if name not in e.outputs:
                raise DataError(f"experiment {e.name!r} has no output {name!r}; {nearest(name, e.outputs)}")
        record: SampledRecord = to_sampled_record(e, outputs[0], inputs, need_output=False)
        y = np.column_stack([e.outputs[name] for name in outputs])
        known = np.flatnonzero(np.isfinite(y).all(axis=1))
        runs = np.split(known, np.flatnonzero(np.diff(known) > 1) + 1) if len(known) else []
        parts += [(record.u[r], y[r]) for r in runs]
        steps.append(record.sampling_time)
    if not np.allclose(steps, steps[0], rtol=numerics.SAME_SAMPLING_TIME, atol=0):
        raise DataError("experiments of different sampling times; a state-space model is valid for one; resample them")
    return parts, steps[0]


# Rows of past and of future: several times the order over the number of outputs.
SUBSPACE_HORIZON = 15
# Fewest rows of past and of future that show a state.
LEAST_HORIZON = 3
# Columns of the data matrices for each of their rows, at least: fewer and noise is projected as well.
COLUMNS_PER_ROW = 3


def _project(
    parts: Sequence[tuple[np.ndarray, np.ndarray]], horizon: int, weight: str
) -> tuple[np.ndarray, np.ndarray, int]:
    """Observability matrix by columns, singular values, and the number of columns behind them."""
    blocks = [_stack(u, y, horizon) for u, y in parts if len(u) >= 2 * horizon]
    past_u, past_y, next_u, next_y = (np.hstack([b[k] for b in blocks]) for k in range(4))
    columns = past_u.shape[1]
    # [U_f; W_p; Y_f] = L Q'
    lower = np.asarray(np.linalg.qr(np.vstack([next_u, past_u, past_y, next_y]).T / np.sqrt(columns), mode="r")).T
    m, w = len(next_u), len(past_u) + len(past_y)
    # R-factor in place of the data: everything below is a function of their products, whose squares would cost half
    # the digits.
    l22, l32, l33 = lower[m : m + w, m : m + w], lower[m + w :, m : m + w], lower[m + w :, m + w :]
    if weight == "n4sid":
        # Oblique projection, as a map of W_p less U_f.
        l21 = lower[m : m + w, :m]
        # Y_f /_{U_f} W_p: the part of Y_f along W_p, the future inputs taken out obliquely.
        along = l32 @ np.linalg.pinv(l22, rcond=numerics.RANK_OF_EXACT_RECORDS)
        target = along @ np.hstack([l21, l22])
        u, s, _ = np.linalg.svd(target, full_matrices=False)
        return u * np.sqrt(s), s, columns
    spread = np.linalg.cholesky(
        l32 @ l32.T + l33 @ l33.T + np.finfo(float).eps * np.trace(l32 @ l32.T) * np.eye(len(l32))
    )
    # CVA: singular values are canonical correlations of past and future, so that the units of outputs do not matter.
    u, s, _ = np.linalg.svd(np.linalg.solve(spread, l32), full_matrices=False)
    return spread @ (u * np.sqrt(s)), s, columns


def _stack(u: np.ndarray, y: np.ndarray, horizon: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Block Hankel matrices: past inputs, past outputs, future inputs, future outputs."""
    columns = len(u) - 2 * horizon + 1

    def hankel(values: np.ndarray, first: int) -> np.ndarray:
        return np.vstack([values[first + k : first + k + columns].T for k in range(horizon)])

    # A constant counts as one more known input: what the outputs rest at is no state.
    known = np.vstack([hankel(u, horizon), np.ones((1, columns))])
    return hankel(u, 0), hankel(y, 0), known, hankel(y, horizon)


def _estimate_inputs(
    parts: Sequence[tuple[np.ndarray, np.ndarray]], A: np.ndarray, C: np.ndarray, nu: int, feedthrough: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """B, D and the constants of the outputs, by least squares of the simulated output; each part has first states of its own."""
    n, ny = len(A), len(C)
    modes, transform = np.linalg.eig(A)
    outputs = C @ transform
    rows, targets = [], []
    for number, (u, y) in enumerate(parts):
        N = len(u)
        # In modal coordinates each state is a filter of its own, z_i^k and 1 / (z - z_i): columns of B come by
        # linear least squares.
        free = modes[None, :] ** np.arange(N)[:, None]
        starts = np.zeros((N, ny, n * len(parts)), complex)
        starts[:, :, number * n : (number + 1) * n] = outputs[None] * free[:, None, :]
        driven = np.zeros((N, ny, n, nu), complex)
        for i in range(n):
            for j in range(nu):
                response = lfilter([0.0, 1.0], [1.0, -modes[i]], u[:, j].astype(complex))
                driven[:, :, i, j] = outputs[None, :, i] * response[:, None]
        at_once = np.zeros((N, ny, ny, nu))
        constant = np.zeros((N, ny, ny))
        for o in range(ny):
            at_once[:, o, o, :] = u
            constant[:, o, o] = 1.0
        blocks = [driven.reshape(N * ny, n * nu), starts.reshape(N * ny, -1), constant.reshape(N * ny, ny)]
        if feedthrough:
            blocks.append(at_once.reshape(N * ny, ny * nu))
        rows.append(np.hstack(blocks))
        targets.append(y.reshape(N * ny))
    matrix, target = np.vstack(rows), np.concatenate(targets)
    solution = np.linalg.lstsq(matrix, target.astype(complex), rcond=None)[0]
    B = np.real(transform @ solution[: n * nu].reshape(n, nu))
    place = n * nu + n * len(parts)
    offset = np.real(solution[place : place + ny])
    D = np.real(solution[place + ny :].reshape(ny, nu)) if feedthrough else np.zeros((ny, nu))
    return B, D, offset


def _estimate_gain(
    model: StateSpaceModel, parts: Sequence[tuple[np.ndarray, np.ndarray]], horizon: int
) -> tuple[np.ndarray, np.ndarray]:
    """Gain of the predictor and covariance of its innovations.

    The innovations are the residuals of a long autoregression; what they leave in the output error of the model is linear in the gain.
    """
    ny = len(model.outputs)
    pairs: list[tuple[np.ndarray, np.ndarray]] = []
    regressors, targets, lengths = [], [], []
    for u, y in parts:
        if len(u) <= 2 * horizon:
            continue
        both = np.hstack([u, y])
        past = [both[horizon - k : len(u) - k] for k in range(1, horizon + 1)]
        regressors.append(np.hstack([u[horizon:], *past, np.ones((len(u) - horizon, 1))]))
        targets.append(y[horizon:])
        lengths.append(len(u) - horizon)
    matrix, target = np.vstack(regressors), np.vstack(targets)
    residual = target - matrix @ np.linalg.lstsq(matrix, target, rcond=numerics.RANK_OF_EXACT_RECORDS)[0]
    noise = residual.T @ residual / max(len(residual) - matrix.shape[1], 1)
    innovations = np.split(residual, np.cumsum(lengths)[:-1])
    long = [(u, y) for u, y in parts if len(u) > 2 * horizon]
    for (u, y), e in zip(long, innovations, strict=True):
        # y - y_simulated = C (q I - A)^-1 K e + e: K enters as B does, with e as the input.
        error = y - _simulate(model, u, _estimate_start(model, u, y, None))
        pairs.append((e, error[horizon:] - e))
    if float(np.trace(noise)) > numerics.NEGLIGIBLE_SINGULAR_VALUE**2 * float(np.mean(target**2)):
        gain, _, _ = _estimate_inputs(pairs, model.A, model.C, ny, False)
        # A - K C is the predictor; unstable it would be worse than the free run, which K = 0 is.
        if np.isfinite(gain).all() and np.max(np.abs(np.linalg.eigvals(model.A - gain @ model.C)), initial=0.0) < 1:
            return gain, noise
    return np.zeros((model.order, ny)), noise


def _take_arrays(model: StateSpaceModel, experiment: Experiment) -> tuple[np.ndarray, np.ndarray]:
    """The inputs (N, nu) from the model's origin on, and the outputs (N, ny)."""
    record = to_sampled_record(experiment, model.outputs[0], model.inputs, need_output=False)
    missing = np.full(experiment.rows, np.nan)
    return record.u - model.origin, np.column_stack([experiment.outputs.get(name, missing) for name in model.outputs])


def _simulate(model: StateSpaceModel, u: np.ndarray, x0: np.ndarray) -> np.ndarray:
    x, rows = x0, np.empty((len(u), len(model.outputs)))
    with np.errstate(over="ignore", invalid="ignore"):
        for k, value in enumerate(u):
            rows[k] = model.C @ x + model.D @ value + model.offset
            x = model.A @ x + model.B @ value
    return rows


def _estimate_start(model: StateSpaceModel, u: np.ndarray, y: np.ndarray, rows: int | None) -> np.ndarray:
    """The first state (n,) that the outputs of the first rows show, as far as they show it."""
    driven = _simulate(model, u, np.zeros(model.order))
    # y_k = C A^k x0 + driven: linear in x0.
    power, free = np.eye(model.order), np.empty((*y.shape, model.order))
    for k in range(len(u)):
        free[k] = model.C @ power
        power = model.A @ power
    # Each output counts by what the states do to it, whatever its unit.
    size = np.sqrt(np.mean(free**2, axis=(0, 2)))
    size = np.where(size > 0, size, 1.0)
    target = (y - driven) / size
    free, target = (free / size[:, None]).reshape(-1, model.order), target.reshape(-1)
    # The outputs of a row stand one behind the other.
    first = None if rows is None else rows * y.shape[1]
    return estimate_initial_state(free, target, np.zeros(len(target)), "estimated", first)
