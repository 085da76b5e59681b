"""From joint logs to base parameters with intervals, and to what each joint has beside rigid bodies.

One table of sums over blocks of the record answers every question: which constants it carries, which effects it shows and whether another
one would do as well, whether a payload explains what differs from the description.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType

import numpy as np

from greybox.base import DataError, Finding, Severity, nearest
from greybox.base.json_shape import Interval
from greybox.data.experiment import Experiment
from greybox.discovery.decision import Grade
from greybox.extensions.robot.base_parameters import BaseParameters, find_base_parameters, find_physical_constants
from greybox.extensions.robot.description import Joint, Robot
from greybox.extensions.robot.motion import reconstruct_motion
from greybox.extensions.robot.regression import BlockProducts, BlockSolution, promise
from greybox.extensions.robot.result import (
    BaseEstimate,
    JointEffect,
    JointMisfit,
    Payload,
    RigidVerdict,
    RobotCode,
    RobotIdentification,
    TorqueConstant,
)
from greybox.extensions.robot.table import (
    COLUMNS,
    COULOMB,
    GAIN,
    INERTIA,
    LAG,
    LEAST_BLOCK_ROWS,
    LEAST_BLOCKS,
    LEAST_MOVING_ROWS,
    OFFSET,
    STRIBECK,
    VISCOUS,
    WIDTH,
    JointLog,
    JointTable,
    WorkingPoint,
    fill_table,
    kind_of,
    make_log,
    place_column,
    solve,
    widen,
)

# A block is so many times longer than the lag at which a residual has this correlation with itself, unless fewer blocks would be left.
BLOCK_MEMORIES, FORGOTTEN = 5.0, 0.1
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
# Share of the rms of a torque that is left, from which it may not be that of its joint; and from which it is not, where what is left is
# smooth: its differences have less than this share of the squares of those of noise. Of 28 logs of three arms that set none of them, each
# with a sign, a zero or an order that is wrong, or noise on one torque: no wrong payload, one wrong effect as certain.
STRANGE_SHARE, LOST_SHARE, ROUGH = 0.25, 0.5, 0.1
# Rows on which the noise of the sensors is added again.
SHAKEN_ROWS = 5000
# Standard errors from which described links show in a current: what they are not said to carry is as large as they are at a wrist.
SHOWN_DEVIATIONS = 10.0
# Linearisations after which the width of a Stribeck effect and the gains of readings stand still.
SETTLING = 4
# Standard deviation of a payload that is known, as a share of its mass.
WEIGHED_SHARE = 1e-6


def identify_robot(
    robot: Robot,
    records: Experiment | Sequence[Experiment],
    *,
    prior: float = math.inf,
    physical: bool = False,
    torque_constants: Mapping[str, float] = MappingProxyType({}),
    payloads: Mapping[str, float] = MappingProxyType({}),
) -> RobotIdentification:
    """Fit the base parameters of a robot to joint logs, and look for what its joints have beside rigid bodies.

    Parameters
    ----------
    robot
        The robot as described; axes of which the logs have no position are held still at zero.
    records
        Logs with columns ``q1`` ... in rad or m and ``tau1`` ... in N m or N, or ``i1`` ... in A, as they count the axes; ``dq1`` ... in
        rad/s or m/s are used where they are less noisy than the differentiated positions.
    prior
        How well the description is known: the standard deviation of each of its constants, as a share of what is usual for a link of
        its mass and size. Infinite: not at all.
    physical
        Whether constants of each link that a body can have are looked for; a finding says what they cost.
    torque_constants
        Joint -> what one ampere gives at it, gear included, in N m/A or N/A. Those of the other joints with a current are fitted.
    payloads
        Name of a record -> mass in kg that is fixed to the last link in it, and in no other record.

    Returns
    -------
    RobotIdentification
        Base parameters with 95 % intervals, effects of each joint with their grade, what differs from the description.

    Raises
    ------
    DataError
        Where no axis has both position and torque, or too few rows move; for names that are no joint or record; and where nothing tells
        the level of the torques.
    """
    logs = [records] if isinstance(records, Experiment) else list(records)
    robot, axes, findings = _match_axes(robot, logs)
    base, count = find_base_parameters(robot), sum(log.rows for log in logs)
    names = [log.name for log in logs]
    for name, mass in payloads.items():
        if name not in names:
            raise DataError(f"there is no record {name!r} to carry a payload; {nearest(name, names)}")
        if mass <= 0 or mass != next(iter(payloads.values())):
            raise DataError(
                f"record {name!r} carries {mass:g} kg: a payload weighs more than nothing, and the same in all records that carry it"
            )

    def read(shake: float = 0.0, every: int = 1) -> JointLog:
        motions = [reconstruct_motion(log, axes, shake).thin(every) for log in logs]
        return make_log(base, motions, [name in payloads for name in names], LEAST_MOVING_ROWS / every)

    log = read()
    if not log.counts.any() or log.blocks < LEAST_BLOCKS:
        raise DataError(
            f"robot {robot.name!r}: no axis moves for {LEAST_MOVING_ROWS} rows while its torque is measured, or fewer than"
            f" {LEAST_BLOCKS * LEAST_BLOCK_ROWS} rows are left between the ends; nothing can be fitted"
        )
    step, late = log.motions[0].step, np.max([m.lags for m in log.motions], axis=0)
    if (late > step).any():
        names_late = [j.name for j, lag in zip(base.robot.axes, late, strict=True) if lag > step]
        values = {"joints": names_late, "low": late[late > step].min(), "high": late.max()}
        findings.append(Finding(RobotCode.VELOCITY_LATE, values=values))
    slow = [m.step for m, each in zip(log.motions, logs, strict=True) if m.step > 1.5 * np.median(np.diff(each.time))]
    if slow:
        findings.append(Finding(RobotCode.READ_SELDOM, values={"step": max(slow)}))
    known = _weigh_description(base, prior, payloads)
    scale, free = _read_constants(robot, logs, axes, torque_constants)
    gauge = np.zeros_like(known)
    if free and not known.any() and set(free) >= set(np.flatnonzero(log.counts.any(axis=0))):
        gauge = _set_level(base, log)
    if free:
        scale[free] = _guess_constants(base, log, known + gauge, free)
    log = replace(log, tau=scale * log.tau)
    for k, joint in enumerate(base.robot.axes):
        if not log.counts[:, k].any():
            findings.append(Finding(RobotCode.AXIS_WITHOUT_ROWS, Severity.WARNING, joint.name))
    point, table, chosen, free, untold = _search(log, known, gauge, free)
    guessed = {base.robot.axes[i].name: share for i, share in untold.items()}
    if guessed:
        findings.append(Finding(RobotCode.CONSTANT_UNTOLD, Severity.WARNING, values={"joints": list(guessed)}))
    sums = table.weigh_by_residual(chosen)
    torques = _follow_torques(log, point.move(solve(sums, chosen), log.fastest), free)
    sums = _join_blocks(sums, log, torques, findings)
    every, estimates = max(1, count // SHAKEN_ROWS), []
    # As much noise again shifts the estimates by as much again (Cook, Stefanski, J. American Statistical Association 89, 1994); once with
    # either sign, so that what is linear in the noise cancels.
    for shake in (0.0, 1.0, -1.0):
        again = read(shake, every)
        shaken = fill_table(replace(again, tau=scale * again.tau), known / every, gauge / every, point)
        estimates.append(solve(shaken.weigh_by_residual(chosen), chosen)[chosen])
    bias = (estimates[1] + estimates[2]) / 2 - estimates[0]
    if physical:
        findings.append(_find_physical(base, sums, chosen, bias))
    answer = _Answer(base, table, sums, chosen, sums.take(chosen).fit(), bias, point, free)
    verdict, payload, further, inertias, level = answer.compare_with_description()
    answer = replace(answer, level=level)
    constants, joints = tuple(answer.list_constants()), answer.measure_joints()
    left = torques[0] - torques[2]
    # Of white noise the differences have twice its squares (von Neumann, Annals of Mathematical Statistics 12, 1941).
    roughness = np.nansum(np.diff(left, axis=0) ** 2, axis=0) / np.maximum(2 * np.nansum(left**2, axis=0), 1e-300)
    smooth = {j.name for j, r in zip(base.robot.axes, roughness, strict=True) if r < ROUGH}
    lost = [j.joint for j in joints if j.final > LOST_SHARE * j.torque and j.joint in smooth]
    # A small torque that is followed to the noise of its sensor is no other one.
    strange = [j.joint for j in joints if j.final > (STRANGE_SHARE if j.joint in smooth else LOST_SHARE) * j.torque]
    # Of a torque that is lost nothing is certain, and it takes part in what is said of the rigid bodies; gains compare all joints. Where
    # half of several joints are not followed, the bodies that the others are followed with are none.
    if 2 * len(smooth.intersection(strange)) >= max(len(joints), 3):
        lost = [j.joint for j in joints]
    effects = [
        replace(e, grade=Grade.PROBABLE) if e.joint in (*lost, *guessed) or (strange and e.kind == GAIN.name) else e
        for e in (_scatter(e, guessed.get(e.joint, 0.0)) for e in (*answer.list_effects(), *inertias))
    ]
    if lost:
        verdict, payload = RigidVerdict.OTHER, None
        further = [f for f in further if f.code != RobotCode.SCALED]
    for e in effects:
        if e.rival:
            further.append(Finding(RobotCode.RIVAL, subject=e.joint, values={"kind": e.kind, "rival": e.rival}))
        if e.kind == GAIN.name:
            further.append(Finding(RobotCode.GAIN, subject=e.joint, values={"gain": 1 + e.value}))
    if strange:
        further.append(Finding(RobotCode.NOT_FOLLOWED, Severity.WARNING, values={"joints": strange}))
    if motion := _say_motion(constants):
        values = {"names": [e.name for e in constants if e.is_open], "motion": motion}
        further.append(Finding(RobotCode.OPEN_CONSTANTS, Severity.WARNING, values=values))
    order = [j.name for j in robot.axes]
    return RobotIdentification(
        *(robot.name, robot.source, tuple(names), len(log.counts), len(sums.rows), constants),
        tuple(sorted(effects, key=lambda e: order.index(e.joint))),
        *(joints, tuple(answer.list_torque_constants(scale)), verdict, payload, (*findings, *further)),
        *(np.concatenate([m.time for m in log.motions]), level * torques),
    )


def _weigh_description(base: BaseParameters, prior: float, payloads: Mapping[str, float]) -> np.ndarray:
    """What is known before, as sums of products of the base parameters, a payload's constants if there is one, and the torque."""
    B, sizes = len(base.names), []
    known = np.zeros((B + 1, B + 1))
    if np.isfinite(prior):
        for inertial in base.robot.inertial.reshape(-1, 10):
            # A link of mass m with radius of gyration r: kg, kg m, kg m^2.
            mass, radius = inertial[0], math.sqrt(max(inertial[[4, 6, 9]].sum(), 0.0) / max(inertial[0], 1e-9))
            sizes += [mass, *[mass * radius] * 3, *[mass * radius**2] * 6]
        covariance = base.mixing * (prior * np.array(sizes)) ** 2 @ base.mixing.T
        precision = np.linalg.pinv(covariance, hermitian=True)
        columns = np.column_stack([np.eye(B), base.values])
        known = columns.T @ precision @ columns
    if payloads:
        known = np.insert(np.insert(known, [B] * 10, 0.0, axis=0), [B] * 10, 0.0, axis=1)
        mass = next(iter(payloads.values()))
        row = np.array([1.0, mass]) / (WEIGHED_SHARE * mass)
        known[np.ix_([B, -1], [B, -1])] += np.outer(row, row)
    return np.asarray(known)


