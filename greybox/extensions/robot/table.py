"""The table of a joint log: sums of products of all columns over blocks, from which everything that is said of a robot is read.

Torques are linear in base parameters and in most of what a joint may have; what is not (the gain of a reading, the width of the Stribeck
effect, friction that grows with the load) is linearised about the constants found so far, and the table is filled anew.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from greybox.extensions.robot.base_parameters import BaseParameters
from greybox.extensions.robot.description import Joint, JointKind
from greybox.extensions.robot.motion import Motion
from greybox.extensions.robot.regression import BlockProducts
from greybox.extensions.robot.rigid_body import evaluate_rows

# Shares of the largest speed of a joint that are tried as the width of the Stribeck effect.
STRIBECK_SHARES = (0.03, 0.08, 0.2)


@dataclass(frozen=True)
class JointEffectKind:
    """One kind of effect.

    Parameters
    ----------
    name
        As findings and files call it.
    words
        As sentences call it.
    units
        Of its constant for a revolute and a prismatic joint.
    is_positive
        Whether a negative constant cannot be.
    """

    name: str
    words: str
    units: tuple[str, str]
    is_positive: bool = True

    def unit_at(self, joint: Joint) -> str:
        """Unit of its constant at a joint."""
        return self.units[joint.kind is JointKind.PRISMATIC]


VISCOUS = JointEffectKind("viscous_friction", "viscous friction", ("N*m*s/rad", "N*s/m"))
COULOMB = JointEffectKind("coulomb_friction", "dry friction", ("N*m", "N"))
STRIBECK = JointEffectKind("stribeck_friction", "a Stribeck rise of the friction near rest", ("N*m", "N"))
LOAD = JointEffectKind("load_dependent_friction", "friction that grows with the load", ("1", "1"))
OFFSET = JointEffectKind("torque_offset", "an offset of the torque", ("N*m", "N"), is_positive=False)
INERTIA = JointEffectKind("motor_inertia", "inertia of the motor", ("kg*m^2", "kg"))
GAIN = JointEffectKind("drive_gain", "a wrong gain of the drive", ("1", "1"), is_positive=False)
LAG = JointEffectKind("torque_lag", "a delay between torque and motion", ("s", "s"), is_positive=False)
# How far the width of a Stribeck effect is off, as a change of its logarithm: no effect, but fitted beside it.
WIDTH = JointEffectKind("stribeck_width", "the width of the Stribeck rise", ("1", "1"), is_positive=False)
KINDS = (VISCOUS, COULOMB, OFFSET, STRIBECK, LOAD, INERTIA, GAIN, LAG)
# The columns of a joint, in their order: the kinds, the Stribeck effect once for each width that is tried.
COLUMNS = (VISCOUS, COULOMB, OFFSET, *[STRIBECK] * len(STRIBECK_SHARES), WIDTH, LOAD, INERTIA, GAIN, LAG)


def effect_columns(
    dq: np.ndarray, ddq: np.ndarray, rigid: np.ndarray, rate: np.ndarray, width: float = np.nan, rise: float = 0.0
) -> np.ndarray:
    """What each of `COLUMNS` adds to the torque of a joint at unit constant (N, C).

    Parameters
    ----------
    dq, ddq
        Its velocity and acceleration (N,).
    rigid, rate
        The torque of the rigid bodies (N,) as first estimated, and its change in a second.
    width, rise
        Of the Stribeck effect where they are known; else several widths are tried.
    """
    sign, fastest = np.sign(dq), np.abs(dq).max(initial=0.0) or 1.0
    # sign(v) exp(-(v / vs)^2) (Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30, 1994)
    widths = [share * fastest for share in STRIBECK_SHARES] if np.isnan(width) else [width]
    raised = np.zeros((len(dq), len(STRIBECK_SHARES) + 1))
    raised[:, : len(widths)] = sign[:, None] * np.exp(-((dq[:, None] / np.array(widths)) ** 2))
    if not np.isnan(width):
        # d / d ln(vs)
        raised[:, -1] = 2 * rise * (dq / width) ** 2 * raised[:, 0]
    return np.column_stack(
        [
            dq,
            sign,
            np.ones_like(dq),
            raised,
            # mu |load| sign(v) (Hamon, Gautier, Garrec, IROS 2010)
            np.abs(rigid) * sign,
            ddq,
            # tau = (1 + e) rigid
            rigid,
            # tau(t) = rigid(t - delay): to the first order -delay d rigid / dt
            -rate,
        ]
    )


# Blocks of the records, all together: an error known from sixteen is good to a sixth, which the quantile of its interval allows for, and a
# block is longer than most noise remembers.
BLOCKS = 16
LEAST_BLOCKS, LEAST_BLOCK_ROWS = 8, 40
# Rows in which a joint moves: with fewer its torque is not regressed.
LEAST_MOVING_ROWS = 200
# Share of the squares of the positions by which a motion that repeats differs from itself a period later.
REPEATS = 0.02
# Largest change of the logarithm of a width in one step, and its limits as shares of the largest speed.
WIDTH_STEP, WIDTH_LIMITS = 0.5, (0.005, 0.6)


@dataclass(frozen=True, eq=False)
class JointLog:
    """The rows of all records: motion, base regressors (N, n, B), readings of the torques (N, n) and where each counts (N, n).

    ``labels`` (N,) are the numbers of the blocks; ``cycle`` is the number of rows after which these begin anew.
    """

    motions: Sequence[Motion]
    regressors: np.ndarray
    tau: np.ndarray
    counts: np.ndarray
    labels: np.ndarray
    cycle: int

    @cached_property
    def motion(self) -> tuple[np.ndarray, np.ndarray]:
        """Velocities and accelerations (N, n)."""
        return stack(self.motions, "dq"), stack(self.motions, "ddq")

    @cached_property
    def fastest(self) -> np.ndarray:
        """The largest speed (n,) of each axis."""
        largest = np.abs(self.motion[0]).max(axis=0)
        return np.asarray(np.where(largest > 0, largest, 1.0))

    @cached_property
    def pieces(self) -> list[tuple[int, int, int]]:
        """First row, row after the last, and block of all stretches of rows."""
        starts = [0, *(np.flatnonzero(np.diff(self.labels)) + 1).tolist()]
        ends = [*starts[1:], len(self.labels)]
        return [(a, b, int(self.labels[a])) for a, b in zip(starts, ends, strict=True)]

    @cached_property
    def blocks(self) -> int:
        """Number of blocks K."""
        return int(self.labels.max()) + 1

    @cached_property
    def squares(self) -> np.ndarray:
        """Sums (n, K, B + 1, B + 1) of products of base regressors and readings, over the rows that count."""
        return np.array([self.multiply(i, self._rigid(i), self._rigid(i)) for i in range(self.tau.shape[1])])

    def cross(self, joint: int, columns: np.ndarray) -> np.ndarray:
        """Sums (K, B + 1, C) of their products with further columns (N, C) of a joint."""
        return self.multiply(joint, self._rigid(joint), columns)

    def multiply(self, joint: int, left: np.ndarray, right: np.ndarray) -> np.ndarray:
        """Sums (K, L, R) over the blocks of products of columns (N, L) and (N, R), where the torque of a joint counts."""
        sums = np.zeros((self.blocks, left.shape[1], right.shape[1]))
        counted = right * self.counts[:, joint, None]
        for first, end, block in self.pieces:
            sums[block] += left[first:end].T @ counted[first:end]
        return sums

    def _rigid(self, joint: int) -> np.ndarray:
        return np.column_stack([self.regressors[:, joint], self.tau[:, joint]])

    def differentiate(self, values: np.ndarray) -> np.ndarray:
        """Slopes (N, n) over time of values (N, n), record by record."""
        ends = np.cumsum([len(m.time) for m in self.motions])[:-1]
        parts = np.split(values, ends)
        return np.concatenate([np.gradient(v, m.step, axis=0) for v, m in zip(parts, self.motions, strict=True)])


def stack(motions: Sequence[Motion], name: str) -> np.ndarray:
    """One array of all motions (N, n)."""
    return np.concatenate([getattr(m, name) for m in motions])


def make_log(base: BaseParameters, motions: Sequence[Motion], loads: Sequence[bool], least: float) -> JointLog:
    """The rows of motions; joints with fewer than ``least`` rows that count have none.

    Where any record is said to carry a payload (``loads``), its ten constants stand behind the base parameters.
    """
    regressors = np.concatenate([evaluate_rows(base.regressor, m.q, m.dq, m.ddq) for m in motions])
    if any(loads):
        loaded = np.repeat(np.array(loads, float), [len(m.time) for m in motions])
        # A payload changes the base parameters by those combinations that hold the last link's constants.
        regressors = np.concatenate([regressors, loaded[:, None, None] * (regressors @ base.mixing[:, -10:])], axis=2)
    tau = stack(motions, "tau")
    counts = stack(motions, "is_moving") & np.isfinite(tau)
    counts &= counts.sum(axis=0) >= least
    cycle = _find_cycle(stack(motions, "q"))
    return JointLog(motions, regressors, np.nan_to_num(tau), counts, _label_blocks(motions, cycle), cycle)


def _find_cycle(q: np.ndarray) -> int:
    """Rows after which a motion (N, n) repeats, all of them where it does not.

    What a model lacks repeats with the motion: rows that are a period apart tell the same of it, and belong to one block.
    """
    count, z = len(q), q - q.mean(axis=0)
    power = np.abs(np.fft.rfft(z, 2 * count, axis=0)) ** 2
    products = np.fft.irfft(power, axis=0)[:count].sum(axis=1)
    squares = np.concatenate([[0.0], np.cumsum((z**2).sum(axis=1))])
    lags = np.arange(count)
    # sum (q(t) - q(t + lag))^2 over the sum of both squares
    both = squares[count - lags] + squares[count] - squares[lags]
    differs = 1 - 2 * products / np.where(both > 0, both, 1.0)
    # Far enough to have left where it began, and not so far that less than a third of the rows is left to compare.
    far, last = int((differs > 0.5).argmax()), 2 * count // 3
    near = np.flatnonzero(differs[far:last] < REPEATS)
    if not far or not len(near):
        return count
    first = far + int(near[0])
    return first + int(differs[first : min(last, first + count // 50)].argmin())


def _label_blocks(motions: Sequence[Motion], cycle: int) -> np.ndarray:
    total = sum(len(m.time) for m in motions)
    if cycle < total and cycle >= LEAST_BLOCKS * LEAST_BLOCK_ROWS:
        count = min(BLOCKS, cycle // LEAST_BLOCK_ROWS)
        return np.arange(total) % cycle * count // cycle
    labels, first = [], 0
    for motion in motions:
        rows = len(motion.time)
        pieces = max(1, min(round(BLOCKS * rows / total), rows // LEAST_BLOCK_ROWS))
        labels.append(first + np.arange(rows) * pieces // rows)
        first += pieces
    return np.concatenate(labels)


@dataclass(frozen=True, eq=False)
class WorkingPoint:
    """Constants about which a table is linearised.

    ``base`` (B,), ``effects`` (n, C), ``gains`` (n,) of the readings, and ``widths`` (n,) of the Stribeck effect in rad/s or m/s, NaN where
    there is none yet.
    """

    base: np.ndarray
    effects: np.ndarray
    gains: np.ndarray
    widths: np.ndarray

    @staticmethod
    def start(base: int, joints: int) -> WorkingPoint:
        """Nothing is known."""
        zero = np.zeros((joints, len(COLUMNS)))
        return WorkingPoint(np.zeros(base), zero, np.ones(joints), np.full(joints, np.nan))

    def move(self, x: np.ndarray, fastest: np.ndarray) -> WorkingPoint:
        """Where constants x (P,) lead that were fitted to the table at this point."""
        effects = x[len(self.base) :].reshape(self.effects.shape)
        step = np.clip(effects[:, COLUMNS.index(WIDTH)], -WIDTH_STEP, WIDTH_STEP)
        low, high = WIDTH_LIMITS
        widths = np.clip(self.widths * np.exp(step), low * fastest, high * fastest)
        return WorkingPoint(x[: len(self.base)], effects, self.gains + effects[:, COLUMNS.index(GAIN)], widths)

    def complete(self, kind: JointEffectKind, joint: int, value: float) -> float:
        """A constant as it is: a gain is fitted as what is left beside that of the linearisation."""
        return value + (self.gains[joint] - 1 if kind is GAIN else 0.0)

    def evaluate(self, log: JointLog) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Torques of the rigid bodies (N, n), all torques (N, n) as they are, and what each effect adds at unit constant (N, n, C)."""
        rigid = log.regressors @ self.base
        rate, (dq, ddq) = log.differentiate(rigid), log.motion
        columns = np.empty((*rigid.shape, len(COLUMNS)))
        constants = self.effects.copy()
        constants[:, [COLUMNS.index(GAIN), COLUMNS.index(WIDTH)]] = 0.0
        total = np.empty_like(rigid)
        for i in range(rigid.shape[1]):
            rise = self.effects[i, COLUMNS.index(STRIBECK)]
            columns[:, i] = effect_columns(dq[:, i], ddq[:, i], rigid[:, i], rate[:, i], self.widths[i], rise)
            total[:, i] = rigid[:, i] + columns[:, i] @ constants[i]
        # reading = gain (rigid + effects)
        columns *= self.gains[:, None]
        columns[:, :, COLUMNS.index(GAIN)] = total
        return rigid, total, columns


