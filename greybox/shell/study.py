"""A study: everything that decides what `fit`, `discover`, `compare` and `check` compute. Every field is defined here.

Each field of `Study` says how it is spelled as an option of the command line, under which key it stands in a study file, which
commands use it, and its help. `greybox.shell.options` makes the options of the commands from it, `greybox.shell.study_file` reads
and writes the file.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from enum import StrEnum
from pathlib import Path
from types import MappingProxyType
from typing import Any

from greybox.shell import completion
from greybox.shell.study_values import (
    Choice,
    CommaNames,
    Conditions,
    Count,
    Counts,
    Files,
    Headers,
    Kind,
    Names,
    Numbers,
    Priors,
    Quantity,
    Schedules,
    Switch,
    Table,
    Word,
)

FIT, COMPARE, DISCOVER, CHECK, SIMULATE = "fit", "compare", "discover", "check", "simulate"
STUDY_COMMANDS = (FIT, COMPARE, DISCOVER, CHECK)
"""The commands that read a study file."""


class HoldName(StrEnum):
    """How the input moves between samples."""

    zero = "zero"
    first = "first"
    band_limited = "band-limited"


class MethodName(StrEnum):
    """How the equations are integrated."""

    automatic = "automatic"
    exact = "exact"
    rk4 = "rk4"
    mixed = "mixed"
    midpoint = "midpoint"
    radau = "radau"


class TranscriptionName(StrEnum):
    """How a record becomes a cost."""

    automatic = "automatic"
    single = "single"
    multiple = "multiple"
    collocation_radau = "collocation-radau"
    collocation_legendre = "collocation-legendre"
    arcs = "arcs"


@dataclass(frozen=True)
class Spec:
    """How one field of a study is written.

    ``flag`` on the command line, "" for the arguments MODEL and DATA; ``table`` and ``key`` in the file, both "" where the
    whole table is the field; ``commands`` that use it; ``help`` for all commands, or by command.
    """

    kind: Kind
    flag: str
    table: str
    key: str
    commands: tuple[str, ...]
    help: str | Mapping[str, str]
    metavar: str = ""
    complete: Callable[..., Any] | None = None
    show_default: bool = False

    @property
    def place(self) -> str:
        """The place of the field in a study file: ``[records] skip``, ``[noise]`` or ``model``."""
        return " ".join(part for part in (f"[{self.table}]" if self.table else "", self.key) if part)

    def help_for(self, command: str) -> str:
        """The help that ``command`` shows."""
        return self.help if isinstance(self.help, str) else self.help[command]


def _study_field(
    kind: Kind, flag: str, place: str, commands: tuple[str, ...], text: str | Mapping[str, str], **more: Any
) -> Any:
    """A field of `Study`; ``place`` is ``table.key``, ``key`` at the top of the file, or ``table.`` for a whole table."""
    table, _, key = place.rpartition(".")
    spec = Spec(kind, flag, table, key, commands, text, **more)
    return field(default_factory=lambda: kind.empty, metadata={"spec": spec})


_ALL = STUDY_COMMANDS
_FITS = (FIT, COMPARE)
_FITS_AND_CHECK = (FIT, COMPARE, CHECK)


@dataclass(frozen=True)
class Study:
    """What decides the result of a command. Values are as the library takes them: numbers in the model's units."""

    model: str = field(default="", metadata={"spec": Spec(Word(), "", "", "model", (*_ALL, SIMULATE), "")})
    estimation: tuple[Path, ...] = field(
        default=(), metadata={"spec": Spec(Files(), "", "records", "estimation", _ALL, "")}
    )
    effects: tuple[str, ...] = _study_field(
        Names(split=True),
        "--effect",
        "effects",
        (*_FITS_AND_CHECK, SIMULATE),
        "Add an effect of the catalogue, such as coulomb_friction.",
        metavar="NAME",
        complete=completion.effects,
    )
    candidates: tuple[str, ...] = _study_field(
        CommaNames(),
        "--effects",
        "candidates",
        (COMPARE, DISCOVER),
        {
            COMPARE: "Also fit MODEL with each of these effects of the catalogue; A+B adds both effects to one model.",
            DISCOVER: "Test only these effects of the catalogue; none: no effect, only equations, as with --laws. [default: all]",
        },
        metavar="NAME,...",
        complete=completion.effects,
    )
    without: tuple[str, ...] = _study_field(
        Names(split=True),
        "--without",
        "without",
        (DISCOVER,),
        "Do not try this effect of the catalogue; may be repeated.",
        metavar="NAME",
        complete=completion.effects,
    )
    without_family: tuple[str, ...] = _study_field(
        Names(split=True),
        "--without-family",
        "without_family",
        (DISCOVER,),
        "Do not try this effect, nor those that contain it or that it contains (coulomb_friction: all dry friction).",
        metavar="NAME",
        complete=completion.effects,
    )
    further: bool = _study_field(
        Switch(),
        "--further",
        "further",
        (DISCOVER,),
        "Search for smaller effects even where the residual is noise. Where more is left, they are always searched for.",
    )
    laws: bool = _study_field(
        Switch(),
        "--laws",
        "laws",
        (DISCOVER,),
        "Where no effect is established or more than noise is left, look for the equation that is missing.",
    )
    outputs: tuple[str, ...] = _study_field(
        Names(split=True),
        "--outputs",
        "outputs",
        (CHECK,),
        "Assume that only this output is measured; may be repeated.",
        metavar="NAME",
    )
    fixed: Mapping[str, float | None] = _study_field(
        Numbers(bare="as declared"),
        "--fix",
        "fixed.",
        _ALL,
        "Fix a known parameter at VALUE, in its unit; NAME alone fixes it at the value in the model.",
        metavar="NAME=VALUE",
        complete=completion.constants,
    )
    start: Mapping[str, float] = _study_field(
        Numbers(),
        "--start",
        "start.",
        _ALL,
        "Start value of a parameter, in its unit.",
        metavar="NAME=VALUE",
        complete=completion.constants,
    )
    free: tuple[str, ...] = _study_field(
        Names(),
        "--free",
        "parameters.free",
        _ALL,
        "Fit a parameter that the model declares fixed.",
        metavar="NAME",
        complete=completion.constant_names,
    )
    priors: Mapping[str, tuple[float, float]] = _study_field(
        Priors(),
        "--prior",
        "priors.",
        (*_FITS, DISCOVER),
        "Prior of a parameter, mean and standard deviation, such as M=0.0100+-0.0001; it counts as a measurement.",
        metavar="NAME=MEAN+-STD",
        complete=completion.constants,
    )
    ties: Mapping[str, str] = _study_field(
        Table(shape="NAME=FORMULA", example="Kv=Kf"),
        "--tie",
        "ties.",
        (*_FITS_AND_CHECK, DISCOVER),
        "Tie a parameter to others by a formula, such as Kv=Kf or K2=3*K1.",
        metavar="NAME=FORMULA",
        complete=completion.constants,
    )
    time_limit: float = _study_field(
        Quantity(),
        "--time",
        "search.time",
        (FIT, DISCOVER),
        {
            FIT: "With --starts: begin no further start after so many seconds, and take the best so far.",
            DISCOVER: "End the search after so many seconds, with the best answer so far. The same command continues it.",
        },
        metavar="SECONDS",
    )
    per_experiment: tuple[str, ...] = _study_field(
        Names(split=True),
        "--own",
        "parameters.per_record",
        _FITS,
        "Fit a separate value of this parameter in each record.",
        metavar="NAME",
        complete=completion.constant_names,
    )
    schedules: Mapping[str, tuple[str, float | None]] = _study_field(
        Schedules(),
        "--schedule",
        "schedule.",
        _FITS,
        "Let a parameter depend on a condition or an input, such as K2=P_S@8e5; the fitted value is the one at VALUE.",
        metavar="NAME=CONDITION[@VALUE]",
        complete=completion.constants,
    )
    conditions: Mapping[str, tuple[float, ...] | None] = _study_field(
        Conditions(),
        "--condition",
        "conditions.",
        _ALL,
        "A parameter with a known value in each record: one value for each record in order (--validate last). NAME alone"
        " reads it from each file: a column of that name, or a comment line such as '# P_S = 801 kPa'.",
        metavar="NAME[=V1,V2,...]",
    )
    process_noise: Mapping[str, float | None] = _study_field(
        Numbers(bare="estimated"),
        "--process-noise",
        "process_noise.",
        _FITS,
        "Add process noise to a state. The fit then minimises the prediction error with a Kalman filter and estimates the"
        " intensity of the noise; VALUE fixes the intensity, in the state's unit over sqrt(s).",
        metavar="STATE[=VALUE]",
        complete=completion.states,
    )
    noise: Mapping[str, float] = _study_field(
        Numbers(shape="OUTPUT=STD", example="x=2e-7"),
        "--noise",
        "noise.",
        _ALL,
        "Standard deviation of the sensor noise of an output, in the model's unit. [default: estimated]",
        metavar="OUTPUT=STD",
        complete=completion.outputs,
    )
    common_noise: bool = _study_field(
        Switch(),
        "--common-noise",
        "estimation.common_noise",
        (FIT, COMPARE),
        "Outputs whose noise is not given have one unknown noise in common and are weighed alike; they must have one unit.",
    )
    quiet: tuple[Path, ...] = _study_field(
        Files(),
        "--quiet",
        "records.quiet",
        (FIT, COMPARE, DISCOVER),
        "A record with the input at rest and the same columns, to estimate the noise from; may be repeated.",
        metavar="FILE",
    )
    validation: tuple[Path, ...] = _study_field(
        Files(),
        "--validate",
        "records.validation",
        (FIT, COMPARE, DISCOVER),
        "A validation record, which is not fitted; may be repeated.",
        metavar="FILE",
    )
    skip: int = _study_field(
        Count(0),
        "--skip",
        "records.skip",
        (*_FITS, DISCOVER),
        "Number of rows to ignore at the start of each validation record.",
        metavar="N",
        show_default=True,
    )
    beginning: int = _study_field(
        Count(0),
        "--beginning",
        "records.beginning",
        (*_FITS, DISCOVER),
        "Number of rows at the start of each validation record from which its initial state is estimated; they are ignored as"
        " --skip ignores rows. 0: those of --skip, or the first 50, and more where these do not determine it; they then count.",
        metavar="N",
        show_default=True,
    )
    hold: str = _study_field(
        Choice(HoldName),
        "--hold",
        "records.hold",
        (*_ALL, SIMULATE),
        "The input between samples: zero (held), first (straight lines) or band-limited.",
        show_default=True,
    )
    interpolation: Mapping[str, str] = _study_field(
        Table(shape="INPUT=COURSE", example="u=first"),
        "--interpolate",
        "interpolation.",
        (*_ALL, SIMULATE),
        "How an input with stamps of its own moves between its samples, if not as --hold says: zero, first or band-limited.",
        metavar="INPUT=COURSE",
    )
    at_rest: bool = _study_field(
        Switch(),
        "--at-rest",
        "records.at_rest",
        _ALL,
        "Start each record at the initial state of the model instead of estimating the initial state.",
    )
    free_decay: bool = _study_field(
        Switch(),
        "--free-decay",
        "records.free_decay",
        _FITS_AND_CHECK,
        "Accept records with zero input throughout (free response of the plant).",
    )
    split_holes: bool = _study_field(
        Switch(),
        "--split-holes",
        "records.split_holes",
        _ALL,
        "Split records where time has a gap or restarts (a logger dropout, or several runs in one file).",
    )
    columns: Mapping[str, str] = _study_field(
        Table(shape="NAME=HEADER", example="x=Laser"),
        "--column",
        "columns.",
        (*_ALL, SIMULATE),
        "Header of the column that contains a signal or the time, if it differs from NAME; or its number, counted from 1.",
        metavar="NAME=HEADER",
        complete=completion.signals,
    )
    headers: tuple[str, ...] = _study_field(
        Headers(),
        "--columns",
        "records.columns",
        (*_ALL, SIMULATE),
        "Names of all columns in their order, such as 'time [ms],u,-,x', for files without a header and for matrices; - leaves a"
        " column out.",
        metavar="NAME,...",
    )
    sampling_time: float = _study_field(
        Quantity(),
        "--sampling-time",
        "records.sampling_time",
        _ALL,
        "Seconds between rows, for records without a time column; the common step of signals with stamps of their own.",
        metavar="SECONDS",
    )
    read_limit: float = _study_field(
        Quantity(),
        "--read-limit",
        "records.read_limit",
        (*_ALL, SIMULATE),
        "Raise the limits on the size of record files by this factor.",
        metavar="FACTOR",
    )
    method: str = _study_field(
        Choice(MethodName),
        "--method",
        "integration.method",
        (*_FITS_AND_CHECK, SIMULATE),
        "Integration method: automatic, exact (linear models), rk4, mixed, or midpoint and radau (stiff models).",
        show_default=True,
    )
    substeps: int = _study_field(
        Count(0),
        "--substeps",
        "integration.substeps",
        (*_FITS_AND_CHECK, SIMULATE),
        "Integration steps in each sampling interval; 0 selects the number automatically.",
        metavar="N",
        show_default=True,
    )
    loss: str = _study_field(
        Word("squares"),
        "--loss",
        "estimation.loss",
        _FITS,
        "squares, or a robust loss that limits the influence of outliers: huber, student. K: the residual in noise standard"
        " deviations beyond which huber grows linearly, or the degrees of freedom of student.",
        metavar="NAME[:K]",
        show_default=True,
    )
    transcription: str = _study_field(
        Choice(TranscriptionName),
        "--transcription",
        "estimation.transcription",
        _FITS,
        "single: one free run of each record. multiple: segments joined by continuity (unstable plants). collocation: the"
        " equations solved at collocation points, states within their bounds. arcs: pieces of --arc-length without continuity."
        " automatic selects by the model.",
        show_default=True,
    )
    arc_length: float = _study_field(
        Quantity(),
        "--arc-length",
        "estimation.arc_length",
        _FITS,
        "Fit arcs of this length, each with its own initial state: short arcs show structure, long arcs show drift.",
        metavar="SECONDS",
    )
    starts: int = _study_field(
        Count(1, 1),
        "--starts",
        "estimation.starts",
        _FITS,
        "Fit from N start points, the model's own and N-1 random ones, on all cores; prints the result of each.",
        metavar="N",
        show_default=True,
    )
    seed: int | None = _study_field(
        Count(0, None),
        "--seed",
        "estimation.seed",
        _FITS,
        "Seed of the random --starts. [default: 0]",
        metavar="N",
    )
    predict: tuple[int, ...] = _study_field(
        Counts(),
        "--predict",
        "estimation.predict",
        _FITS,
        "Also print the prediction error K samples ahead, with the simulation error; may be repeated, 0 for none."
        "  [default: 1]",
        metavar="K",
    )
    profiles: tuple[str, ...] = _study_field(
        Names(split=True),
        "--profile",
        "profile",
        (FIT,),
        "Also compute the interval of this parameter by profile likelihood (10 to 20 refits); may be repeated.",
        metavar="NAME",
    )
    bootstrap: int = _study_field(
        Count(0),
        "--bootstrap",
        "bootstrap",
        (FIT,),
        "Also compute intervals of all parameters by a block bootstrap with N replicates (1000 suffice).",
        metavar="N",
    )
    file: Path | None = None
    from_file: frozenset[str] = frozenset()
    unused: tuple[str, ...] = ()
    """Places in the study file that the command ignores."""

    def __post_init__(self) -> None:
        for name, spec in SPECS.items():
            if isinstance(spec.kind, Table):
                object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))

    def label(self, name: str) -> str:
        """How a message names a field: by its option, or by its place in the study file it came from."""
        spec = SPECS[name]
        return f"{self.file}, {spec.place}" if self.file is not None and name in self.from_file else spec.flag

    @property
    def uncounted(self) -> int:
        """Rows at the start of each validation record that the errors leave out."""
        return max(self.skip, self.beginning)

    @property
    def folder(self) -> Path | None:
        """The folder of the study file, None without a file."""
        return None if self.file is None else self.file.parent


def fields_of(command: str) -> dict[str, Spec]:
    """The fields that ``command`` uses, by name, in their order."""
    return {name: spec for name, spec in SPECS.items() if command in spec.commands}


SPECS: Mapping[str, Spec] = MappingProxyType(
    {f.name: f.metadata["spec"] for f in fields(Study) if f.metadata}  # every field that a person writes
)
"""How each field is written, by name."""