def _check_reach(log: Experiment, joint: Joint, number: int) -> None:
    """Raise DataError for positions that are far beyond the limits of a joint: degrees, or another joint."""
    q, reach = {**log.inputs, **log.outputs}[f"q{number}"], joint.upper - joint.lower
    low, high = float(np.nanmin(q)), float(np.nanmax(q))
    if np.isfinite(reach) and (low < joint.lower - reach or high > joint.upper + reach):
        unit = joint.units["q"]
        other = {"rad": "deg", "m": "mm"}[unit]
        raise DataError(
            f"record {log.name!r}: q{number} goes from {low:.4g} to {high:.4g} {unit}, and {joint.name} of the robot from"
            f" {joint.lower:.4g} to {joint.upper:.4g} {unit}; name its column, or state its unit: --column 'q{number} [{other}]=HEADER'"
        )


def _read_constants(
    robot: Robot, logs: Sequence[Experiment], axes: Sequence[int], constants: Mapping[str, float]
) -> tuple[np.ndarray, list[int]]:
    """What each reading is multiplied by (n,) to be a torque, and the axes with a current of which that is not known."""
    columns = [set(log.inputs) | set(log.outputs) for log in logs]
    currents = []
    for k, number in enumerate(axes):
        # Where a record has both, its torque counts.
        has_torque = {f"tau{number}" in names for names in columns if names & {f"tau{number}", f"i{number}"}}
        if len(has_torque) == 2:
            name = robot.axes[k].name
            raise DataError(
                f"joint {name!r} has its torque in one record and its current in another; bring them to one"
            )
        currents += [k] if has_torque == {False} else []
    names = [robot.axes[k].name for k in currents]
    for name, constant in constants.items():
        if name not in names:
            raise DataError(
                f"robot {robot.name!r}: joint {name!r} has a torque constant and no current; {nearest(name, names)}"
            )
        if not constant:
            raise DataError(f"joint {name!r}: a torque constant of zero moves nothing")
    scale = np.array([constants.get(joint.name, 1.0) for joint in robot.axes])
    return scale, [k for k, name in zip(currents, names, strict=True) if name not in constants]


