"""What several commands share: how options are written, and what they do to a model."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterable, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from greybox.cli import completion
from greybox.cli.exits import print_note
from greybox.errors import GreyboxError, ModelError

if TYPE_CHECKING:
    from greybox.experiment import Experiment
    from greybox.model import Model

Names = list[str]
FEWEST_JUDGED = 10  # rows of a validation record that must be left


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


ModelName = Annotated[
    str,
    typer.Argument(
        metavar="MODEL",
        show_default=False,
        autocompletion=completion.models,
        help="Name of a model (see greybox models), or a model file: my/rig.py, my/rig.py:name.",
    ),
]
Fix = Annotated[
    Names,
    typer.Option(
        "--fix",
        metavar="NAME=VALUE",
        default_factory=list,
        autocompletion=completion.constants,
        help="A constant that is known, in its unit; NAME alone fixes it where it is.",
    ),
]
Start = Annotated[
    Names,
    typer.Option(
        "--start",
        metavar="NAME=VALUE",
        default_factory=list,
        autocompletion=completion.constants,
        help="A value to start from, in its unit.",
    ),
]
Free = Annotated[
    Names,
    typer.Option(
        "--free",
        metavar="NAME",
        default_factory=list,
        autocompletion=completion.constant_names,
        help="A constant to fit that the model holds fixed.",
    ),
]
Effects = Annotated[
    Names,
    typer.Option(
        "--effect",
        metavar="NAME",
        default_factory=list,
        autocompletion=completion.effects,
        help="Add an effect of the catalogue, such as coulomb_friction.",
    ),
]
Noise = Annotated[
    Names,
    typer.Option(
        "--noise",
        metavar="OUTPUT=STD",
        default_factory=list,
        autocompletion=completion.outputs,
        help="Standard deviation of an output's noise, in the model's unit; estimated if left out.",
    ),
]
Quiet = Annotated[
    list[Path],
    typer.Option(
        "--quiet",
        metavar="FILE",
        default_factory=list,
        show_default=False,
        help="A record with the input at rest, same columns: it tells the noise. May be repeated.",
    ),
]
Hold = Annotated[
    HoldName,
    typer.Option("--hold", help="The input between samples: zero (held), first (straight lines) or band-limited."),
]
Columns = Annotated[
    Names,
    typer.Option(
        "--column",
        metavar="NAME=HEADER",
        default_factory=list,
        autocompletion=completion.signals,
        help="The file's header for a signal, or for time, where it has another name.",
    ),
]
AtRest = Annotated[
    bool,
    typer.Option("--at-rest", help="Records begin at the states that the model declares, instead of estimated ones."),
]
FreeDecay = Annotated[
    bool,
    typer.Option(
        "--free-decay", help="Accept records whose input is zero throughout: the plant was let go and left alone."
    ),
]
Method = Annotated[
    MethodName,
    typer.Option(
        "--method",
        help="How to integrate: automatic, exact (linear models), rk4, mixed, or midpoint and radau (stiff models).",
    ),
]
Substeps = Annotated[
    int, typer.Option("--substeps", metavar="N", min=0, help="Steps in each sampling interval; 0 chooses.")
]


# What is written after an option that takes a name and something else, and an example.
SHAPES = {
    "--tie": ("NAME=FORMULA", "Kv=Kf"), "--schedule": ("NAME=CONDITION@VALUE", "K=u@2"), "--column": ("NAME=HEADER", "x=Laser"),
    "--prior": ("NAME=MEAN+-STD", "M=0.0100+-0.0001"), "--noise": ("OUTPUT=STD", "x=2e-7"), "--initial": ("STATE=VALUE", "x=0.001"),
}  # fmt: skip


def parse_pairs(option: str, texts: Iterable[str]) -> dict[str, str]:
    """``["M=1", "K=2"]`` as a dictionary; refuses text without ``=`` and names given twice."""
    shape, example = SHAPES.get(option, ("NAME=VALUE", "M=0.01"))
    found: dict[str, str] = {}
    for text in texts:
        name, equals, value = (part.strip() for part in text.partition("="))
        if not (name and equals and value):
            lacks = "it has no '='" if not equals else f"nothing stands {'after' if name else 'before'} the '='"
            raise GreyboxError(
                f"{option} {text}: {lacks}; write {option} {shape} without blanks, as in {option} {example}"
            )
        if name in found:
            raise GreyboxError(f"{option} {name}: given twice, as {found[name]} and {value}; keep one")
        found[name] = value
    return found


def parse_numbers(option: str, texts: Iterable[str]) -> dict[str, float]:
    """`parse_pairs` with finite numbers as values."""
    return {
        name: parse_number(f"{option} {name}={value}", value, f"{option} {name}=0.01")
        for name, value in parse_pairs(option, texts).items()
    }


def parse_number(said: str, value: str, example: str) -> float:
    """``value``, which is part of what was ``said``, as a finite number. Raises GreyboxError."""
    try:
        number = float(value)
    except ValueError:
        raise GreyboxError(f"{said}: {value!r} is not a number; write it without a unit, as in {example}") from None
    if not math.isfinite(number):
        raise GreyboxError(f"{said}: the value must be finite")
    return number


def change_model(
    model: Model,
    *,
    effects: Iterable[str] = (),
    fix: Iterable[str] = (),
    start: Iterable[str] = (),
    free: Iterable[str] = (),
) -> Model:
    """``model`` with effects of the catalogue added, then with constants freed, set and fixed. Raises GreyboxError."""
    fix, free = list(fix), list(free)
    known, bare = parse_numbers("--fix", (t for t in fix if "=" in t)), [t for t in fix if "=" not in t]
    values = parse_numbers("--start", start)
    for other, names in (("--start", known.keys() & values.keys()), ("--free", {*known, *bare} & set(free))):
        if names:
            raise ModelError(f"{', '.join(sorted(names))}: --fix and {other} contradict each other; keep one")
    if effects:
        from greybox.effects import effect

        for name in effects:
            model = model + effect(name)
    return model.free(*free).start(**values).fix(*bare, **known)


def check_writable(path: Path) -> Path:
    """``path``, if results can be written there; tried before the work is done and not after it, and left as it was."""
    if path.exists() and not path.is_dir():
        raise GreyboxError(f"--output {path}: it is a file; give a folder")
    missing = [folder for folder in (path, *path.parents) if not folder.exists()]
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            pass
    except OSError as error:
        raise GreyboxError(f"--output {path}: cannot be written to ({error.strerror}); give another folder") from error
    finally:
        for folder in missing:
            if folder.is_dir():
                folder.rmdir()
    return path


def check_skip(skip: int, records: Sequence[Experiment]) -> None:
    """Refuse, before the fit, to leave out rows of nothing, or so many that a validation record has nothing left to judge by."""
    if skip and not records:
        raise GreyboxError(
            f"--skip {skip} has no effect: it leaves out rows of validation records; give --validate FILE too"
        )
    shortest = min((r.rows for r in records), default=skip + FEWEST_JUDGED)
    if skip and shortest - skip < FEWEST_JUDGED:
        raise GreyboxError(
            f"--skip {skip}: the shortest validation record has {shortest} rows, and at least {FEWEST_JUDGED} must be left;"
            " leave out fewer"
        )


def check_substeps(model: Model, method: MethodName, substeps: int) -> None:
    """Refuse a number of substeps with a method that has none; say so where the automatic choice may be such a one."""
    if substeps and method is MethodName.exact:
        raise GreyboxError(
            f"--substeps {substeps} has no effect: --method exact has no substeps; leave out one of the two"
        )
    if substeps and method is MethodName.automatic and model.system.linear:
        print_note(
            f"note: --substeps {substeps} has no effect where a linear model is integrated exactly; --method rk4 has substeps"
        )
