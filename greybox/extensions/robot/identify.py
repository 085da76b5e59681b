"""From joint logs to base parameters with intervals, and to what each joint has beside rigid bodies.

Torques are linear in all that is sought, so one table of sums over blocks of the record answers every question: which constants it
carries, which effects it shows and whether another one would do as well, whether a payload explains what differs from the description.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from greybox.base import DataError, Finding, Severity
from greybox.base.json_shape import Interval
from greybox.data.experiment import Experiment
from greybox.discovery.decision import Grade
from greybox.extensions.robot.base_parameters import BaseParameters, find_base_parameters
from greybox.extensions.robot.description import Robot
from greybox.extensions.robot.joint_effects import (
    COLUMNS,
    COULOMB,
    INERTIA,
    OFFSET,
    VISCOUS,
    JointEffectKind,
    effect_columns,
)
from greybox.extensions.robot.motion import Motion, reconstruct_motion
from greybox.extensions.robot.physical import find_physical_constants
from greybox.extensions.robot.regression import BlockProducts, BlockSolution, promise
from greybox.extensions.robot.result import (
    BaseEstimate,
    JointEffect,
    JointMisfit,
    Payload,
    RigidVerdict,
    RobotCode,
    RobotIdentification,
)
from greybox.extensions.robot.rigid_body import evaluate_rows

# Blocks of the records, all together: an error known from sixteen is good to a sixth, which the quantile of its interval allows for, and a
# block is longer than most noise remembers.
BLOCKS = 16
LEAST_BLOCK_ROWS = 40
# A block is so many times longer than the lag at which a residual has this correlation with itself, unless fewer blocks would be left.
BLOCK_MEMORIES, FORGOTTEN, LEAST_BLOCKS = 5.0, 0.1, 8
# Rows in which a joint moves: with fewer its torque is not regressed.
LEAST_MOVING_ROWS = 200
# Standard errors from which an effect is in the answer: of the thirty that an arm may have, one is by chance in one record of two hundred.
NAMED_DEVIATIONS = 5.0
# ... from which one is tried: what it would explain is still in the scatter of the blocks.
TRIED_DEVIATIONS = 2.5
# ... and beside all other effects of its joint at once, from which it is certain: nothing of the list imitates it.
CERTAIN_DEVIATIONS = 3.0
# Share of the rms error of its joint that a certain effect takes.
CERTAIN_SHARE = 0.02
# Share of what is left of a joint's sum of squares that an unusual effect takes.
UNUSUAL_SHARE = 0.03
# Share of a column that no other imitates, from which it can be told apart.
SEPARABLE_SHARE = 1e-4
# Standard errors by which one set must predict better than another, and the share of the squares that is no difference.
BETTER_DEVIATIONS, SAME_SHARE = 2.0, 0.01
# Standard errors by which the rigid bodies are a multiple of those described.
SCALED_DEVIATIONS = 3.0
# What joints usually have, first; the others are looked for beside it.
USUAL = (VISCOUS, COULOMB, OFFSET)
# A constant is open where half its interval is wider than this share of the largest one of its kind on the link.
OPEN_SHARE = 0.5
# Rows on which the noise of the sensors is added again.
SHAKEN_ROWS = 5000


@dataclass(frozen=True, eq=False)
class _Log:
    """The rows of all records: motion, base regressors (N, n, B), where each torque counts (N, n), and where blocks begin (K,)."""

    motions: Sequence[Motion]
    regressors: np.ndarray
    counts: np.ndarray
    starts: np.ndarray

    def differentiate(self, values: np.ndarray) -> np.ndarray:
        """Slopes (N, n) over time of values (N, n), record by record."""
        ends = np.cumsum([len(m.time) for m in self.motions])[:-1]
        parts = np.split(values, ends)
        return np.concatenate([np.gradient(v, m.step, axis=0) for v, m in zip(parts, self.motions, strict=True)])

    def stack(self, name: str) -> np.ndarray:
        """One array of all motions (N, n)."""
        return np.concatenate([getattr(m, name) for m in self.motions])


@dataclass(frozen=True, eq=False)
class _Table:
    """Sums of each joint alone, unweighted (n, K, B + C + 1, ...), with their rows (n, K); C columns of effects.

    ``prior`` (B + 1, B + 1): what is known of the base parameters before.
    """

    joints: np.ndarray
    rows: np.ndarray
    prior: np.ndarray

    @property
    def base(self) -> int:
        """Number of base parameters B."""
        return len(self.prior) - 1

    def weigh(self, variances: np.ndarray) -> BlockProducts:
        """All joints together: base parameters first, then the effects of each joint."""
        n, K, size = self.joints.shape[:3]
        C = size - 1 - self.base
        P = self.base + n * C
        products = np.zeros((K, P + 1, P + 1))
        for i, each in enumerate(self.joints):
            place = [*range(self.base), *(self.base + i * C + np.arange(C)), P]
            products[np.ix_(range(K), place, place)] += each / variances[i]
        known = np.ix_(range(K), [*range(self.base), P], [*range(self.base), P])
        products[known] += self.prior / K
        return BlockProducts(products, self.rows.sum(axis=0))

    def measure(self, x: np.ndarray) -> np.ndarray:
        """Mean square (n,) that constants x (P,) leave of each joint's torque; NaN without rows."""
        C = self.joints.shape[2] - 1 - self.base
        squares = []
        for i, each in enumerate(self.joints.sum(axis=1)):
            local = np.concatenate([x[: self.base], x[self.base + i * C : self.base + (i + 1) * C], [-1.0]])
            squares.append(local @ each @ local)
        count = self.rows.sum(axis=1)
        return np.where(count > 0, np.maximum(squares, 0) / np.maximum(count, 1), np.nan)