def _set_level(base: BaseParameters, log: JointLog) -> np.ndarray:
    """What sets the level of torques of which all constants are free: on the whole, links are as heavy as described."""
    B, size = len(base.names), log.squares.shape[2]
    squares = log.squares[:, :, :B, :B].sum(axis=(0, 1))
    weight = base.values @ squares @ base.values
    if not weight:
        raise DataError(f"robot {base.robot.name!r}: its description has no masses, and all torque constants are free: nothing tells the"
                        " level of the torques; give one of them (--torque-constant JOINT=VALUE)")  # fmt: skip
    # The factor of the description that follows the torques best, u' beta = 1.
    row = np.zeros(size)
    row[:B], row[-1] = squares @ base.values / weight, 1.0
    return np.asarray(weight * np.outer(row, row))


def _guess_constants(base: BaseParameters, log: JointLog, known: np.ndarray, free: Sequence[int]) -> np.ndarray:
    """Torque constants to begin from: those with which the described links, and friction, follow the currents.

    Where their weight does not show in the current of a joint it begins as the others. The currents alone, ``0 = Y beta + effects - K i``,
    would not do: zero solves that as well, and their noise leads there.
    """
    B = len(known) - 1
    table = fill_table(log, known, np.zeros_like(known), WorkingPoint.start(B, log.tau.shape[1]))
    # i = (described rigid bodies + effects) / K
    mixing = np.zeros((table.joints.shape[2] - 1, 1 + len(USUAL)))
    mixing[: len(base.names), 0], mixing[B : B + len(USUAL), 1:] = base.values, np.eye(len(USUAL))
    fits = [BlockProducts(table.joints[i], table.rows[i]).substitute(mixing, np.zeros(len(mixing))).fit() for i in free]
    shares = np.array([fit.x[0] for fit in fits])
    shows = np.abs(shares) > SHOWN_DEVIATIONS * np.array([fit.std[0] for fit in fits])
    # Friction takes power from a drive: what a drive that only turns its own link gives is of the sign of its speed.
    power = table.joints[list(free), :, B + COLUMNS.index(VISCOUS), -1].sum(axis=1)
    usual = np.median(1 / np.abs(shares[shows])) if shows.any() else 1.0
    return np.where(shows, 1 / np.where(shows, shares, 1.0), np.copysign(usual, power))