@dataclass(frozen=True, eq=False)
class JointTable:
    """Sums of each joint alone, unweighted (n, K, B + C + 1, ...), with their rows (n, K); C columns of effects.

    ``prior`` (B + 1, B + 1): what is known of the base parameters before. ``gauge``, of the same shape, sets what no reading tells.
    """

    joints: np.ndarray
    rows: np.ndarray
    prior: np.ndarray
    gauge: np.ndarray

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
        products[known] += (self.prior + self.gauge) / K
        return BlockProducts(products, self.rows.sum(axis=0))

    def weigh_by_residual(self, columns: Sequence[int]) -> BlockProducts:
        """All joints together, each weighed by what is left of it when ``columns`` are fitted."""
        totals = self.joints[:, :, -1, -1].sum(axis=1)
        variances = np.where(totals > 0, totals / np.maximum(self.rows.sum(axis=1), 1), 1.0)
        for _ in range(3):
            left = self.measure(solve(self.weigh(variances), columns))
            variances = np.where(np.isfinite(left) & (left > 0), left, variances)
        return self.weigh(variances)

    def measure(self, x: np.ndarray) -> np.ndarray:
        """Mean square (n,) that constants x (P,) leave of each joint's torque; NaN without rows."""
        C = self.joints.shape[2] - 1 - self.base
        squares = []
        for i, each in enumerate(self.joints.sum(axis=1)):
            local = np.concatenate([x[: self.base], x[self.base + i * C : self.base + (i + 1) * C], [-1.0]])
            squares.append(local @ each @ local)
        count = self.rows.sum(axis=1)
        return np.where(count > 0, np.maximum(squares, 0) / np.maximum(count, 1), np.nan)