def identify_robot(
    robot: Robot, records: Experiment | Sequence[Experiment], *, prior: float = math.inf, physical: bool = False
) -> RobotIdentification:
    """Fit the base parameters of a robot to joint logs, and look for what its joints have beside rigid bodies.

    Parameters
    ----------
    robot
        The robot as described; axes of which the logs have no position are held still at zero.
    records
        Logs with columns ``q1`` ... in rad or m and ``tau1`` ... in N m or N, as they count the axes; ``dq1`` ... in rad/s or m/s are used
        where they are less noisy than the differentiated positions.
    prior
        How well the description is known: the standard deviation of each of its constants, as a share of what is usual for a link of
        its mass and size. Infinite: not at all.
    physical
        Whether constants of each link that a body can have are looked for; a finding says what they cost.

    Returns
    -------
    RobotIdentification
        Base parameters with 95 % intervals, effects of each joint with their grade, what differs from the description.

    Raises
    ------
    DataError
        Where no axis has both position and torque, or too few rows move.
    """
    logs = [records] if isinstance(records, Experiment) else list(records)
    robot, axes, findings = _match_axes(robot, logs)
    base = find_base_parameters(robot)
    log = _read_logs(base, logs, axes)
    if not log.counts.any() or len(log.starts) < LEAST_BLOCKS:
        raise DataError(
            f"robot {robot.name!r}: no axis moves for {LEAST_MOVING_ROWS} rows while its torque is measured, or fewer than"
            f" {LEAST_BLOCKS * LEAST_BLOCK_ROWS} rows are left between the ends; nothing can be fitted"
        )
    table = _fill_table(log, _weigh_description(base, prior))
    for joint, rows in zip(base.robot.axes, table.rows.sum(axis=1), strict=True):
        if not rows:
            findings.append(Finding(RobotCode.AXIS_WITHOUT_ROWS, Severity.WARNING, joint.name))
    chosen, sums = _select(table)
    torques = _follow_torques(log, len(base.names), chosen, sums)
    sums = _join_blocks(sums, log, torques, findings)
    every, estimates = max(1, len(log.counts) // SHAKEN_ROWS), []
    # As much noise again shifts the estimates by as much again (Cook, Stefanski, J. American Statistical Association 89, 1994); once with
    # either sign, so that what is linear in the noise cancels.
    for shake in (0.0, 1.0, -1.0):
        shaken = _fill_table(_read_logs(base, logs, axes, shake, every), table.prior / every)
        estimates.append(_weigh_by_residual(shaken, chosen).take(chosen).fit().x)
    bias = (estimates[1] + estimates[2]) / 2 - estimates[0]
    if physical:
        findings.append(_find_physical(base, sums, chosen, bias))
    answer = _Answer(base, table, sums, chosen, sums.take(chosen).fit(), bias)
    verdict, payload, further, inertias = answer.compare_with_description()
    constants, effects = answer.list_constants(), [*answer.list_effects(), *inertias]
    further += [
        Finding(RobotCode.RIVAL, subject=e.joint, values={"kind": e.kind, "rival": e.rival}) for e in effects if e.rival
    ]
    if motion := _say_motion(constants):
        values = {"names": [e.name for e in constants if e.is_open], "motion": motion}
        further.append(Finding(RobotCode.OPEN_CONSTANTS, Severity.WARNING, values=values))
    names = [j.name for j in robot.axes]
    return RobotIdentification(
        *(robot.name, robot.source, tuple(each.name for each in logs), len(log.counts), len(sums.rows), constants),
        tuple(sorted(effects, key=lambda e: names.index(e.joint))),
        *(answer.measure_joints(), verdict, payload, (*findings, *further)),
        *(np.concatenate([m.time for m in log.motions]), torques),
    )


def _weigh_description(base: BaseParameters, prior: float) -> np.ndarray:
    """What a prior adds to the sums of products of the base parameters and the torque (B + 1, B + 1)."""
    B, sizes = len(base.names), []
    if not np.isfinite(prior):
        return np.zeros((B + 1, B + 1))
    for inertial in base.robot.inertial.reshape(-1, 10):
        # A link of mass m with radius of gyration r: kg, kg m, kg m^2.
        mass, radius = inertial[0], math.sqrt(max(inertial[[4, 6, 9]].sum(), 0.0) / max(inertial[0], 1e-9))
        sizes += [mass, *[mass * radius] * 3, *[mass * radius**2] * 6]
    covariance = base.mixing * (prior * np.array(sizes)) ** 2 @ base.mixing.T
    precision = np.linalg.pinv(covariance, hermitian=True)
    columns = np.column_stack([np.eye(B), base.values])
    return np.asarray(columns.T @ precision @ columns)


def _find_physical(base: BaseParameters, sums: BlockProducts, chosen: Sequence[int], bias: np.ndarray) -> Finding:
    """The constants that bodies can have, and what they cost."""
    B, fit = len(base.names), sums.take(chosen).fit()
    information = np.linalg.pinv(fit.inverse[:B, :B], hermitian=True)
    # Weighed by what is left of each joint, every row has a square of one.
    theta, growth = find_physical_constants(
        base, (fit.x - bias)[:B], information + 1e-12 * np.trace(information) * np.eye(B)
    )
    links = {j.link: c.tolist() for j, c in zip(base.robot.joints, theta.reshape(-1, 10), strict=True)}
    return Finding(RobotCode.PHYSICAL, values={"increase": math.sqrt(1 + growth / fit.residual) - 1, "links": links})


def _match_axes(robot: Robot, logs: Sequence[Experiment]) -> tuple[Robot, list[int], list[Finding]]:
    """The robot whose axes the logs have, their numbers there, and what is to be said of the others."""
    names = [set(log.inputs) | set(log.outputs) for log in logs]
    present = set.intersection(*names)
    axes = [k + 1 for k in range(len(robot.axes)) if f"q{k + 1}" in present]
    if not any(f"tau{k}" in columns for k in axes for columns in names):
        raise DataError(
            f"robot {robot.name!r} has {len(robot.axes)} axes, and the logs have no axis with both position and torque: columns q1, tau1,"
            " q2, tau2 ... are needed, or --column q1=HEADER"
        )
    held = {j.name: 0.0 for k, j in enumerate(robot.axes) if k + 1 not in axes}
    findings = [Finding(RobotCode.AXIS_HELD, subject=name) for name in held]
    return (robot.lock(held) if held else robot), axes, findings


def _read_logs(
    base: BaseParameters, logs: Sequence[Experiment], axes: Sequence[int], shake: float = 0.0, every: int = 1
) -> _Log:
    motions = [reconstruct_motion(log, axes, shake).thin(every) for log in logs]
    regressors = np.concatenate([evaluate_rows(base.regressor, m.q, m.dq, m.ddq) for m in motions])
    counts = np.concatenate([m.is_moving & np.isfinite(m.tau) for m in motions])
    # A joint with hardly a row that counts has none.
    counts &= counts.sum(axis=0) >= LEAST_MOVING_ROWS / every
    total, starts, first = len(counts), [], 0
    for motion in motions:
        rows = len(motion.time)
        pieces = max(1, min(round(BLOCKS * rows / total), rows // LEAST_BLOCK_ROWS))
        starts += [first + rows * k // pieces for k in range(pieces)]
        first += rows
    return _Log(motions, regressors, counts, np.array(starts))


def _fill_table(log: _Log, prior: np.ndarray) -> _Table:
    """The sums over blocks with all columns; those that rest on the load of a joint know it from a first fit."""
    dq, ddq, tau = log.stack("dq"), log.stack("ddq"), np.nan_to_num(log.stack("tau"))
    n, rigid, rate = dq.shape[1], np.zeros_like(tau), np.zeros_like(tau)
    # First with the usual effects alone, which need no load.
    for columns in (slice(0, len(USUAL)), slice(None)):
        tables, rows = [], []
        for i in range(n):
            effects = effect_columns(dq[:, i], ddq[:, i], rigid[:, i], rate[:, i])[:, columns]
            Z = np.column_stack([log.regressors[:, i], effects, tau[:, i]]) * log.counts[:, i, None]
            ends = [*log.starts[1:], len(Z)]
            tables.append([Z[a:b].T @ Z[a:b] for a, b in zip(log.starts, ends, strict=True)])
            rows.append(np.add.reduceat(log.counts[:, i].astype(float), log.starts))
        table = _Table(np.array(tables), np.array(rows), prior)
        if columns.stop:
            fit = _weigh_by_residual(table).fit()
            rigid = log.regressors @ fit.x[: table.base]
            rate = log.differentiate(rigid)
    return table


def _weigh_by_residual(table: _Table, columns: Sequence[int] | None = None) -> BlockProducts:
    """All joints together, each weighed by what is left of it when ``columns`` are fitted."""
    totals = table.joints[:, :, -1, -1].sum(axis=1)
    variances = np.where(totals > 0, totals / np.maximum(table.rows.sum(axis=1), 1), 1.0)
    for _ in range(3):
        sums = table.weigh(variances)
        kept = np.arange(sums.size) if columns is None else np.array(columns)
        x = np.zeros(sums.size)
        x[kept] = sums.take(kept).fit().x
        left = table.measure(x)
        variances = np.where(np.isfinite(left) & (left > 0), left, variances)
    return table.weigh(variances)


def _column(base: int, joint: int, column: int) -> int:
    return base + joint * len(COLUMNS) + column


def _kind_of(base: int, column: int) -> tuple[int, JointEffectKind]:
    joint, place = divmod(column - base, len(COLUMNS))
    return joint, COLUMNS[place]


def _select(table: _Table) -> tuple[list[int], BlockProducts]:
    """Columns of the answer, and the sums weighed by what it leaves."""
    base, n = table.base, len(table.joints)
    joints = [i for i in range(n) if table.rows[i].sum()]
    chosen = [*range(base), *(_column(base, i, k) for i in joints for k in range(len(USUAL)))]
    sums = _weigh_by_residual(table, chosen)
    while added := _find_unusual(sums, chosen, base, joints):
        chosen = sorted({*chosen, *added})
        sums = _weigh_by_residual(table, chosen)
    while dropped := _find_idle(sums.take(chosen).fit(), chosen, base):
        chosen = [c for c in chosen if c not in dropped]
    return chosen, _weigh_by_residual(table, chosen)


def _find_unusual(sums: BlockProducts, chosen: Sequence[int], base: int, joints: Sequence[int]) -> list[int]:
    """Of each joint the further effect that takes most, where it takes enough."""
    present = {_kind_of(base, c) for c in chosen if c >= base}
    further = [
        _column(base, i, k) for i in joints for k, kind in enumerate(COLUMNS) if (i, kind) not in present
    ]  # fmt: skip
    if not further:
        return []
    promised, left = promise(sums, chosen, further), sums.take(chosen).fit().residual
    best: dict[int, tuple[float, int]] = {}
    for k, column in enumerate(further):
        joint, kind = _kind_of(base, column)
        is_possible = not kind.is_positive or promised.value[k] > 0
        # Weighed by what is left of each joint, every joint has the same share of the squares.
        is_large = promised.decrease[k] > UNUSUAL_SHARE * left / len(joints)
        if (
            is_possible
            and is_large
            and promised.share[k] > SEPARABLE_SHARE
            and abs(promised.ratio[k]) > TRIED_DEVIATIONS
        ):
            best[joint] = max(best.get(joint, (0.0, 0)), (float(promised.decrease[k]), column))
    return [column for _, column in best.values()]


def _find_idle(fit: BlockSolution, chosen: Sequence[int], base: int) -> list[int]:
    """Of each joint the least sure effect that is not sure enough or has the wrong sign, an unusual one before a usual one."""
    worst: dict[int, tuple[bool, float, int]] = {}
    ratios = fit.x / np.where(fit.std > 0, fit.std, np.inf)
    for column, ratio in zip(chosen, ratios, strict=True):
        if column < base:
            continue
        joint, kind = _kind_of(base, column)
        sure = ratio if kind.is_positive else abs(ratio)
        if sure < NAMED_DEVIATIONS:
            worst[joint] = min(worst.get(joint, (True, np.inf, 0)), (kind in USUAL, float(sure), column))
    return [column for *_, column in worst.values()]


def _follow_torques(log: _Log, base: int, chosen: Sequence[int], sums: BlockProducts) -> np.ndarray:
    """Torques (3, N, n): measured, of the rigid bodies, with all effects; NaN where a row does not count."""
    dq, ddq, tau = log.stack("dq"), log.stack("ddq"), log.stack("tau")
    x = np.zeros(sums.size)
    x[list(chosen)] = sums.take(chosen).fit().x
    rigid = log.regressors @ x[:base]
    rate = log.differentiate(rigid)
    constants = x[base:].reshape(tau.shape[1], len(COLUMNS))
    # Load, gain and lag rest on the torque of the rigid bodies, which is now better known.
    effects = [effect_columns(dq[:, i], ddq[:, i], rigid[:, i], rate[:, i]) @ c for i, c in enumerate(constants)]
    return np.where(log.counts, np.array([tau, rigid, rigid + np.column_stack(effects)]), np.nan)


def _join_blocks(sums: BlockProducts, log: _Log, torques: np.ndarray, findings: list[Finding]) -> BlockProducts:
    """The sums over blocks that are longer than what is left of the torques remembers."""
    left = np.nan_to_num(torques[0] - torques[2])
    size = 2 ** int(np.ceil(np.log2(2 * len(left))))
    power = np.abs(np.fft.rfft(left, size, axis=0)) ** 2
    correlation = np.fft.irfft(power, size, axis=0)[: len(left) // 2]
    correlation = correlation[:, correlation[0] > 0] / correlation[0, correlation[0] > 0]
    memory = int((correlation < FORGOTTEN).argmax(axis=0).max(initial=0))
    count = len(left) / (BLOCK_MEMORIES * max(memory, 1))
    if count < LEAST_BLOCKS:
        seconds = {"memory": memory * log.motions[0].step, "rows": len(left) * log.motions[0].step}
        findings.append(Finding(RobotCode.LONG_MEMORY, Severity.WARNING, values=seconds))
    return sums.merge(int(min(max(count, LEAST_BLOCKS), len(sums.rows))))


@dataclass(frozen=True, eq=False)
class _Answer:
    """The columns that were chosen, fitted; ``bias`` (chosen,) is what the noise of the positions has shifted the estimates by."""

    base: BaseParameters
    table: _Table
    sums: BlockProducts
    chosen: Sequence[int]
    fit: BlockSolution
    bias: np.ndarray

    @cached_property
    def values(self) -> np.ndarray:
        """The estimates (chosen,)."""
        return np.asarray(self.fit.x - self.bias)

    @cached_property
    def std(self) -> np.ndarray:
        """Their standard errors (chosen,)."""
        B, inverse = self.table.base, self.fit.inverse
        # What was known before is no block that could be left out: its share of the errors is added.
        known = np.einsum("pb,bc,pc->p", inverse[:, :B], self.table.prior[:-1, :-1], inverse[:, :B])
        return np.sqrt(self.fit.covariance.diagonal() + known + self.bias**2)

    def list_constants(self) -> tuple[BaseEstimate, ...]:
        """The base parameters."""
        base, units, links = self.base, np.array(self.base.units), self.base.columns // 10
        made = []
        for k, name in enumerate(base.names):
            # The largest constant of this unit on the link, or of all links where that is zero; many descriptions have no inertia.
            alike = np.maximum(np.abs(base.values), np.abs(self.values[: len(units)])) * (units == units[k])
            size = (alike * (links == links[k])).max() or alike.max()
            value, std, interval = _spell(self.values[k], self.std[k], self.fit.quantile)
            is_open = bool(self.fit.is_open[k] or interval[1] - value > OPEN_SHARE * size)
            described = float(base.values[k])
            made.append(BaseEstimate(name, base.describe(k), base.units[k], value, std, interval, described, is_open))
        return tuple(made)

    def list_effects(self) -> Iterator[JointEffect]:
        """The effects with their grades."""
        for k, column in enumerate(self.chosen):
            if column >= self.table.base:
                spelled = _spell(self.values[k], self.std[k], self.fit.quantile)
                yield self._make_effect(column, spelled, *self._grade(column, spelled[0]))

    def _make_effect(
        self, column: int, spelled: tuple[float, float, Interval], grade: Grade, share: float, rival: str
    ) -> JointEffect:
        i, kind = _kind_of(self.table.base, column)
        joint = self.base.robot.axes[i]
        return JointEffect(joint.name, kind.name, *spelled, kind.units[joint.units[0] == "m"], grade, share, rival)

    def _grade(self, column: int, value: float) -> tuple[Grade, float, str]:
        """What may be said of an effect, the share of its joint's rms error that it takes, and what would do nearly as well."""
        joint, kind = _kind_of(self.table.base, column)
        without = [c for c in self.chosen if c != column]
        share = float(1 - self._rms(self.chosen)[joint] / self._rms(without)[joint])
        others = [_column(self.table.base, joint, k) for k, other in enumerate(COLUMNS) if other is not kind]
        further = [c for c in others if c not in self.chosen]
        shares = promise(self.sums, self.chosen, further).share
        # Beside everything else that its joint may have, all at once.
        rich = [*self.chosen, *(c for c, s in zip(further, shares, strict=True) if s > SEPARABLE_SHARE)]
        fit, place = self.sums.take(rich).fit(), rich.index(column)
        if fit.x[place] / fit.std[place] * np.sign(value) > CERTAIN_DEVIATIONS and share > CERTAIN_SHARE:
            return Grade.ESTABLISHED, share, ""
        errors = {c: self.sums.take([*without, c]).fit().residual for c in further}
        rival = min(errors, key=errors.__getitem__, default=None)
        return Grade.PROBABLE, share, "" if rival is None else _kind_of(self.table.base, rival)[1].name

    def _rms(self, columns: Sequence[int]) -> np.ndarray:
        """Rms (n,) that is left of each torque where these columns are fitted."""
        x = np.zeros(self.sums.size)
        x[list(columns)] = self.sums.take(columns).fit().x
        return np.sqrt(self.table.measure(x))

    def measure_joints(self) -> tuple[JointMisfit, ...]:
        """How well each torque is followed."""
        rms = np.array([self._rms(columns) for columns in ([], range(self.table.base), self.chosen)])
        return tuple(
            JointMisfit(joint.name, joint.units[1], int(rows), *map(float, rms[:, i]))
            for i, (joint, rows) in enumerate(zip(self.base.robot.axes, self.table.rows.sum(axis=1), strict=True))
            if rows
        )

    def compare_with_description(self) -> tuple[RigidVerdict, Payload | None, list[Finding], list[JointEffect]]:
        """Whether the rigid bodies are as described, or a payload on the last link or one factor is the difference.

        Where the links are known, the inertia of each motor shows by itself: those that free links would carry come last.
        """
        base, B = self.base, self.table.base
        # What joints usually have takes part even where it is not sure: links would take its place.
        beside = [c for c in range(B, self.sums.size) if _kind_of(B, c)[1] in (*USUAL, INERTIA)]
        effects = sorted({*self.chosen[B:], *beside})
        whole = self.sums.take([*range(B), *effects])

        def fit(mixing: np.ndarray, described: float) -> BlockSolution:
            """The rigid bodies as the description says, times ``described``, with combinations (B, Z) of unknowns beside it."""
            Q = np.zeros((B + len(effects), mixing.shape[1] + len(effects)))
            Q[:B, : mixing.shape[1]], Q[B:, mixing.shape[1] :] = mixing, np.eye(len(effects))
            return whole.substitute(Q, described * np.concatenate([base.values, np.zeros(len(effects))])).fit()

        free = whole.fit()
        fits = {
            RigidVerdict.AS_DESCRIBED: fit(np.zeros((B, 0)), 1.0),
            RigidVerdict.SCALED: fit(base.values[:, None], 0.0),
            RigidVerdict.PAYLOAD: fit(base.mixing[:, -10:], 1.0),
        }
        scaled = fits[RigidVerdict.SCALED]
        factor, spread, between = _spell(scaled.x[0], scaled.std[0], scaled.quantile)
        # The first of the ten constants is the mass, then come the first moments.
        loaded = fits[RigidVerdict.PAYLOAD]
        mass, std, interval = _spell(loaded.x[0], loaded.std[0], loaded.quantile)
        is_possible = {
            RigidVerdict.AS_DESCRIBED: abs(factor - 1) <= SCALED_DEVIATIONS * spread,
            RigidVerdict.PAYLOAD: mass != 0 and not loaded.is_open[0],
        }
        errors = {
            verdict: each.errors.sum()
            for verdict, each in fits.items()
            if is_possible.get(verdict, True)
            and base.values.any()  # a description without inertia describes nothing
            and (
                each.errors.sum() < (1 + SAME_SHARE) * free.errors.sum()
                or not each.is_worse_than(free, BETTER_DEVIATIONS)
            )
        }
        verdict = min(errors, key=lambda v: (v is not RigidVerdict.AS_DESCRIBED, errors[v]), default=RigidVerdict.OTHER)
        findings, payload, motors = [], None, []
        if verdict is RigidVerdict.SCALED:
            values = {"factor": factor, "low": between[0], "high": between[1]}
            findings = [Finding(RobotCode.SCALED, Severity.WARNING, base.robot.source, values)]
        if verdict is RigidVerdict.PAYLOAD:
            x, y, z = (loaded.x[1:4] / mass).tolist()
            payload = Payload(base.robot.joints[-1].link, mass, std, interval, (x, y, z))
        if verdict is not RigidVerdict.OTHER:
            best = fits[verdict]
            x, deviations, is_open = (v[-len(effects) :] for v in (best.x, best.std, best.is_open))
            for k, column in enumerate(effects):
                is_motor = _kind_of(B, column)[1] is INERTIA and column not in self.chosen and not is_open[k]
                if is_motor and x[k] > NAMED_DEVIATIONS * deviations[k]:
                    spelled = _spell(x[k], deviations[k], free.quantile)
                    motors.append(self._make_effect(column, spelled, Grade.PROBABLE, 0.0, ""))
        return verdict, payload, findings, motors


def _spell(value: float, std: float, quantile: float) -> tuple[float, float, Interval]:
    """An estimate with its standard error and its 95 % interval."""
    return float(value), float(std), (float(value - quantile * std), float(value + quantile * std))


def _say_motion(base: Sequence[BaseEstimate]) -> str:
    """The motion that would settle the base parameters that a record leaves open; "" where none is."""
    moments = sorted({int(b.name.lstrip("Imxyz")) for b in base if b.is_open and b.unit == "kg m"})
    inertias = sorted({int(b.name.lstrip("Imxyz")) for b in base if b.is_open and b.unit != "kg m"})
    parts = []
    # First moments show by their weight, moments of inertia by accelerations.
    if moments:
        parts.append(f"bring link {', '.join(map(str, moments))} into many poses")
    if inertias:
        parts.append(f"accelerate joint {', '.join(map(str, inertias))} harder, together with the joints before")
    return " and ".join(parts)