def _find_physical(base: BaseParameters, sums: BlockProducts, chosen: Sequence[int], bias: np.ndarray) -> Finding:
    """The constants that bodies can have, and what they cost."""
    B, fit = len(base.names), sums.take(chosen).fit()
    information = np.linalg.pinv(fit.inverse[:B, :B], hermitian=True)
    # Weighed by what is left of each joint, every row has a square of one.
    information += 1e-12 * np.trace(information) * np.eye(B)
    theta, growth = find_physical_constants(base, (fit.x - bias)[:B], information)
    links = {j.link: c.tolist() for j, c in zip(base.robot.joints, theta.reshape(-1, 10), strict=True)}
    return Finding(RobotCode.PHYSICAL, values={"increase": math.sqrt(1 + growth / fit.residual) - 1, "links": links})


def _match_axes(robot: Robot, logs: Sequence[Experiment]) -> tuple[Robot, list[int], list[Finding]]:
    """The robot whose axes the logs have, their numbers there, and what is to be said of the others."""
    names = [set(log.inputs) | set(log.outputs) for log in logs]
    present = set.intersection(*names)
    axes = [k + 1 for k in range(len(robot.axes)) if f"q{k + 1}" in present]
    if not any(f"{reading}{k}" in columns for k in axes for columns in names for reading in ("tau", "i")):
        raise DataError(
            f"robot {robot.name!r} has {len(robot.axes)} axes, and the logs have no axis with both position and torque: columns q1, tau1,"
            " q2, tau2 ... are needed (currents: i1, i2 ...), or the names of the joints, or --column q1=HEADER"
        )
    for log, k in ((log, k) for log in logs for k in axes):
        _check_reach(log, robot.axes[k - 1], k)
    held = {j.name: 0.0 for k, j in enumerate(robot.axes) if k + 1 not in axes}
    findings = [Finding(RobotCode.AXIS_HELD, subject=name) for name in held]
    return (robot.lock(held) if held else robot), axes, findings


