"""A rig as a program: it reads the CSV file of an input and writes the CSV file of a record."""

from __future__ import annotations

import contextlib
import math
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import BinaryIO

import numpy as np

from greybox.base import DataError, GreyboxError, shorten, write_file
from greybox.data import Experiment, read_csv
from greybox.data.signals import SignalLimit
from greybox.model import Model

PLACES = ("{input}", "{record}", "{number}")
"""What a command may hold: the file to read, the file to write, and the number of the experiment."""


# Characters of a rig program's own last words that are shown.
MESSAGE_LENGTH = 200


def run_rig(
    command: str, asked: Path, target: Path, number: int, duration: float, timeout: float, held: BinaryIO | None = None
) -> None:
    """Run a rig program once; its record becomes ``target`` when it is whole.

    Parameters
    ----------
    command
        The program with its arguments, as in a shell (but none is started). ``{input}``, ``{record}`` and ``{number}`` are put in;
        a command without the first two gets both files at its end.
    asked, target
        The input to play, and where the record goes.
    number
        Number of the experiment.
    duration
        Of the record in seconds.
    timeout
        Seconds that the program may take beyond that.
    held
        A file of `greybox.base.files.hold_file` that the program holds as long as it runs: where this process is killed, nobody starts a
        second program beside the one that still moves the rig.

    Raises
    ------
    DataError
        For a program that is not there, fails, hangs, or writes nothing.
    """
    with tempfile.TemporaryDirectory(prefix="greybox-rig-") as folder:
        # The record appears in the campaign's folder whole or not at all: what a killed program has half written is
        # thrown away.
        part = Path(folder) / "record.csv"
        words = _split(command)
        if not any("{input}" in w or "{record}" in w for w in words):
            words += ["{input}", "{record}"]
        values = dict(zip(PLACES, (str(asked.absolute()), str(part), str(number)), strict=True))
        typed = list(words)
        for mark, value in values.items():
            typed = [word.replace(mark, value) for word in typed]
        # Beyond the record's own length: a rig plays in real time.
        code, output = _run(typed, timeout + duration, number, held)
        last = shorten(output.strip().splitlines()[-1] if output.strip() else "", MESSAGE_LENGTH)
        if code != 0:
            reason = f": {last}" if last else ""
            raise DataError(
                f"rig {words[0]!r}: ended with exit code {code} in experiment {number}{reason}; nothing was kept"
            )
        if not part.is_file():
            raise DataError(
                f"rig {words[0]!r}: wrote no record in experiment {number}; it must write the file that it is given as {{record}}"
            )
        write_file(target, part.read_bytes())


def check_command(command: str) -> None:
    """Refuse a rig program that could not be run, before anything is computed for it.

    Raises
    ------
    GreyboxError
        For quotes that do not close, for an empty command, for a place that nothing is put into, and for a program that is not there.
    """
    words = _split(command)
    unknown = [place for word in words for place in re.findall(r"\{[a-z]+\}", word) if place not in PLACES]
    if unknown:
        raise GreyboxError(f"rig {words[0]!r}: nothing is put in for {unknown[0]}; known: {', '.join(PLACES)}")
    placed = [place for place in PLACES[:2] if any(place in word for word in words)]
    if len(placed) == 1:
        missing = next(place for place in PLACES[:2] if place not in placed)
        raise GreyboxError(f"rig {words[0]!r}: {placed[0]} is put in and {missing} is not; give both, or neither")
    if shutil.which(words[0]) is None:
        raise GreyboxError(f"rig {words[0]!r}: no such program; give the path of a program that may be run")


# Rms difference between the input that was asked for and the one in the record, as a share of its range: more is another record.
INPUT_TOLERANCE = 0.05


def read_record(path: Path, asked: Experiment, model: Model) -> Experiment:
    """The record that answers an input.

    Raises
    ------
    DataError
        For a file that cannot be read, and for a record of another input or sampling.
    """
    record = read_csv(path, model, hold=asked.hold)
    step = asked.sampling_time or 0.0
    # Rows are those that were asked for; the clock of a rig may be a little off.
    if record.rows != asked.rows or not math.isclose(record.duration, asked.duration, rel_tol=INPUT_TOLERANCE):
        raise DataError(
            f"{path}: another record: {record.rows} rows over {record.duration:g} s, and {asked.rows} rows every {step:g} s were asked for;"
            " delete it, and play input.csv"
        )
    for name, u in asked.inputs.items():
        span = float(np.ptp(u)) or max(float(np.abs(u).max()), 1.0)
        off = float(np.sqrt(np.mean((record.inputs[name] - u) ** 2))) / span
        if off > INPUT_TOLERANCE:
            raise DataError(
                f"{path}: another record: its input {name} differs from input.csv by {100 * off:.0f} % of its range; delete it, and play"
                " input.csv"
            )
    return record


# Share of the range of a limit by which a measured signal may pass it, beside its noise.
RIG_LIMIT_TOLERANCE = 0.01
# Standard deviations of the noise by which a measured signal may pass a limit.
NOISE_DEVIATIONS = 4.0


def find_broken_limits(
    record: Experiment, limits: Mapping[str, SignalLimit], noise: Mapping[str, float]
) -> dict[str, float]:
    """Each measured signal that passed its limit by more than its noise, with the value that lies farthest outside."""
    broken = {}
    for name, values in {**record.inputs, **record.outputs}.items():
        limit = limits.get(name)
        known = values[np.isfinite(values)]
        if limit is None or not len(known):
            continue
        ends = [e for e in (limit.low, limit.high) if math.isfinite(e)]
        span = limit.high - limit.low if len(ends) == 2 else abs(ends[0]) if ends else 0.0
        slack = RIG_LIMIT_TOLERANCE * span + NOISE_DEVIATIONS * noise.get(name, 0.0)
        if known.max() > limit.high + slack:
            broken[name] = float(known.max())
        elif known.min() < limit.low - slack:
            broken[name] = float(known.min())
    return broken


def _split(command: str) -> list[str]:
    try:
        words = shlex.split(command, posix=os.name != "nt")
    except ValueError as error:
        raise GreyboxError(
            f"rig {shorten(command)!r}: cannot be read as a command ({error}); check its quotes"
        ) from None
    if not words:
        raise GreyboxError("rig: the command is empty; give the program that plays an input")
    return words


def _run(words: list[str], seconds: float, number: int, held: BinaryIO | None) -> tuple[int, str]:
    """Exit code and output of a program, which is ended with all that it started where it takes too long, or on Ctrl-C."""
    try:
        process = subprocess.Popen(
            words,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            # A group of its own, so that what the program starts ends with it.
            start_new_session=True,
            # The open file keeps the lock as long as the program runs, whatever becomes of this process.
            pass_fds=() if held is None or sys.platform == "win32" else (held.fileno(),),
        )
    except OSError as error:
        raise DataError(
            f"rig {words[0]!r}: cannot be run ({error.strerror or error}); give the path of a program that may be run"
        ) from None
    try:
        output, _ = process.communicate(timeout=seconds)
    except subprocess.TimeoutExpired:
        _end(process)
        raise DataError(
            f"rig {words[0]!r}: did not end within {seconds:.0f} s in experiment {number} and was stopped; check the rig, then run the same"
            " command again"
        ) from None
    except BaseException:  # raised again
        _end(process)
        raise
    return process.returncode, output


def _end(process: subprocess.Popen[str]) -> None:
    """End a program and what it started."""
    with contextlib.suppress(OSError):  # it has ended meanwhile
        if hasattr(os, "killpg"):
            os.killpg(process.pid, signal.SIGKILL)
        else:
            process.kill()
    process.communicate()