def solve(sums: BlockProducts, columns: Sequence[int]) -> np.ndarray:
    """Constants (P,) where ``columns`` are fitted and the others are zero."""
    x = np.zeros(sums.size)
    x[list(columns)] = sums.take(columns).fit().x
    return x


def fill_table(log: JointLog, prior: np.ndarray, gauge: np.ndarray, point: WorkingPoint) -> JointTable:
    """The sums over blocks of all columns, linearised about a point."""
    B, size = len(prior) - 1, len(prior) - 1 + len(COLUMNS) + 1
    _, _, columns = point.evaluate(log)
    joints, rows = np.zeros((len(point.gains), log.blocks, size, size)), np.zeros((len(point.gains), log.blocks))
    rigid, effects = [*range(B), size - 1], slice(B, size - 1)
    for i, gain in enumerate(point.gains):
        scale = np.array([*[gain] * B, 1.0])
        joints[i][:, np.array(rigid)[:, None], rigid] = scale[:, None] * log.squares[i] * scale
        cross = scale[:, None] * log.cross(i, columns[:, i])
        joints[i][:, rigid, effects] = cross
        joints[i][:, effects, rigid] = cross.transpose(0, 2, 1)
        joints[i][:, effects, effects] = log.multiply(i, columns[:, i], columns[:, i])
        np.add.at(rows[i], log.labels, log.counts[:, i])
    return JointTable(joints, rows, prior, gauge)


def place_column(base: int, joint: int, column: int | JointEffectKind) -> int:
    """Which column of the table the effect ``column`` of a joint is; of a kind the first."""
    return base + joint * len(COLUMNS) + (column if isinstance(column, int) else COLUMNS.index(column))


def kind_of(base: int, column: int) -> tuple[int, JointEffectKind]:
    """Joint and kind of a column of the table."""
    joint, place = divmod(column - base, len(COLUMNS))
    return joint, COLUMNS[place]


def widen(point: WorkingPoint, joint: int, place: int, rise: float, fastest: float) -> WorkingPoint:
    """The point at which the Stribeck effect of a joint has the width that column ``place`` has tried."""
    widths, effects = point.widths.copy(), point.effects.copy()
    widths[joint] = STRIBECK_SHARES[place - COLUMNS.index(STRIBECK)] * fastest
    effects[joint, COLUMNS.index(STRIBECK)] = rise
    return replace(point, widths=widths, effects=effects)