def _search(
    log: JointLog, known: np.ndarray, gauge: np.ndarray, free: Sequence[int]
) -> tuple[WorkingPoint, JointTable, list[int], list[int], dict[int, float]]:
    """The linearised table, the columns of the answer; axes that tell their free constant, and the others with the share of their error."""
    base, n, fastest = len(known) - 1, log.tau.shape[1], log.fastest
    joints = np.flatnonzero(log.counts.any(axis=0)).tolist()
    chosen = [*range(base), *(place_column(base, i, k) for i in joints for k in range(len(USUAL)))]

    def settle(point: WorkingPoint, times: int) -> tuple[WorkingPoint, JointTable]:
        table = fill_table(log, known, gauge, point)
        for _ in range(times):
            point = point.move(solve(table.weigh_by_residual(chosen), chosen), fastest)
            table = fill_table(log, known, gauge, point)
        return point, table

    # First with the usual effects alone, which need no load.
    point, table = settle(WorkingPoint.start(base, n), 1)
    gains = {i: place_column(base, i, GAIN) for i in free if i in joints}
    fit = table.weigh_by_residual(chosen).take([*chosen, *gains.values()]).fit()
    # Gains are one where they begin. What is not known to its standard errors would take all effects of its joint along.
    shown = [i for i, std in zip(gains, fit.std[len(chosen) :], strict=True) if std < 1 / NAMED_DEVIATIONS]
    fixed = [gains[i] for i in shown]
    if fixed:
        chosen = sorted([*chosen, *fixed])
        point, table = settle(point, SETTLING)
    while added := _find_unusual(table.weigh_by_residual(chosen), chosen, base, joints, log.motions[0].step):
        for column, value in added:
            joint, kind = kind_of(base, column)
            place = (column - base) % len(COLUMNS)
            if kind is STRIBECK:
                point = widen(point, joint, place, value, fastest[joint])
                chosen.append(place_column(base, joint, WIDTH))
            chosen.append(place_column(base, joint, kind))
        chosen.sort()
        point, table = settle(point, SETTLING)
    while dropped := _find_idle(table.weigh_by_residual(chosen).take(chosen).fit(), chosen, base, fixed, point):
        chosen = [c for c in chosen if c not in dropped]
        for joint, kind in (kind_of(base, c) for c in dropped):
            point.gains[joint] = 1.0 if kind is GAIN else point.gains[joint]
            point.widths[joint] = np.nan if kind is STRIBECK else point.widths[joint]
        point, table = settle(point, 1)
    spread = dict(zip(gains, fit.std[len(fit.std) - len(gains) :].tolist(), strict=True))
    return point, table, chosen, shown, {i: min(std, 1.0) for i, std in spread.items() if i not in shown}


def _find_unusual(
    sums: BlockProducts, chosen: Sequence[int], base: int, joints: Sequence[int], step: float
) -> list[tuple[int, float]]:
    """Of each joint the further effect that takes most, where it takes enough, and its constant."""
    present = {kind_of(base, c) for c in chosen if c >= base}
    kinds = [(i, k) for i in joints for k, kind in enumerate(COLUMNS) if kind is not WIDTH and (i, kind) not in present]
    further = [place_column(base, i, k) for i, k in kinds]
    if not further:
        return []
    promised, left = promise(sums, chosen, further), sums.take(chosen).fit().residual
    best: dict[int, tuple[float, int, float]] = {}
    for k, column in enumerate(further):
        joint, kind = kind_of(base, column)
        # A delay within two rows is how they are written: one between what a drive was told and when it reads, one until the position is.
        least = 0.0 if kind.is_positive else 2 * step * (kind is LAG)
        is_possible = (promised.value[k] if kind.is_positive else abs(promised.value[k])) > least
        # Weighed by what is left of each joint, every joint has the same share of the squares.
        is_large = promised.decrease[k] > UNUSUAL_SHARE * left / len(joints)
        is_clear = promised.share[k] > SEPARABLE_SHARE and abs(promised.ratio[k]) > TRIED_DEVIATIONS
        if is_possible and is_large and is_clear:
            each = (float(promised.decrease[k]), column, float(promised.value[k]))
            best[joint] = max(best.get(joint, (0.0, 0, 0.0)), each)
    # Gains are told from one another: one at a time, and that of the last joint is then no longer separable.
    gains = sorted((each for each in best.values() if kind_of(base, each[1])[1] is GAIN), reverse=True)
    return [(column, value) for _, column, value in best.values() if column not in [each[1] for each in gains[1:]]]


def _find_idle(
    fit: BlockSolution, chosen: Sequence[int], base: int, fixed: Sequence[int], point: WorkingPoint
) -> list[int]:
    """Of each joint the least sure effect that is not sure enough or has the wrong sign, an unusual one before a usual one."""
    worst: dict[int, tuple[bool, float, list[int]]] = {}
    for column, value, std in zip(chosen, fit.x, fit.std, strict=True):
        joint, kind = kind_of(base, column)
        if column < base or column in fixed or kind is WIDTH:
            continue
        ratio = point.complete(kind, joint, value) / (std or np.inf)
        sure = ratio if kind.is_positive else abs(ratio)
        if sure < NAMED_DEVIATIONS:
            together = [column, place_column(base, joint, WIDTH)] if kind is STRIBECK else [column]
            worst[joint] = min(worst.get(joint, (True, np.inf, [])), (kind in USUAL, float(sure), together))
    return [column for *_, columns in worst.values() for column in columns]


