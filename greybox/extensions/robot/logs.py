"""Joint logs read by the names of joints: ``shoulder_pan_joint.position``, ``effort_shoulder_pan`` as ROS and its tools write them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from greybox.base import DataError, Finding, Severity, shorten
from greybox.data.columns import split_signal
from greybox.data.experiment import Experiment
from greybox.data.file_kinds import open_record_file
from greybox.data.headers import TIME, parse_header, read_time
from greybox.data.notation import converts
from greybox.data.policy import READING_POLICY
from greybox.data.read import read_experiments
from greybox.extensions.robot.description import Robot
from greybox.extensions.robot.model import RobotPlant
from greybox.extensions.robot.result import RobotCode

# Words of a header that say what of a joint a column is.
QUANTITIES = {
    "q": ("position", "positions", "pos", "angle", "q"),
    "dq": ("velocity", "velocities", "vel", "speed", "dq", "qd"),
    "tau": ("effort", "efforts", "torque", "torques", "tau", "force"),
    "i": ("current", "currents", "cur", "amps", "i"),
}
# Words of columns that were not measured, or are none of these quantities.
OTHERS = {
    *("desired", "target", "command", "commanded", "cmd", "ref", "reference", "setpoint", "goal", "error", "err"),
    *("acceleration", "accelerations", "accel", "acc", "ddq", "qdd"),
    *("temperature", "temp", "voltage", "volt", "mode", "status", "load", "pwm", "duty", "fault", "online"),
}
# Words that say the unit of a joint's column.
UNITS = {
    **dict.fromkeys(("deg", "degs", "degree", "degrees"), "deg"),
    "rad": "rad",
    "nm": "N*m",
    "amps": "A",
    "mm": "mm",
}
# Columns of a log that counts axes from zero: each of its numbers would be that of another axis here.
COUNTED_FROM_ZERO = {f"{signal}0" for signal in QUANTITIES}
_WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+")


def read_joint_logs(
    plant: RobotPlant,
    paths: Sequence[str | Path],
    *,
    columns: Mapping[str, str] | Sequence[str] | None = None,
    **reading: Any,
) -> tuple[Experiment, ...]:
    """Read logs of a robot, with columns ``q1``, ``tau1`` ... or called by the names of its joints.

    Parameters
    ----------
    plant
        The robot.
    paths
        The files.
    columns
        As of `greybox.read_csv`; signals may be called by the names of joints as well (``"effort_elbow [A]": "ch7"``).
    reading
        Further options of `greybox.data.read.read_experiments`.

    Returns
    -------
    tuple of Experiment
        The records; a finding says which joints were found by their names.

    Raises
    ------
    DataError
        With every problem of the files, and where several columns may be the same quantity of a joint.
    """
    if columns is not None and not isinstance(columns, Mapping):
        named: Any = [_rename(name, plant.robot) for name in columns]
        columns_found: dict[str, str] = {}
    else:
        given = {_rename(key, plant.robot): header for key, header in (columns or {}).items()}
        columns_found, names = {}, [joint.name for joint in plant.robot.axes]
        for path in paths:
            headers = open_record_file(path, policy=reading.get("reading", READING_POLICY)).table.headers
            mapped = {split_signal(key)[0] for key in given}
            zero = [
                header for header in headers if parse_header(header, 0).name in COUNTED_FROM_ZERO - set(given.values())
            ]
            if zero:
                raise DataError(
                    f"{Path(path).name}: there is a column {zero[0]!r}, and the axes of a robot are counted from 1; name each:"
                    " --column q1=q0 --column tau1=tau0 --column q2=q1 ..."
                )
            columns_found |= _find_columns(headers, plant.robot, mapped, Path(path).name)
            called = {parse_header(header, 0).name for header in (*headers, *columns_found)}
            if not {output.name for output in plant.log_model.outputs} & {*mapped, *called}:
                raise DataError(
                    f"{Path(path).name}: no column is called q1, tau1 ... or by a joint of the robot ({shorten(', '.join(names))}); its"
                    f" headers are {shorten(', '.join(headers))}; name them: --column q1=HEADER"
                )
        named = {**columns_found, **given}
    logs = read_experiments(
        paths, plant.log_model, columns=named or None, **{"allow_constant_input": True, "hold": "first", **reading}
    )
    if not columns_found.keys() - {TIME}:
        return logs
    numbers = sorted({int(re.sub(r"\D", "", signal)) for signal in columns_found if signal != TIME})
    unsaid = (
        h for k, h in columns_found.items() if k.startswith("tau") and "[" not in k and not parse_header(h, 0).unit
    )
    units = sorted({split_signal(key)[1] for key in columns_found} - {""})
    values = {"units": units, "joints": [plant.robot.axes[k - 1].name for k in numbers], "effort": next(unsaid, "")}
    note = Finding(RobotCode.JOINTS_BY_NAME, Severity.NOTE, values=values)
    return tuple(replace(log, findings=(*log.findings, note)) for log in logs)


def _find_columns(headers: Sequence[str], robot: Robot, taken: set[str], file: str) -> dict[str, str]:
    """Signal -> header that names a joint, of those that are not ``taken`` and have no header of their own."""
    parsed = [parse_header(header, k) for k, header in enumerate(headers)]
    taken = taken | {column.name for column in parsed}
    # ROS calls it stamp, timestamp or __time, and counts from 1970.
    times = [
        column for column in parsed if read_time(column) == column and not _find_signal(column.name, column.unit, robot)
    ]
    is_timed = TIME in taken or any(column.is_time for column in parsed)
    columns_found: dict[str, str] = {} if is_timed or len(times) != 1 else {TIME: times[0].header}
    for column, header in zip(parsed, headers, strict=True):
        signal = _find_signal(column.name, column.unit, robot)
        if not signal or split_signal(signal)[0] in taken:
            continue
        if signal in columns_found:
            raise DataError(
                f"{file}: both {columns_found[signal]!r} and {header!r} may be {signal} of the robot; choose by --column {signal}=HEADER"
            )
        columns_found[signal] = header
    return columns_found


def _rename(key: str, robot: Robot) -> str:
    """A signal that is called by a joint as ``q1 [deg]``, with its unit; others as they are."""
    name, unit = split_signal(key)
    signal = _find_signal(name, unit, robot)
    return f"{signal} [{unit}]" if signal and unit else signal or key


def _find_signal(name: str, unit: str, robot: Robot) -> str:
    """``tau2`` where a name holds that of the second axis and says torque, ``q2 [deg]`` where it says so; "" for what names no joint."""
    words = _split(name)
    hits = [
        (len(spelling), number, words[:at] + words[at + len(spelling) :])
        for spelling, number in _spell_joints(robot).items()
        for at in range(len(words) - len(spelling) + 1)
        if words[at : at + len(spelling)] == spelling
    ]
    if not hits:
        return ""
    _, number, rest = max(hits)
    if not number or OTHERS & set(rest):
        return ""
    quantity = next((signal for signal, known in QUANTITIES.items() if set(known) & set(rest)), "")
    joint = robot.axes[number - 1]
    units = {signal: joint.units[signal] for signal in QUANTITIES}
    unit_word = "" if unit else next((UNITS[word] for word in rest if word in UNITS), "")
    if (stated := unit or unit_word) and not (quantity and converts(stated, units[quantity])):
        # ROS writes efforts of some drives in amperes.
        quantity = next((s for s, one in units.items() if quantity in ("", "tau") and converts(stated, one)), "")
        if not quantity:
            return ""
    return f"{quantity or 'q'}{number}" + (f" [{unit_word}]" if unit_word else "")


def _spell_joints(robot: Robot) -> dict[tuple[str, ...], int]:
    """How the axes may be called, in words: as described, and without what all begin with or the word joint; 0 is a joint that follows."""
    names = [_split(joint.name) for joint in robot.axes]
    shared = 0
    while len(names) > 1 and len({name[shared : shared + 1] for name in names}) == 1:
        shared += 1
    spellings: dict[tuple[str, ...], set[int]] = {}
    for number, name in enumerate(names, 1):
        short = name[shared:]
        plain = (tuple(w for w in words if w != "joint") for words in (name, short))
        for each in (name, short, *plain, ("joint", *short)):
            # A number alone would take q1 for the joint that is called 1.
            if any(not word.isdigit() for word in each):
                spellings.setdefault(each, set()).add(number)
    followers = {_split(joint.name): 0 for joint in robot.joints if joint.tie is not None}
    return {spelling: min(numbers) for spelling, numbers in spellings.items() if len(numbers) == 1} | followers


def _split(name: str) -> tuple[str, ...]:
    return tuple(word.lower() for word in _WORD.findall(name))
