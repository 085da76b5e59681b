"""One measured record as a frozen value."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from greybox.base import DataError, Finding, Printable, Severity, nearest
from greybox.data import sampling
from greybox.data.closed_loop import find_loops
from greybox.data.findings import TIMING, RecordCode
from greybox.data.input_course import (
    CourseEvidence,
    Hold,
    Holds,
    choose_courses,
    find_hold_problems,
    find_input_noise,
    inspect_course,
)
from greybox.data.problems import (
    FEW_ROWS,
    RowLabels,
    find_array_problems,
    find_measurement_problems,
    is_constant,
    raise_problems,
)
from greybox.data.sensor_faults import find_strays, inspect_signals, is_first_off

# Rows before a record that it keeps, in sampling intervals: as long as a delay of an input may be (each is a column of the step's input).
MAX_DELAY_ROWS = 200

# The name of a record that nobody named.
UNNAMED = "unnamed record"


@dataclass(frozen=True, eq=False)
class Experiment(Printable):
    """A record of one experiment, in the units of the model it was read for. Arrays are read-only float64.

    Measured arrays are better given to `Experiment.from_arrays`, which also refuses records from which nothing can be learnt.

    Parameters
    ----------
    name
        What results call the record.
    time : array (N,)
        Time in seconds, increasing.
    inputs
        Name -> array (N,), finite.
    outputs
        Name -> array (N,), NaN where nothing was measured.
    hold
        How the inputs move between samples: ``"zero"`` stays until the next row (a computer drives it), ``"first"`` runs straight
        to it (the input itself is a measured, smooth signal), ``"band-limited"`` has no content above half the sampling rate (a
        smooth signal behind an anti-alias filter), ``"auto"`` is first for an input whose values are smooth and carry the noise of a
        sensor, else zero. Or input -> one of these, where inputs move differently; those that are not named are ``"auto"``. What is
        kept is one course for all inputs, else the course of each. ``"mean"`` says that every value, of the outputs too, is the mean over
        the interval that ends at its row (a meter, a logger of energy or weather); stamps at the beginning of each interval change
        nothing then but the clock. Where only some signals are means, a mapping names them; of the outputs all or none.
    source
        The file that it came from.
    conditions
        Constants of this experiment alone, name -> value in the model's unit. And what the model does not speak of (a load, a
        temperature, a voltage, the day): constants that a fit has for each record, and those that a discovery finds, are held against it.
    findings
        What a reader should know about the record. A part keeps those of the whole.
    noise
        Standard deviation of the sensor noise in each row, output -> array (N,), in the unit of the output; for outputs whose noise is
        not the same in all rows (a published table with error bars, a sensor that changes its range).
    before
        Input -> what it was before the first row, for models whose inputs act late: a number, or its values (K,) at ``before_ages``. An
        input that is not named was what it is in the first row. A window keeps what the whole record has before it.
    before_ages : array (K,)
        How long before the first row these values were written, in s, falling; for numbers it is one interval.

    Attributes
    ----------
    sampling_time : float or None
        Seconds between rows; None when time is irregular (rule: `greybox.data.sampling`).
    fingerprint : str
        16 hex digits of the SHA-256 over names and arrays; equal data, equal fingerprint, whatever the file was called.

    Raises
    ------
    DataError
        When lengths differ, time does not increase, or an input is not finite.

    Examples
    --------
    >>> import numpy as np
    >>> time = 0.01 * np.arange(200)
    >>> record = Experiment("run", time, {"u": np.sin(time)}, {"y": np.cos(time)})
    >>> record.rows, record.sampling_time
    (200, 0.01)
    """

    name: str
    time: np.ndarray
    inputs: Mapping[str, np.ndarray]
    outputs: Mapping[str, np.ndarray]
    hold: Holds = "zero"
    source: str = ""
    conditions: Mapping[str, float] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    noise: Mapping[str, np.ndarray] = field(default_factory=dict)
    before: Mapping[str, np.ndarray] = field(default_factory=dict)
    before_ages: np.ndarray = field(default_factory=lambda: np.zeros(0))
    sampling_time: float | None = field(init=False)
    fingerprint: str = field(init=False)

    KEYS: ClassVar[str] = "name rows! duration sampling_time data=fingerprint notes=str(findings) findings"
    """What results say of a record; its data are in its own file."""

    def __post_init__(self) -> None:
        named = self.hold.items() if isinstance(self.hold, Mapping) else ()
        means: dict[str, Hold] = {n: "mean" for n, course in named if course == "mean" and n not in self.inputs}
        # A record whose outputs were left out keeps when they are read.
        problems = find_hold_problems(self.hold, self.inputs, self.outputs or means)
        raise_problems(f"experiment {self.name!r}", problems)
        time = _to_read_only("time", self.time, problems)
        rows = None if problems else len(time)
        inputs = {n: _to_read_only(f"input {n!r}", v, problems, rows) for n, v in self.inputs.items()}
        outputs = {n: _to_read_only(f"output {n!r}", v, problems, rows) for n, v in self.outputs.items()}
        noise = {n: _to_read_only(f"noise of {n!r}", v, problems, rows) for n, v in self.noise.items()}
        problems += [
            f"noise of {n!r}: there is no such output; {nearest(n, outputs)}" for n in noise if n not in outputs
        ]
        both = sorted(set(inputs) & set(outputs))
        problems += [f"{n!r} is both an input and an output; each signal needs its own name" for n in both]
        problems += [
            f"condition {n!r} is {v}; give a finite number" for n, v in self.conditions.items() if not math.isfinite(v)
        ]
        problems = problems or [
            *find_array_problems(time, inputs, outputs, RowLabels()),
            *_find_noise_problems(noise, outputs),
        ]
        raise_problems(f"experiment {self.name!r}", problems)
        before, ages = _look_back(self.before, self.before_ages, time, inputs, problems)
        raise_problems(f"experiment {self.name!r}", problems)
        courses = choose_courses(self.hold, inputs)
        kinds = {*courses.values(), *means.values()}
        # One "mean" for all says it of the outputs too.
        alike = len(kinds) == 1 and (kinds != {"mean"} or self.hold == "mean" or bool(means))
        courses |= means
        values = {
            "time": time,
            "inputs": MappingProxyType(inputs),
            "hold": kinds.pop()
            if alike
            else MappingProxyType(courses)
            if courses
            else "mean"
            if self.hold == "mean"
            else "zero",
            "outputs": MappingProxyType(outputs),
            "conditions": MappingProxyType({n: float(v) for n, v in self.conditions.items()}),
            "findings": tuple(self.findings),
            "noise": MappingProxyType(noise),
            "before": MappingProxyType(before),
            "before_ages": ages,
            "sampling_time": sampling.find_sampling_time(time),
            "fingerprint": _compute_fingerprint(time, inputs, outputs, noise),
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)

    @classmethod
    def from_arrays(
        cls,
        time: ArrayLike,
        inputs: Mapping[str, ArrayLike],
        outputs: Mapping[str, ArrayLike],
        *,
        name: str = UNNAMED,
        hold: Holds = "auto",
        source: str = "",
        conditions: Mapping[str, float] | None = None,
        findings: tuple[Finding, ...] = (),
        noise: Mapping[str, ArrayLike] | None = None,
        before: Mapping[str, ArrayLike] | None = None,
        before_ages: ArrayLike = (),
        allow_constant_input: bool = False,
    ) -> Experiment:
        """A measured record from arrays in the model's units; what it shows of time and sensors goes to ``findings``.

        Parameters
        ----------
        time : array (N,)
            Time in seconds.
        inputs, outputs
            Name -> array (N,); NaN marks gaps of outputs.
        name, hold, source, conditions
            As of `Experiment`.
        findings
            What is known of the record already; what is found here comes after.
        noise, before, before_ages
            As of `Experiment`.
        allow_constant_input
            Accept inputs that are zero throughout (free decay).

        Returns
        -------
        Experiment
            The record with its findings.

        Raises
        ------
        DataError
            Besides what `Experiment` refuses: fewer than 2 rows, an output without any value, a record in which no output moves,
            and inputs that are all constant at zero unless ``allow_constant_input``.
        """
        optional: dict[str, Any] = {"noise": noise or {}, "before": before or {}, "before_ages": before_ages}
        bare = cls(name, time, inputs, outputs, hold, source, conditions or {}, **optional)  # type: ignore[arg-type]
        problems = find_measurement_problems(bare.inputs, bare.outputs, bare.rows, allow_constant_input)
        raise_problems(f"experiment {name!r}", problems)
        seen = inspect_signals(bare.time, bare.inputs, bare.outputs)
        loops = find_loops(bare.inputs, bare.outputs)
        timing = sampling.inspect_timing(bare.time, bare.sampling_time, bare.inputs, bare.outputs)
        asked = hold if isinstance(hold, Mapping) else dict.fromkeys(bare.inputs, hold)
        straight = (n for n, course in bare.courses.items() if course != "zero" and asked.get(n, "auto") == "auto")
        courses = (Finding(RecordCode.INPUT_TAKEN_STRAIGHT, subject=n) for n in straight)
        return replace(bare, findings=(*findings, *seen, *loops, *timing, *courses))

    @property
    def courses(self) -> Mapping[str, Hold]:
        """Input -> how it moves between samples."""
        return (
            {n: self.hold[n] for n in self.inputs}
            if isinstance(self.hold, Mapping)
            else dict.fromkeys(self.inputs, self.hold)
        )

    @cached_property
    def input_noise(self) -> Mapping[str, float]:
        """Input -> standard deviation of the white noise of the sensor that measured it; zero where its values show none."""
        return {n: find_input_noise(values) for n, values in self.inputs.items()}

    @cached_property
    def open_inputs(self) -> frozenset[str]:
        """Inputs that may move by the other course, held or straight, for all that their values show."""
        shown = {n: inspect_course(self.inputs[n], noise) for n, noise in self.input_noise.items()}
        return frozenset(
            n
            for n, course in self.courses.items()
            if course == "first" or (course == "zero" and shown[n] is not CourseEvidence.STEPS)
        )

    @property
    def outputs_are_means(self) -> bool:
        """Whether the outputs are means over the interval that ends at their row."""
        return self.hold == "mean" or (isinstance(self.hold, Mapping) and any(n not in self.inputs for n in self.hold))

    @property
    def identity(self) -> tuple[Any, ...]:
        """What decides a run over the record: its data, the course of each input, what was before it, and its conditions."""
        past = tuple((name, values.tobytes()) for name, values in sorted(self.before.items()))
        courses, conditions = tuple(sorted(self.courses.items())), tuple(sorted(self.conditions.items()))
        return self.fingerprint, courses, self.outputs_are_means, conditions, past, self.before_ages.tobytes()

    @property
    def rows(self) -> int:
        """Number of rows N."""
        return len(self.time)

    @property
    def regular(self) -> bool:
        """Whether the record is sampled uniformly."""
        return self.sampling_time is not None

    @property
    def duration(self) -> float:
        """Seconds from the first row to the last."""
        return float(self.time[-1] - self.time[0])

    @property
    def intervals(self) -> np.ndarray:
        """Lengths (N-1,) in seconds of the intervals between rows, read only: the sampling time if regular, else each its own."""
        if self.sampling_time is None:
            return np.diff(self.time)
        return np.broadcast_to(np.float64(self.sampling_time), (self.rows - 1,))

    def window(self, start_row: int, stop_row: int) -> Experiment:
        """Rows ``start_row`` up to but without ``stop_row``, counted from 0, with the times of the whole record.

        Raises DataError for rows that the record does not have, and for fewer than two.
        """
        if not 0 <= start_row < stop_row - 1 < self.rows:
            raise DataError(
                f"experiment {self.name!r}: window [{start_row}, {stop_row}) does not fit {self.rows} rows;"
                " give 0 <= start, stop <= rows and at least 2 rows"
            )
        cut = slice(start_row, stop_row)
        earlier = slice(max(0, start_row - MAX_DELAY_ROWS), start_row)
        known = len(self.before_ages)
        part = replace(
            self,
            name=f"{self.name}[{start_row}:{stop_row}]",
            time=self.time[cut],
            inputs={n: v[cut] for n, v in self.inputs.items()},
            outputs={n: v[cut] for n, v in self.outputs.items()},
            noise={n: v[cut] for n, v in self.noise.items()},
            before={n: np.append(self.before.get(n, np.full(known, v[0])), v[earlier]) for n, v in self.inputs.items()},
            before_ages=self.time[start_row] - np.concatenate([self.time[0] - self.before_ages, self.time[earlier]]),
        )
        return _with_sampling_time(part, self.sampling_time) if self.regular else part

    def split(self, fraction: float) -> tuple[Experiment, Experiment]:
        """Cut the record in two, each part with its own times: an estimation record and a validation record.

        Parameters
        ----------
        fraction
            Share of the rows in the first part, between 0 and 1.

        Returns
        -------
        tuple of Experiment
            The first ``fraction`` of the rows, and the rest.

        Raises
        ------
        DataError
            For a fraction that is not between 0 and 1, and for one that leaves fewer than two rows on a side.
        """
        if not 0 < fraction < 1:
            raise DataError(
                f"experiment {self.name!r}: cannot split at fraction {fraction:g}; give a number between 0 and 1"
            )
        row = round(fraction * self.rows)
        if min(row, self.rows - row) < 2:
            raise DataError(
                f"experiment {self.name!r}: fraction {fraction:g} splits {self.rows} rows into {row} and"
                f" {self.rows - row}; each part needs at least 2, give a fraction nearer to 0.5"
            )
        return self.window(0, row), self.window(row, self.rows)

    def split_at_time_gaps(self, min_rows: int | None = None) -> tuple[Experiment, ...]:
        """The pieces between gaps in time, each a record of its own with an initial state of its own; itself without gaps.

        A gap is a step of more than one and a half usual ones (`greybox.data.sampling`): the logger dropped out, or two
        runs were pasted together. In it the input is unknown, and what a fit simulates through it is made up. Pieces that are
        sampled alike have the same `sampling_time`.

        Parameters
        ----------
        min_rows
            Pieces of fewer rows, or without a measured value, are left out, which ``findings`` say. None takes the policy's.

        Returns
        -------
        tuple of Experiment
            The pieces in the order of time.

        Raises
        ------
        DataError
            Where no piece is left.
        """
        least = FEW_ROWS if min_rows is None else min_rows
        kept, dropped = sampling.find_pieces(self.time, self.outputs, least)
        if len(kept) + len(dropped) == 1:
            return (self,)
        if not kept:
            longest = max(end - first for first, end in dropped)
            rule = f"the longest has {longest} rows, and a record needs at least {least} with a measured output"
            raise_problems(
                f"experiment {self.name!r}", [f"gaps in time leave {len(dropped)} pieces: {rule}; record it anew"]
            )
        # What the whole record says of its time no longer holds of the pieces.
        findings = [finding for finding in self.findings if finding.code not in TIMING]
        if dropped:
            left_out = [[float(self.time[first]), float(self.time[end - 1]), end - first] for first, end in dropped]
            findings.append(Finding(RecordCode.PIECES_LEFT_OUT, values={"pieces": left_out}))
        parts = [replace(self.window(first, end), findings=tuple(findings)) for first, end in kept]
        step = sampling.find_common_sampling_time([(p.sampling_time, p.rows, p.duration) for p in parts])
        return tuple(parts) if step is None else tuple(_with_sampling_time(part, step) for part in parts)

    def with_hold(self, hold: Holds) -> Experiment:
        """The same record with another course of the inputs between samples, or of those that a mapping names."""
        if isinstance(hold, Mapping):
            means: dict[str, Hold] = dict.fromkeys(self.outputs if self.outputs_are_means else (), "mean")
            hold = {**self.courses, **means, **hold}
        return _with_sampling_time(replace(self, hold=hold), self.sampling_time)

    def with_outputs(self, outputs: Mapping[str, np.ndarray]) -> Experiment:
        """The same record with these outputs, name -> (N,), in place of its own; none for the inputs alone."""
        noise = {n: v for n, v in self.noise.items() if n in outputs}
        return _with_sampling_time(replace(self, outputs=outputs, noise=noise), self.sampling_time)

    def without_spikes(self) -> Experiment:
        """The same record without the readings that jump away from their neighbours and back within one row; its findings say so."""
        outputs, findings = {}, [f for f in self.findings if f.code != RecordCode.SENSOR_SPIKES]
        for name, y in self.outputs.items():
            rows = np.flatnonzero(np.isfinite(y))
            spikes = find_strays(y, list(self.inputs.values()))
            spikes = np.append(rows[:1], spikes) if is_first_off(y[rows]) else spikes
            outputs[name] = np.where(np.isin(np.arange(self.rows), spikes), np.nan, y)
            findings += [Finding(RecordCode.SPIKES_LEFT_OUT, subject=name, values={"count": len(spikes)})] * bool(
                len(spikes)
            )
        return _with_sampling_time(replace(self, outputs=outputs, findings=tuple(findings)), self.sampling_time)

    def __reduce__(self) -> tuple[Any, ...]:
        # Read-only mappings cannot be pickled and arrays lose their protection: rebuild through the constructor.
        values = {f.name: getattr(self, f.name) for f in fields(self) if f.init}
        values |= {n: dict(v) for n, v in values.items() if isinstance(v, Mapping)}
        return _restore, (values, self.sampling_time)


def find_usual_interval(experiments: Iterable[Experiment]) -> float:
    """Seconds between the rows of the slowest record."""
    return max(float(np.median(e.intervals)) for e in experiments)


def stack_signals(signals: Sequence[np.ndarray], rows: int) -> np.ndarray:
    """Signals (N,) as columns (N, n); a single one is not copied."""
    if len(signals) == 1:
        return signals[0][:, None]
    return np.column_stack(signals) if signals else np.zeros((rows, 0))


def collect_record_findings(experiments: Iterable[Experiment], *, is_robust: bool = False) -> tuple[Finding, ...]:
    """The findings of several records, each once, with the records that it holds for under ``values["records"]``.

    Parameters
    ----------
    experiments
        The records, in the order in which their findings are to stand.
    is_robust
        Whether a robust loss is asked for: spikes then count among its outliers, and ask for nothing more.

    Returns
    -------
    tuple of Finding
        As the records have them, with ``records``: the files, or the names of records without a file.
    """
    experiments, findings, names = list(experiments), dict[str, Finding](), dict[str, dict[str, None]]()
    # One signal moves in one way; where it stands still any is right.
    courses = {
        n: {e.courses[n] for e in experiments if n in e.courses and np.ptp(e.inputs[n]) > 0}
        for e in experiments[:1]
        for n in e.inputs
    }
    differing = [
        Finding(RecordCode.INPUT_COURSES_DIFFER, Severity.WARNING, n, {"courses": sorted(seen)})
        for n, seen in courses.items()
        if len(seen) > 1
    ]
    for experiment in experiments:
        for finding in experiment.findings:
            if is_robust and finding.code == RecordCode.SENSOR_SPIKES:
                continue
            key = json.dumps([finding.code, finding.subject, dict(finding.values)], default=str)
            findings.setdefault(key, finding)
            names.setdefault(key, {})[experiment.source or experiment.name] = None
    each = (replace(f, values={**f.values, "records": list(names[key])}) for key, f in findings.items())
    return (*differing, *each)


def as_records(records: Experiment | Iterable[Experiment]) -> tuple[Experiment, ...]:
    """One record or several, as a tuple. Raises DataError for what is none, such as a data frame."""
    if isinstance(records, Experiment):
        return (records,)
    strange = (
        records if hasattr(records, "columns") else next((r for r in records if not isinstance(r, Experiment)), None)
    )
    if strange is not None:
        raise DataError(
            f"a {type(strange).__name__} is no record; make one of it with the model whose columns it has:"
            " gb.read_csv(table, model)"
        )
    return tuple(records)


def number_unnamed_records(experiments: Iterable[Experiment]) -> tuple[Experiment, ...]:
    """The records, those that nobody named as ``record 1``, ``record 2``, by their place in the list."""
    return tuple(
        _with_sampling_time(replace(e, name=f"record {number}"), e.sampling_time) if e.name == UNNAMED else e
        for number, e in enumerate(experiments, 1)
    )


def name_records(records: Experiment | Iterable[Experiment]) -> tuple[Experiment, ...]:
    """One record or several, as a tuple, each with a name."""
    return number_unnamed_records(as_records(records))


def _restore(values: Mapping[str, Any], sampling_time: float | None) -> Experiment:
    return _with_sampling_time(Experiment(**values), sampling_time)


def _with_sampling_time(experiment: Experiment, sampling_time: float | None) -> Experiment:
    # The whole record knows the step better than a part of it, and equal steps make equal discrete models.
    object.__setattr__(experiment, "sampling_time", sampling_time)
    return experiment


def _to_read_only(what: str, values: ArrayLike, problems: list[str], rows: int | None = None) -> np.ndarray:
    """A read-only copy (N,) in float64, or the array itself if it is one; what is wrong with it is added to ``problems``."""
    given = np.asarray(values)
    owned = given.flags.owndata and not given.flags.writeable and given.dtype == np.float64
    try:
        # Text and complex numbers would be converted by numpy, the latter by dropping half of them.
        if given.dtype.kind not in "biufO":
            raise TypeError(f"its type is {given.dtype}")
        array = given if owned else np.array(given, dtype=np.float64)
    except (TypeError, ValueError) as error:
        problems.append(f"{what} does not hold real numbers: {error}")
        return np.zeros(0)
    if array.ndim != 1:
        problems.append(f"{what} has shape {array.shape}; give one number for each row, shape (N,)")
    elif rows is not None and len(array) != rows:
        problems.append(f"{what} has {len(array)} rows, time has {rows}; each signal needs one value for each time")
    array.setflags(write=False)
    return array


def _look_back(
    before: Mapping[str, ArrayLike],
    ages: ArrayLike,
    time: np.ndarray,
    inputs: Mapping[str, np.ndarray],
    problems: list[str],
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """What is told of the inputs before the first row as arrays (K,), and their ages; what is wrong is added to ``problems``."""
    given = {n: np.atleast_1d(np.asarray(v, float)) for n, v in before.items() if np.size(v)}
    ages = np.array(ages, float) if np.size(ages) or not given else time[1:2] - time[:1]
    problems += [f"before: there is no input {n!r}; {nearest(n, inputs)}" for n in given if n not in inputs]
    for name, values in given.items():
        if values.shape != ages.shape or not np.isfinite(values).all():
            problems.append(
                f"before: {name!r} is {values}; give a finite number, or one for each of the {len(ages)} ages"
            )
    if not (np.isfinite(ages).all() and np.all(np.diff(ages) < 0) and np.all(ages > 0)):
        problems.append(f"before_ages are {ages}; give seconds above 0, falling")
    return given, ages


def _find_noise_problems(noise: Mapping[str, np.ndarray], outputs: Mapping[str, np.ndarray]) -> list[str]:
    """What is no standard deviation, where the output was measured."""
    problems = []
    for name, std in noise.items():
        wrong = np.flatnonzero(np.isfinite(outputs[name]) & ~(np.isfinite(std) & (std > 0)))
        if len(wrong):
            problems.append(
                f"noise of {name!r} is {std[wrong[0]]:g} in row {wrong[0] + 1}; give a positive standard deviation for each measured row"
            )
    return problems


def _compute_fingerprint(
    time: np.ndarray,
    inputs: Mapping[str, np.ndarray],
    outputs: Mapping[str, np.ndarray],
    noise: Mapping[str, np.ndarray],
) -> str:
    """16 hex digits of the SHA-256 over names and values, whatever the order of the signals."""
    digest = hashlib.sha256()
    for kind, signals in (("time", {"time": time}), ("input", inputs), ("output", outputs), ("noise", noise)):
        for name, values in sorted(signals.items()):
            digest.update(f"{kind} {name} {len(values)}\n".encode())
            # One bit pattern for every NaN and for both zeros, the same on every machine.
            digest.update((np.where(np.isnan(values), np.nan, values) + 0.0).astype("<f8").tobytes())
    return digest.hexdigest()[:16]


# Gaps in the time of a record that nothing may be simulated through.
#
# In a gap nobody knows the input: it is taken to continue. That does little harm over a few rows, or where the drive rests.
# A simulation through a long gap of a moving input answers an input that was never there, so that whatever follows the gap
# contradicts the model. Such a record is two records (`Experiment.split_at_time_gaps`). The same holds where the equations are
# integrated in steps, whatever the input does: every interval of a record takes as many of them as its longest.

SPLIT_REMEDY = "split the record there with split_at_time_gaps() (shell: --split-holes)"


class UnknownInputGap(NamedTuple):
    """A gap from ``start`` to ``stop`` (s) of ``rows`` missing rows; ``change`` of the input in it, over its standard deviation."""

    start: float
    stop: float
    rows: int
    name: str
    change: float


class GapError(DataError):
    """A record that cannot be run through a gap in its time, and can be split there."""


def refuse_unknown_input(records: Iterable[Experiment]) -> None:
    """Raise DataError for a record with a long gap in which an input moves on, unknown; it names the longest."""
    for record in records:
        gaps = _find_unknown_input(record)
        if gaps:
            worst = max(gaps, key=lambda gap: gap.rows)
            more = f" (and {len(gaps) - 1} more)" if len(gaps) > 1 else ""
            reason = (
                f"{worst.rows} rows are missing, and over such a time input {worst.name!r} changes by {worst.change:.2g} times its"
                " standard deviation, so that a simulation through the gap is meaningless"
            )
            remedy = f"{SPLIT_REMEDY}, or fill in the missing rows of the input and leave the outputs empty"
            _refuse_gap(record, worst.start, worst.stop, more, f"{reason}; {remedy}")


def refuse_long_time_gaps(records: Iterable[Experiment]) -> None:
    """Raise DataError for a record with a long gap: of a model that is integrated in steps."""
    for record in records:
        longest = max(_find_long_gaps(record), key=lambda gap: gap[1], default=None)
        if longest:
            k, rows = longest
            reason = (
                f"{rows} rows are missing, and a model that is integrated in steps takes as many of them in every interval as in the"
                " longest"
            )
            _refuse_gap(record, float(record.time[k]), float(record.time[k + 1]), "", f"{reason}; {SPLIT_REMEDY}")


def _refuse_gap(record: Experiment, start: float, stop: float, more: str, reason: str) -> None:
    raise GapError(f"experiment {record.name!r}: time has a gap from {start:.6g} to {stop:.6g} s{more}: {reason}")


# Missing rows from which a gap is long; fewer do little harm to a simulation.
LONG_GAP_ROWS = 20


def _find_long_gaps(record: Experiment) -> list[tuple[int, int]]:
    """Each long gap of ``record``: the row before it, and how many rows are missing."""
    usual = float(np.median(np.diff(record.time)))
    gaps = sampling.find_time_gaps(record.time)
    missing = [(int(k), round(float(record.time[k + 1] - record.time[k]) / usual) - 1) for k in gaps]
    return [(k, rows) for k, rows in missing if rows >= LONG_GAP_ROWS]


# Rows before and after a gap in which an input that rests shows that it rests.
NEIGHBOURHOOD_ROWS = 20
# Time differences, up to the length of a gap, over which the change of an input is measured.
LAGS_TRIED = 12
# Change of an input (rms, over its standard deviation) in a gap, from which it is known no better than by its mean.
LOST_INPUT_CHANGE = 1.0


def _find_unknown_input(record: Experiment) -> list[UnknownInputGap]:
    """The gaps of ``record`` through which no simulation means anything."""
    after, near = sampling.find_time_gaps(record.time), NEIGHBOURHOOD_ROWS
    unknown = []
    for k, rows in _find_long_gaps(record):
        around = slice(max(0, k + 1 - near), k + 1 + near)
        moving = {name: u for name, u in record.inputs.items() if not is_constant(u[around])}
        changes = {name: _measure_change(u, after, k, rows, LAGS_TRIED) for name, u in moving.items()}
        worst = max(changes, key=lambda name: changes[name], default="")
        if worst and changes[worst] >= LOST_INPUT_CHANGE:
            start, stop = float(record.time[k]), float(record.time[k + 1])
            unknown.append(UnknownInputGap(start, stop, rows, worst, changes[worst]))
    return unknown


def _measure_change(u: np.ndarray, after: np.ndarray, k: int, rows: int, lags_tried: int) -> float:
    """How much the input ``u`` (N,) changes in a gap of ``rows`` rows after row ``k``, in its standard deviations.

    The larger of what it does elsewhere in up to as many rows (rms, no pair is across a gap) and of the jump across this one.
    """
    pieces = np.split(u, after + 1)
    lags = np.unique(np.geomspace(1, rows, lags_tried).astype(int))
    changes = [np.concatenate([p[lag:] - p[:-lag] for p in pieces if len(p) > lag] or [[]]) for lag in lags]
    elsewhere = max((float(np.sqrt(np.mean(m**2))) for m in changes if len(m)), default=0.0)
    return max(elsewhere, float(abs(u[k + 1] - u[k]))) / float(np.std(u))