def _follow_torques(log: JointLog, point: WorkingPoint, free: Sequence[int]) -> np.ndarray:
    """Torques (3, N, n): measured, of the rigid bodies, with all effects; NaN where a row does not count."""
    rigid, total, _ = point.evaluate(log)
    # Readings are shown as they are, currents as the torques that they give.
    shown = np.ones(len(point.gains))
    shown[list(free)] = point.gains[list(free)]
    torques = np.array([log.tau / shown, rigid, total * point.gains / shown])
    return np.where(log.counts, torques, np.nan)


def _join_blocks(sums: BlockProducts, log: JointLog, torques: np.ndarray, findings: list[Finding]) -> BlockProducts:
    """The sums over blocks that are longer than what is left of the torques remembers."""
    left = np.nan_to_num(torques[0] - torques[2])
    size = 2 ** int(np.ceil(np.log2(2 * len(left))))
    power = np.abs(np.fft.rfft(left, size, axis=0)) ** 2
    correlation = np.fft.irfft(power, size, axis=0)[: len(left) // 2]
    correlation = correlation[:, correlation[0] > 0] / correlation[0, correlation[0] > 0]
    memory = int((correlation < FORGOTTEN).argmax(axis=0).max(initial=0))
    count = log.cycle / (BLOCK_MEMORIES * max(memory, 1))
    if count < LEAST_BLOCKS:
        seconds = {"memory": memory * log.motions[0].step, "rows": log.cycle * log.motions[0].step}
        findings.append(Finding(RobotCode.LONG_MEMORY, Severity.WARNING, values=seconds))
    return sums.merge(int(min(max(count, LEAST_BLOCKS), len(sums.rows))))


@dataclass(frozen=True, eq=False)
class _Answer:
    """The columns that were chosen, fitted; ``bias`` (chosen,) is what the noise of the positions has shifted the estimates by.

    ``point`` is where the table is linearised, ``free`` the axes whose torque constants are fitted, and ``level`` what all torques are
    multiplied by where nothing but the description tells it.
    """

    base: BaseParameters
    table: JointTable
    sums: BlockProducts
    chosen: Sequence[int]
    fit: BlockSolution
    bias: np.ndarray
    point: WorkingPoint
    free: Sequence[int]
    level: float = 1.0

    @cached_property
    def values(self) -> np.ndarray:
        """The estimates (chosen,)."""
        return np.asarray(self.level * (self.fit.x - self.bias))

    @cached_property
    def std(self) -> np.ndarray:
        """Their standard errors (chosen,)."""
        B, inverse = self.table.base, self.fit.inverse
        # What was known before is no block that could be left out: its share of the errors is added.
        known = np.einsum("pb,bc,pc->p", inverse[:, :B], self.table.prior[:-1, :-1], inverse[:, :B])
        return np.asarray(self.level * np.sqrt(self.fit.covariance.diagonal() + known + self.bias**2))

    def list_constants(self) -> Iterator[BaseEstimate]:
        """The base parameters."""
        base, units, links = self.base, np.array(self.base.units), self.base.columns // 10
        for k, name in enumerate(base.names):
            # The largest constant of this unit on the link, or of all links where that is zero; many descriptions have no inertia.
            alike = np.maximum(np.abs(base.values), np.abs(self.values[: len(units)])) * (units == units[k])
            size = (alike * (links == links[k])).max() or alike.max()
            value, std, interval = _spell(self.values[k], self.std[k], self.fit.quantile[k])
            is_open = bool(self.fit.is_open[k] or interval[1] - value > OPEN_SHARE * size)
            described = float(base.values[k])
            yield BaseEstimate(name, base.describe(k), base.units[k], value, std, interval, described, is_open)

    def list_effects(self) -> Iterator[JointEffect]:
        """The effects with their grades."""
        for k, column in enumerate(self.chosen):
            joint, kind = kind_of(self.table.base, column)
            if column >= self.table.base and kind is not WIDTH and not (kind is GAIN and joint in self.free):
                value = self.point.complete(kind, joint, self.values[k])
                spelled = _spell(value, self.std[k], self.fit.quantile[k])
                yield self._make_effect(column, spelled, *self._grade(column, value))

    def list_torque_constants(self, scale: np.ndarray) -> Iterator[TorqueConstant]:
        """The torque constants that were free; ``scale`` (n,) is what the readings were multiplied by."""
        places = {i: list(self.chosen).index(place_column(self.table.base, i, GAIN)) for i in self.free
                  if self.table.rows[i].any()}  # fmt: skip
        spread = self.fit.covariance + np.diag(self.bias**2)
        for i, place in places.items():
            # reading = gain torque, so that a constant is scale / gain; its relative error is that of the gain.
            first, at = next(iter(places.items()))
            gains = np.array([self.point.gains[k] + self.fit.x[p] - self.bias[p] for k, p in ((i, place), (first, at))])
            value, ratio = self.level * scale[i] / gains[0], scale[i] / gains[0] / (scale[first] / gains[1])
            error = self.std[place] / self.level / abs(gains[0])
            # var ln(g1 / gi)
            both = np.array([1.0, -1.0]) / gains
            of_ratio = math.sqrt(max(both @ spread[np.ix_([place, at], [place, at])] @ both, 0.0))
            joint, quantile = self.base.robot.axes[i], self.fit.quantile[place]
            between = _spell(ratio, abs(ratio) * of_ratio, quantile)[2]
            constant = _spell(value, abs(value) * error, quantile)
            yield TorqueConstant(joint.name, *constant, joint.units["tau"] + "/A", ratio, between)

    def _make_effect(
        self, column: int, spelled: tuple[float, float, Interval], grade: Grade, share: float, rival: str
    ) -> JointEffect:
        i, kind = kind_of(self.table.base, column)
        joint = self.base.robot.axes[i]
        return JointEffect(joint.name, kind.name, *spelled, kind.unit_at(joint), grade, share, rival)

    def _grade(self, column: int, value: float) -> tuple[Grade, float, str]:
        """What may be said of an effect, the share of its joint's rms error that it takes, and what would do nearly as well."""
        joint, kind = kind_of(self.table.base, column)
        without = [c for c in self.chosen if c != column]
        share = float(1 - self._rms(self.chosen)[joint] / self._rms(without)[joint])
        known = {kind, WIDTH, *[GAIN] * (joint in self.free)}
        others = [place_column(self.table.base, joint, k) for k, other in enumerate(COLUMNS) if other not in known]
        further = [c for c in others if c not in self.chosen]
        shares = promise(self.sums, self.chosen, further).share
        # Beside everything else that its joint may have, all at once.
        rich = [*self.chosen, *(c for c, s in zip(further, shares, strict=True) if s > SEPARABLE_SHARE)]
        fit, place = self.sums.take(rich).fit(), rich.index(column)
        beside = self.point.complete(kind, joint, fit.x[place])
        # Of two joints the readings tell which is larger, and not which is wrong.
        is_known = kind is not GAIN or self.table.rows.any(axis=1).sum() > 2
        # The column of a gain holds the effect itself, as it is linearised about all of them: that it could replace it says nothing.
        rivals = [c for c in further if kind_of(self.table.base, c)[1] is not GAIN]
        errors = {c: self._fit([*without, c])[0].residual for c in rivals}
        rival = min(errors, key=errors.__getitem__, default=None)
        # What cannot be told apart may do the same in its place: a motor of a lift, its weight less than it is heavy, and an offset.
        left, lost = (self._fit(columns)[0].residual for columns in (self.chosen, without))
        is_alone = rival is None or errors[rival] > left + SAME_SHARE * (lost - left)
        is_clear = beside / fit.std[place] * np.sign(value) > CERTAIN_DEVIATIONS and share > CERTAIN_SHARE
        if is_known and is_clear and is_alone:
            return Grade.ESTABLISHED, share, ""
        return Grade.PROBABLE, share, "" if rival is None else kind_of(self.table.base, rival)[1].name

    def _fit(self, columns: Sequence[int]) -> tuple[BlockSolution, np.ndarray]:
        """The fit of some columns, and constants (P,) with it; gains that are not among them are one, those of currents stand."""
        x = np.zeros(self.sums.size)
        for i, gain in enumerate(self.point.gains):
            at = place_column(self.table.base, i, GAIN)
            columns = [c for c in columns if c != at or i not in self.free]
            x[at] = 0.0 if at in columns or i in self.free else 1 - gain
        fit = self.sums.substitute(np.eye(self.sums.size)[:, list(columns)], x).fit()
        x[list(columns)] = fit.x
        return fit, x

    def _rms(self, columns: Sequence[int]) -> np.ndarray:
        """Rms (n,) that is left of each torque where these columns are fitted."""
        return np.sqrt(self.table.measure(self._fit(columns)[1]))

    def measure_joints(self) -> tuple[JointMisfit, ...]:
        """How well each torque is followed."""
        rms = np.array([self._rms(columns) for columns in ([], range(self.table.base), self.chosen)])
        rms[:, list(self.free)] *= self.level / np.abs(self.point.gains[list(self.free)])
        return tuple(
            JointMisfit(joint.name, joint.units["tau"], int(rows), *map(float, rms[:, i]))
            for i, (joint, rows) in enumerate(zip(self.base.robot.axes, self.table.rows.sum(axis=1), strict=True))
            if rows
        )

    def compare_with_description(self) -> tuple[RigidVerdict, Payload | None, list[Finding], list[JointEffect], float]:
        """Whether the rigid bodies are as described, or a payload on the last link or one factor is the difference.

        Where the links are known, the inertia of each motor shows by itself: those that free links would carry come last.
        """
        base, B, level = self.base, len(self.base.names), self.table.gauge[-1, :-1]
        sums, has_level = self.sums, bool(level.any())
        if has_level:
            # The description itself says the level here.
            left = self.table.measure(solve(sums, self.chosen))
            variances = np.where(np.isfinite(left) & (left > 0), left, 1.0)
            sums = replace(self.table, gauge=0 * self.table.gauge).weigh(variances).merge(len(sums.rows))
        # What joints usually have takes part even where it is not sure: links would take its place.
        beside = [c for c in range(self.table.base, sums.size) if kind_of(self.table.base, c)[1] in (*USUAL, INERTIA)]
        effects = sorted({*range(B, self.table.base), *self.chosen[self.table.base :], *beside})
        whole = sums.take([*range(B), *effects])

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
        factor, spread, between = _spell(scaled.x[0], scaled.std[0], scaled.quantile[0])
        # The first of the ten constants is the mass, then come the first moments.
        loaded = fits[RigidVerdict.PAYLOAD]
        mass, std, interval = _spell(loaded.x[0], loaded.std[0], loaded.quantile[0])
        is_possible = {
            RigidVerdict.AS_DESCRIBED: has_level or abs(factor - 1) <= SCALED_DEVIATIONS * spread,
            RigidVerdict.SCALED: not has_level and abs(factor) > SCALED_DEVIATIONS * spread,
            # A tool that was taken off weighs less than nothing, and no more than its link; beside a free level none can be told.
            RigidVerdict.PAYLOAD: not loaded.is_open[0]
            and abs(mass) > SCALED_DEVIATIONS * std
            and mass > (0 if has_level else -base.robot.joints[-1].inertial[0]),
        }
        errors = {
            verdict: total
            for verdict, each in fits.items()
            # A description without inertia describes nothing.
            if is_possible[verdict] and base.values.any()
            if (total := each.errors.sum()) < (1 + SAME_SHARE) * free.errors.sum()
            or not each.is_worse_than(free, BETTER_DEVIATIONS)
        }
        verdict = min(errors, key=lambda v: (v is not RigidVerdict.AS_DESCRIBED, errors[v]), default=RigidVerdict.OTHER)
        findings, payload, motors = [], None, []
        if verdict is RigidVerdict.SCALED:
            values = {"factor": factor, "low": between[0], "high": between[1]}
            findings = [Finding(RobotCode.SCALED, Severity.WARNING, base.robot.source, values)]
        if verdict is RigidVerdict.PAYLOAD:
            x, y, z = (loaded.x[1:4] / mass).tolist()
            payload = Payload(base.robot.joints[-1].link, mass, std, interval, (x, y, z))
        factor = 1.0
        if has_level:
            level_of = {"source": base.robot.source, "payload": "" if payload is None else payload.link}
            findings.append(Finding(RobotCode.TORQUE_LEVEL, Severity.WARNING, values=level_of))
            # u' beta is one where links are as described, and more where they carry something.
            heavier = level[:B] / self.table.gauge[-1, -1] @ base.mixing[:, -10:] @ loaded.x[:10]
            factor += float(heavier) if payload else 0.0
        if verdict is not RigidVerdict.OTHER:
            best = fits[verdict]
            for k, column in enumerate(effects, len(best.x) - len(effects)):
                is_motor = kind_of(self.table.base, column)[1] is INERTIA and column not in self.chosen
                if is_motor and not best.is_open[k] and best.x[k] > NAMED_DEVIATIONS * best.std[k]:
                    spelled = _spell(best.x[k], best.std[k], best.quantile[k])
                    motors.append(self._make_effect(column, spelled, Grade.PROBABLE, 0.0, ""))
        return verdict, payload, findings, motors, factor


def _spell(value: float, std: float, quantile: float) -> tuple[float, float, Interval]:
    """An estimate with its standard error and its 95 % interval."""
    return float(value), float(std), (float(value - quantile * std), float(value + quantile * std))


def _scatter(effect: JointEffect, share: float) -> JointEffect:
    """An effect whose torque may be off by this share of it."""
    off, (low, high) = share * abs(effect.value), effect.interval
    return replace(effect, std=math.hypot(effect.std, off), interval=(low - 2 * off, high + 2 * off))


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
