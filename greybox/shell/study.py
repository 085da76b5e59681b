"""A study: everything that a command is told. The one table of options, the commands as values, and what options do to one another.

An `Option` is a field of `Study`: how it is written on the command line and in a study file, and its help. A `Command` names the options
that it uses, and a function from a study to an `Answer`. The command line, study files, `--write-study`, Tab and the reference are
made from these values (`greybox.shell.command_line`, `greybox.shell.study_file`).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import count, takewhile
from pathlib import Path
from types import MappingProxyType
from typing import Any, Generic, Self, TypeVar, overload

from greybox.base import ExitCode, GreyboxError
from greybox.base.texts import to_word
from greybox.shell import completion
from greybox.shell import study_values as kinds

T = TypeVar("T")
# Stands for a record that is still to be taken.
ANOTHER_RECORD = Path("ANOTHER_RECORD.csv")
HOLDS = ("auto", "zero", "first", "band-limited", "mean")
METHODS = ("automatic", "exact", "rk4", "mixed", "midpoint", "radau")
TRANSCRIPTIONS = ("automatic", "single", "multiple", "collocation-radau", "collocation-legendre", "arcs")


@dataclass(frozen=True, eq=False)
class Option(Generic[T]):
    """One option: a field of `Study`, whose value is read as an attribute of a study.

    Attributes
    ----------
    kind
        What its values are, and how they are written.
    usage
        As it is typed: ``--skip N``, ``--set --start NAME=VALUE``, or ``MODEL`` for an argument.
    place
        Where it stands in a study file: ``records.skip``, ``profile`` at the top, ``fixed.`` for a whole table; "" for what is no part
        of a study.
    help
        One sentence or two. ``[default: ...]`` in it takes the place of the default that is shown otherwise.
    complete
        What Tab offers.
    required
        Whether a command refuses to run without it.
    """

    kind: kinds.Kind[T]
    usage: str
    place: str
    help: str
    complete: Callable[..., Any] | None = None
    required: bool = False
    name: str = ""

    def __set_name__(self, owner: type, name: str) -> None:
        object.__setattr__(self, "name", name)

    @overload
    def __get__(self, study: None, owner: type) -> Option[T]: ...
    @overload
    def __get__(self, study: Study, owner: type) -> T: ...
    def __get__(self, study: Study | None, owner: type) -> Option[T] | T:
        return self if study is None else study.values.get(self.name, self.kind.empty)

    def __set__(self, study: Study, value: T) -> None:
        raise AttributeError(f"{self.name}: a study does not change; study.but({self.name}=...) is another one")

    def but(self, **changes: Any) -> Option[T]:
        """The same option in the words of another command."""
        return replace(self, **changes)

    def takes(self, value: Any) -> bool:
        """Whether this is a value of the option in these words: another command may offer fewer."""
        try:
            self.kind.from_toml(self.label, self.kind.to_toml(value))
        except GreyboxError:
            return False
        return True

    @property
    def flags(self) -> list[str]:
        """``["--skip"]``; empty for an argument."""
        return [word for word in self.usage.split() if word.startswith("-")]

    @property
    def flag(self) -> str:
        """How messages name it: its first spelling, or the argument."""
        return self.usage.split()[0]

    @property
    def metavar(self) -> str:
        """What stands for its value: ``N``; "" for a switch."""
        return self.usage.split()[-1].replace(self.flags[-1], "") if self.flags else self.usage

    @property
    def table(self) -> str:
        """Its table in a study file, "" at the top."""
        return self.place.rpartition(".")[0]

    @property
    def key(self) -> str:
        """Its key in that table, "" where the whole table is its value."""
        return self.place.rpartition(".")[2]

    @property
    def label(self) -> str:
        """The place as a message names it: ``[records] skip``, ``[noise]`` or ``model``."""
        return " ".join(part for part in (f"[{self.table}]" if self.table else "", self.key) if part)


_RECORDS = "Records to fit: CSV, MAT, MF4, TDMS and others, headers 'name [unit]'."
_MODEL = "Name of a model (see greybox models), or a model file: my/rig.py, my/rig.py:name."


class Study:
    """The values of options, as the library takes them: numbers in the model's units.

    Parameters
    ----------
    **values
        Name of an option -> value; the others have that of their kind.

    Attributes
    ----------
    command
        Name of the command, and in ``options`` the options as that command words them.
    file
        The study file it was read from, None without one; ``from_file`` names what stands there, ``unused`` the places in it that the
        command ignores.
    definition
        What the model stated when the file was written: its equations, and a line for each other name (`greybox.model.equations.declare`);
        empty where the file does not say.
    """

    # A table: an option is a row or two.
    # fmt: off
    model = Option(kinds.ModelName(), "MODEL", "model", _MODEL, completion.models, required=True)
    source = Option(kinds.ModelName(), "FIT", "source", "The fit.json that greybox fit has written, or its folder.", required=True)
    estimation = Option(kinds.Files(), "DATA", "records.estimation", _RECORDS)
    input = Option(kinds.File(), "INPUT", "input", "File with time and the model's inputs; or select a test signal.")
    effects = Option(kinds.Names(split=True), "--effect NAME", "effects",
        "Add an effect of the catalogue, such as coulomb_friction.", completion.effects)
    candidates = Option(kinds.CommaNames(), "--effects NAME,...", "candidates",
        "Test only these effects of the catalogue; none: no effect, only equations, as with --laws; may be repeated."
        " [default: those that the model lists, else all]",
        completion.effects)
    without = Option(kinds.Names(split=True), "--without NAME", "without",
        "Do not try this effect of the catalogue; may be repeated.", completion.effects)
    without_family = Option(kinds.Names(split=True), "--without-family NAME", "without_family",
        "Do not try this effect, nor those that contain it or that it contains (coulomb_friction: all dry friction).", completion.effects)
    has = Option(kinds.Names(split=True), "--has PART", "has",
        "The rig has this part, such as gear or fluid (docs: catalogue); may be repeated. What is usual with it comes first.",
        completion.parts)
    lacks = Option(kinds.Names(split=True), "--lacks PART", "lacks",
        "The rig has no such part: effects that need it are not tried; may be repeated.", completion.parts)
    further = Option(kinds.Switch(), "--further", "further",
        "Search for smaller effects even where only noise of a known level is left.")
    laws = Option(kinds.Switch(), "--laws", "laws",
        "Where no effect is established or more than noise is left, look for the equation that is missing.")
    outputs = Option(kinds.Names(split=True), "--outputs NAME", "outputs", "Assume that only this output is measured; may be repeated.")
    fixed = Option(kinds.Numbers(bare="as declared"), "--fix NAME=VALUE", "fixed.",
        "Fix a known parameter at VALUE, in its unit; NAME alone fixes it at the value in the model.", completion.constants)
    start = Option(kinds.Numbers(), "--start NAME=VALUE", "start.", "Start value of a parameter, in its unit.", completion.constants)
    free = Option(kinds.Names(), "--free NAME", "parameters.free",
        "Fit a parameter that the model declares fixed.", completion.constant_names)
    priors = Option(kinds.Priors(), "--prior NAME=MEAN+-STD", "priors.",
        "Prior of a parameter, mean and standard deviation, such as M=0.0100+-0.0001; it counts as a measurement.", completion.constants)
    ties = Option(kinds.Table("NAME=FORMULA", "Kv=Kf"), "--tie NAME=FORMULA", "ties.",
        "Tie a parameter to others by a formula, such as Kv=Kf or K2=3*K1.", completion.constants)
    time_limit = Option(kinds.Quantity(), "--time SECONDS", "search.time",
        "With --starts: begin no further start after so many seconds, and take the best so far.")
    per_experiment = Option(kinds.Names(split=True), "--own NAME", "parameters.per_record",
        "Fit a separate value of this parameter in each record.", completion.constant_names)
    schedules = Option(kinds.Schedules(), "--schedule NAME=CONDITION[@VALUE]", "schedule.",
        "Let a parameter depend on a condition or an input, such as K2=P_S@8e5; the fitted value is the one at VALUE.",
        completion.constants)
    conditions = Option(kinds.Conditions(), "--condition NAME[=V1,V2,...]", "conditions.",
        "A parameter with a known value in each record: one value for each record in order (--validate, then --test last). NAME alone"
        " reads it from each file: a column of that name, or a comment line such as '# P_S = 801 kPa'. Any other name, such as load=1,6.1,"
        " is what --own parameters, and those that a discovery finds, are held against.")
    process_noise = Option(kinds.Numbers(bare="estimated"), "--process-noise STATE[=VALUE]", "process_noise.",
        "Add process noise to a state. The fit then minimises the prediction error with a Kalman filter and estimates the"
        " intensity of the noise; VALUE fixes the intensity, in the state's unit over sqrt(s).", completion.states)
    noise = Option(kinds.NamedLevels("OUTPUT=STD", "x=2e-7"), "--noise OUTPUT=STD", "noise.",
        "Standard deviation of the sensor noise of an output, in the model's unit; or a name, which outputs of one unknown noise share:"
        " x1=a x2=a. [default: estimated]", completion.outputs)
    common_noise = Option(kinds.Switch(), "--common-noise", "estimation.common_noise",
        "Outputs whose noise is not given have one unknown noise in common and are weighed alike; they must have one unit.")
    quiet = Option(kinds.Files(), "--quiet FILE", "records.quiet",
        "A record with the input at rest and the same columns, to estimate the noise from; may be repeated.")
    validation = Option(kinds.Files(), "--validate FILE", "records.validation",
        "A validation record, which is not fitted; may be repeated.")
    test = Option(kinds.Files(), "--test FILE", "records.test",
        "A record that takes no part in the search: the answer is held against the plain model there, and its error is told;"
        " may be repeated.")
    skip = Option(kinds.Count(), "--skip N", "records.skip", "Number of rows to ignore at the start of each validation record.")
    beginning = Option(kinds.Count(), "--beginning N", "records.beginning",
        "Number of rows at the start of each validation record from which its initial state is estimated; they are ignored as"
        " --skip ignores rows. 0: those of --skip, or the first 50, and more where these do not determine it; they then count.")
    hold = Option(kinds.Choice(HOLDS), "--hold", "records.hold",
        "The inputs between samples: zero (held), first (straight lines), band-limited, mean (every value, of outputs too, is the mean"
        " over the interval that ends at its row), or auto: first for an input that is smooth and carries the noise of a sensor, else"
        " zero.")
    interpolation = Option(kinds.Table("INPUT=COURSE", "u=first"), "--interpolate INPUT=COURSE", "interpolation.",
        "How an input moves between its samples, if not as --hold says: zero, first, band-limited or mean; OUTPUT=mean for outputs that"
        " are means.")
    before = Option(kinds.Numbers("INPUT=VALUE", "u=0"), "--before INPUT=VALUE", "before.",
        "What an input was before each record, in the model's unit, for models whose inputs act late. [default: its first value]",
        completion.signals)
    at_rest = Option(kinds.Switch(), "--at-rest", "records.at_rest",
        "Start each record at the initial state of the model instead of estimating the initial state.")
    settled = Option(kinds.Switch(), "--settled", "records.settled",
        "Start each record where the model comes to rest under its first inputs and conditions: a rig under a load, a culture before its"
        " experiment.")
    free_decay = Option(kinds.Switch(), "--free-decay", "records.free_decay",
        "Accept records with zero input throughout (free response of the plant).")
    split_holes = Option(kinds.Switch(), "--split-holes", "records.split_holes",
        "Split records where time has a gap or restarts (a logger dropout, or several runs in one file).")
    first_time = Option(kinds.Moment(), "--from TIME", "records.from",
        "The part of each record from this time on: seconds of its time, or a date or time of day where the file has them"
        " ('2024-03-31 08:00'). Times stay those of the whole record; quiet records are taken whole.")
    last_time = Option(kinds.Moment(), "--until TIME", "records.until", "The part of each record up to this time, as --from says.")
    columns = Option(kinds.ColumnHeaders(), "--column NAME=HEADER", "columns.",
        "Header of the column that contains a signal or the time, if it differs from NAME; or its number, counted from 1. NAME may state"
        " the unit of the column, as in 'time [ms]=millis'.",
        completion.signals)
    headers = Option(kinds.Headers(), "--columns NAME,...", "records.columns",
        "Names of all columns in their order, such as 'time [ms],u,-,x', for files without a header and for matrices; - leaves a"
        " column out.")
    sampling_time = Option(kinds.Quantity(), "--sampling-time SECONDS", "records.sampling_time",
        "Seconds between rows, for records without a time column; the common step of signals with stamps of their own.")
    read_limit = Option(kinds.Quantity(), "--read-limit FACTOR", "records.read_limit",
        "Raise the limits on the size of record files by this factor.")
    method = Option(kinds.Choice(METHODS), "--method", "integration.method",
        "Integration method: automatic, exact (linear models), rk4, mixed, or midpoint and radau (stiff models).")
    substeps = Option(kinds.Count(), "--substeps N", "integration.substeps",
        "Integration steps in each sampling interval; 0 selects the number automatically.")
    loss = Option(kinds.Word("squares"), "--loss NAME[:K]", "estimation.loss",
        "squares, or a robust loss that limits the influence of outliers: huber, student. K: the residual in noise standard"
        " deviations beyond which huber grows linearly, or the degrees of freedom of student.")
    transcription = Option(kinds.Choice(TRANSCRIPTIONS), "--transcription", "estimation.transcription",
        "single: one free run of each record. multiple: segments joined by continuity (unstable plants). collocation: the"
        " equations solved at collocation points, states within their bounds. arcs: pieces of --arc-length without continuity."
        " automatic selects by the model.")
    arc_length = Option(kinds.Quantity(), "--arc-length SECONDS", "estimation.arc_length",
        "Fit arcs of this length, each with its own initial state: short arcs show structure, long arcs show drift.")
    starts = Option(kinds.Count(1, 1), "--starts N", "estimation.starts",
        "Fit from N start points, the model's own and N-1 random ones, on all cores; prints the result of each.")
    seed = Option(kinds.Seed(), "--seed N", "estimation.seed", "Seed of the random --starts. [default: 0]")
    predict = Option(kinds.Counts(), "--predict K", "estimation.predict",
        "Also print the prediction error K samples ahead, with the simulation error; may be repeated, 0 for none.  [default: 1]")
    profiles = Option(kinds.Names(split=True), "--profile NAME", "profile",
        "Also compute the interval of this parameter by profile likelihood (15 to 25 refits), or the region of two, A:B; may be repeated.")
    bootstrap = Option(kinds.Count(), "--bootstrap N", "bootstrap",
        "Also compute intervals of all parameters by a block bootstrap with N replicates (1000 suffice).")
    # A run of a model, and what a rig allows.
    step = Option(kinds.MaybeNumber(), "--step HEIGHT", "step", "Test signal: a step at the first row.")
    multisine = Option(kinds.MaybeNumber(), "--multisine RMS", "multisine",
        "Test signal: sines of equal amplitude and random phase in --band.")
    chirp = Option(kinds.MaybeNumber(), "--chirp AMPLITUDE", "chirp", "Test signal: a sine swept through --band.")
    band = Option(kinds.FrequencyBand(), "--band LOW:HIGH", "band", "Band of a multisine or chirp in Hz.")
    offset = Option(kinds.Number(), "--offset VALUE", "offset", "Offset added to the test signal.")
    duration = Option(kinds.Quantity(), "--duration SECONDS", "duration", "Duration of the record.")
    initial = Option(kinds.Numbers("STATE=VALUE", "x=0.001"), "--initial STATE=VALUE", "initial.",
        "Initial value of a state, in its unit.", completion.states)
    limits = Option(kinds.Limits(), "--limit NAME=LOW:HIGH", "limits.",
        "Range of an input, output or state, in its unit; an end may be left out, as in --limit x=:1e-4.", completion.signals)
    rates = Option(kinds.Numbers("NAME=R", "u=100"), "--rate NAME=R", "rates.", "Largest change of an input in a second, in its unit.")
    draws = Option(kinds.Count(), "--seed N", "seed", "Seed of the noise and of the phases of --multisine.")
    # What is no part of a study: where results go, how they are shown, who computes.
    output = Option(kinds.File(), "--output DIR", "", "Folder for the results.")
    workers = Option(kinds.Count(idle=1), "--workers N", "",
        "Processes that share the work, on this machine or in --cluster local. [default: one for each core]")
    cluster = Option(kinds.Word(), "--cluster ADDRESS", "",
        "Scheduler of a Dask cluster that does the work, such as tcp://10.0.0.5:8786; local starts one here, to try.")
    silent = Option(kinds.Switch(), "--quiet-output -q", "", "Print nothing but errors.")
    json = Option(kinds.Switch(), "--json", "", "Print the result as JSON instead of text.")
    details = Option(kinds.Switch(), "--details", "", "Print all that is known of the result, and not its answer alone.")
    figures = Option(kinds.Switch(), "--figures", "",
        "Also write the figures of the report as PNG, SVG and PDF, and the constants of a fit as a LaTeX table.")
    no_report = Option(kinds.Switch(), "--no-report", "", "Do not write report.html.")
    # Commands around the project.
    some_model = Option(kinds.ModelName(), "MODEL", "",
        "The model: its name or its file. Without MODEL, all are listed.", completion.models)
    added = Option(kinds.Names(split=True), "--effect NAME", "", effects.help, completion.effects)
    own_name = Option(kinds.Word(), "NAME", "", "With keep: what the effect is called.")
    kept_result = Option(kinds.File(), "--result FILE", "", "With keep: the discovery.json. [default: the newest in results/]")
    directory = Option(kinds.File(), "DIR", "", "Folder for the project; created if it does not exist.", required=True)
    plant = Option(kinds.Word(), "--plant NAME", "",
        "Start from one plant with a simulated twin and a study file: chamber, circuit, cylinder, rotary-drive, stage, "
        "tank-chain, tanks, thermal or two-mass.")
    force = Option(kinds.Switch(), "--force", "", "Overwrite existing files.")
    json_command = Option(kinds.Word(), "COMMAND", "", "The command: fit, discover, changed, check ...", completion.commands, required=True)
    opened = Option(kinds.Switch(), "--open", "", "Open the report in the browser at the end.")
    # fmt: on

    def __init__(
        self,
        *,
        command: str = "",
        options: Mapping[str, Option[Any]] = MappingProxyType({}),
        file: Path | None = None,
        from_file: Iterable[str] = (),
        unused: Iterable[str] = (),
        definition: tuple[str, Mapping[str, str]] = ("", MappingProxyType({})),
        **values: Any,
    ) -> None:
        known = self.table()
        unknown = values.keys() - known.keys()
        if unknown:
            raise TypeError(f"a study has no {', '.join(sorted(unknown))}")
        tables = {
            name: MappingProxyType(dict(v)) for name, v in values.items() if isinstance(known[name].kind, kinds.Table)
        }
        self.values: Mapping[str, Any] = MappingProxyType({**values, **tables})
        self.command, self.options = command, options
        self.file, self.from_file, self.unused = file, frozenset(from_file), tuple(unused)
        self.definition = definition

    @classmethod
    def table(cls) -> dict[str, Option[Any]]:
        """Every option by its name, in the order of their definition."""
        return {n: o for base in reversed(cls.__mro__) for n, o in vars(base).items() if isinstance(o, Option)}

    def but(self, **changes: Any) -> Self:
        """The same study with other values."""
        origin = {name: value for name, value in vars(self).items() if name != "values"}
        return type(self)(**{**origin, **self.values, **changes})

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Study) and all(
            getattr(self, name) == getattr(other, name) for name in (*self.table(), "file", "from_file", "unused")
        )

    def sets(self, option: Option[Any]) -> bool:
        """Whether an option asks for something."""
        return option.name in self.values and option.kind.is_set(self.values[option.name])

    def label(self, option: str | Option[Any]) -> str:
        """How a message names an option: as it is typed, or by its place in the study file it came from."""
        name = option if isinstance(option, str) else option.name
        worded = self.options.get(name) or self.table()[name]
        return f"{self.file}, {worded.label}" if self.file is not None and name in self.from_file else worded.flag

    def spell(self, option: Option[Any]) -> str:
        """`label` with the value: ``--skip 3``; of an argument the value."""
        label = self.label(option) if option.flags else ""
        return f"{label} {option.kind.spell(self.values[option.name])}".strip()

    def then(self, command: str, *arguments: object, holds: Collection[Option[Any]] = ()) -> NextCommand:
        """The command that follows: ``arguments``, and those of its options that this study sets and no argument ``holds``."""
        return NextCommand(self, command, arguments, holds)

    @property
    def uncounted(self) -> int:
        """Rows at the start of each validation record that the errors leave out."""
        return max(self.skip, self.beginning)

    @property
    def folder(self) -> Path | None:
        """The folder of the study file, None without a file."""
        return None if self.file is None else self.file.parent

    @property
    def seconds(self) -> float:
        """How long a search may take, infinite where nobody limits it."""
        return self.time_limit or float("inf")


# What options do to one another: values in the table of a command, each with one form of message.


@dataclass(frozen=True)
class Needs:
    """``option`` changes nothing unless one of ``others`` is given too; ``why`` not."""

    option: Option[Any]
    others: tuple[Option[Any], ...]
    why: str

    def idle(self, study: Study) -> tuple[Option[Any], ...]:
        """The options of a study that change nothing by this rule."""
        idle = study.sets(self.option) and not any(map(study.sets, self.others))
        return (self.option,) * idle

    def objection(self, study: Study) -> str:
        """What is wrong with a study by this rule; "" where nothing is."""
        if not self.idle(study):
            return ""
        others = " or ".join(study.options.get(o.name, o).usage for o in self.others)
        return f"{study.spell(self.option)} has no effect: {self.why}; give {others} too"

    def __str__(self) -> str:
        return f"{self.option.flag} needs {' or '.join(o.usage for o in self.others)}: else {self.why}."


@dataclass(frozen=True)
class Excludes:
    """Only one of the two can be given; ``why``."""

    one: Option[Any]
    other: Option[Any]
    why: str

    def idle(self, study: Study) -> tuple[Option[Any], ...]:
        """None: which of the two is meant, only the user knows."""
        return ()

    def objection(self, study: Study) -> str:
        """What is wrong with a study by this rule; "" where nothing is."""
        both = study.sets(self.one) and study.sets(self.other)
        return f"{study.label(self.one)} and {study.label(self.other)} exclude each other: {self.why}; keep one" * both

    def __str__(self) -> str:
        return f"{self.one.flag} and {self.other.flag} exclude each other: {self.why}."


@dataclass(frozen=True)
class Idle:
    """``options`` change nothing ``beside`` something, ``where`` that is so; ``remedy`` if it is more than to leave them out.

    ``{s.to}`` in ``beside`` stands for the value of an option.
    """

    options: tuple[Option[Any], ...]
    beside: str
    where: Callable[[Any], bool] = lambda _: True
    remedy: str = ""

    def idle(self, study: Study) -> tuple[Option[Any], ...]:
        """The options of a study that change nothing by this rule."""
        given = tuple(option for option in self.options if study.sets(option))
        return given if given and self.where(study) else ()

    def objection(self, study: Study) -> str:
        """What is wrong with a study by this rule; "" where nothing is."""
        idle = [study.label(o) if o.flags else study.spell(o) for o in self.idle(study)]
        it = "it" if len(idle) == 1 else "them"
        beside = self.beside.format(s=study)
        return f"{', '.join(idle)}: no effect {beside}; leave {it} out{self.remedy.format(it=it)}" if idle else ""

    def __str__(self) -> str:
        beside = re.sub(r"\{s\.\w+\}", "NAME", self.beside)
        return f"{', '.join(option.flag for option in self.options)}: no effect {beside}."


Relation = Needs | Excludes | Idle


@dataclass(frozen=True)
class NextCommand:
    """A ``command`` that follows a study: ``arguments``, and those of its options that the study sets and no argument ``holds``.

    What the command would refuse is left out; a record that it cannot do without has a placeholder.
    """

    study: Study
    command: str
    arguments: Sequence[object]
    holds: Collection[Option[Any]] = ()
    output: Path | None = None

    def keeping(self, files: Sequence[Path]) -> NextCommand:
        """The same with a folder of its own where it would replace results that are there; ``files``: what the study wrote."""
        if not files:
            return self
        results = Path("results")
        written = results / files[0].stem if files[0].parent in (results, Path()) else files[0].parent
        name = written.name.removesuffix(f"-{self.study.command}")
        if written.parent == results and name != written.name:
            usual = written.with_name(f"{name}-{self.command}")
            names = (f"{usual}-{k}" for k in count(2))
        else:
            # The results of a study in a folder that somebody named: those of its model may lie in any.
            usual = next(iter(results.glob(f"*-{self.command}")), results / self.command)
            names = (f"{written}-{self.command}{'' if k == 1 else f'-{k}'}" for k in count(1))
        if not usual.is_dir() or not any(usual.iterdir()):
            return self
        return replace(self, output=next(path for path in map(Path, names) if not path.exists()))

    def spell(self, commands: Mapping[str, Command], read: Study | None = None) -> str:
        """As it is typed; with ``read``, what the command reads from a study file, that file stands for all that it says."""
        words = ["greybox", self.command, *map(str, self.arguments if read is None else [read.file])]
        following, in_file = self._study(commands[self.command]), {} if read is None else read.values
        # A command that says an option in its own words has it twice: the last counts.
        for option in {option.name: option for option in commands[self.command].options}.values():
            is_in_file = option.name in in_file and in_file[option.name] == following.values.get(option.name)
            if option.flags and following.sets(option) and not is_in_file:
                values = option.kind.typed(following.values[option.name])
                if isinstance(option.kind, kinds.Switch):
                    words.append(option.flags[0])
                else:
                    words += [word for text in values for word in (option.flags[0], text)]
        if self.output is not None and any(o.usage == Study.output.usage for o in commands[self.command].options):
            words += [Study.output.flags[0], str(self.output)]
        return " ".join(map(to_word, words))

    def _study(self, command: Command) -> Study:
        """What the study says to ``command``, with the arguments."""
        held, known = {option.name for option in self.holds}, self.study.values
        carried = {n: o for n, o in command.in_study().items() if o.flags and n not in held and self.study.sets(o)}
        stated = {name: known[name] for name, option in carried.items() if option.takes(known[name])}
        # A result names its model: that is enough unless the model is a file.
        if kinds.is_name_of_model(stated.get("model", "")):
            del stated["model"]
        records = [o.name for o in command.table.values() if o.required and o.flags and isinstance(o.kind, kinds.Files)]
        stated = dict.fromkeys(records, (ANOTHER_RECORD,)) | stated
        words = [*takewhile(lambda word: not word.startswith("-"), map(str, self.arguments))]
        for argument in command.arguments:
            some = len(words) if argument.kind.repeated else 1
            stated[argument.name] = tuple(map(Path, words)) if argument.kind.repeated else "".join(words[:1])
            words = words[some:]
        study = command.study(**stated)
        return study.but(**{o.name: o.kind.empty for relation in command.relations for o in relation.idle(study)})


@dataclass(frozen=True)
class Answer:
    """What a command has found, and what is to be done with it: `greybox.shell.command_line` shows it.

    Attributes
    ----------
    text
        What ``print`` shows of it: the answer first.
    json
        The same for programs, given the report that was written, if any. None: the first of ``files`` holds it.
    next
        The command that a colleague would type now.
    files
        What was written.
    page, pictures
        Write the report and the figures, where they are wanted.
    kept
        What there is if that is interrupted.
    failure
        Why the command ends with ``code``.
    """

    text: object
    json: Callable[[Path | None], str] | None = None
    files: Sequence[Path] = ()
    page: Callable[[], Path] | None = None
    next: NextCommand | str = ""
    pictures: Callable[[], list[Path]] | None = None
    kept: str = ""
    failure: str = ""
    code: ExitCode = ExitCode.SUCCESS

    def as_json(self, report: Path | None) -> str:
        """The answer as JSON, with the ``report`` that was written, if any."""
        return self.json(report) if self.json else self.files[0].read_text(encoding="utf-8")


@dataclass(frozen=True)
class Command:
    """One command: a function from a study to what is shown, and the options that it uses.

    Attributes
    ----------
    run
        What it does; its docstring is the help. What it has shown itself needs no answer.
    short_help
        Its line in the list of commands.
    options
        What it uses, in its own words where they differ (`Option.but`); the help shows them in the order of the table.
    examples
        Lines to copy.
    relations
        What these options do to one another; checked before it runs.
    study
        `Study`, or a class that adds options to it.
    like
        Another command whose tables in a study file count for this one.
    lenient
        Whether it passes over what it does not use at the top of a study file, and says so, instead of refusing it.
    """

    run: Callable[[Any], Answer | None]
    short_help: str
    options: tuple[Option[Any], ...] = ()
    examples: tuple[str, ...] = ()
    relations: tuple[Relation, ...] = ()
    study: type[Study] = Study
    like: str = ""
    lenient: bool = False

    def __post_init__(self) -> None:
        # An option that the study does not have would be left out of the command without a word.
        for option in self.options:
            if not isinstance(option, Option) or option.name not in self.study.table():
                named = f"{option.usage or option.name!r}" if isinstance(option, Option) else repr(option)
                raise TypeError(
                    f"option {named} is not in the class {self.study.__name__}; give study=, the class that has it"
                )

    @cached_property
    def table(self) -> Mapping[str, Option[Any]]:
        """Its options by name, in the order of the table."""
        used = {option.name: option for option in self.options}
        return {name: used[name] for name in self.study.table() if name in used}

    @property
    def arguments(self) -> list[Option[Any]]:
        """What is typed without a flag."""
        return [option for option in self.table.values() if not option.flags]

    @property
    def reads_studies(self) -> bool:
        """Whether a study file may stand in the place of its first argument."""
        return any(o.required and bool(o.place) for o in self.arguments[:1])

    def in_study(self) -> dict[str, Option[Any]]:
        """The options that are part of a study, by name."""
        return {name: option for name, option in self.table.items() if option.place}

    def check(self, study: Study) -> None:
        """Refuse what contradicts itself or would change nothing. Raises GreyboxError."""
        for relation in self.relations:
            if objection := relation.objection(study):
                raise GreyboxError(objection)
