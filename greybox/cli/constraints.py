"""Options about what is known of constants besides their values: priors, ties, own values, schedules, conditions; and the loss."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from greybox.cli import completion
from greybox.cli.options import Names, parse_number, parse_numbers, parse_pairs
from greybox.cli.records import split_records
from greybox.errors import GreyboxError, ModelError

if TYPE_CHECKING:
    from greybox.experiment import Experiment
    from greybox.model import Model

PLUS_MINUS = re.compile(r"\+/?-|±")

Prior = Annotated[
    Names,
    typer.Option(
        "--prior",
        metavar="NAME=MEAN+-STD",
        default_factory=list,
        autocompletion=completion.constants,
        help="What is known of a constant beforehand, as M=0.0100+-0.0001; weighed as a measurement.",
    ),
]
Tie = Annotated[
    Names,
    typer.Option(
        "--tie",
        metavar="NAME=FORMULA",
        default_factory=list,
        autocompletion=completion.constants,
        help="A constant that others give, as Kv=Kf or K2=3*K1; it holds exactly.",
    ),
]
Own = Annotated[
    Names,
    typer.Option(
        "--own",
        metavar="NAME",
        default_factory=list,
        autocompletion=completion.constant_names,
        help="A constant of which each record has a value of its own.",
    ),
]
Schedule = Annotated[
    Names,
    typer.Option(
        "--schedule",
        metavar="NAME=CONDITION[@VALUE]",
        default_factory=list,
        autocompletion=completion.constants,
        help="A constant that follows a condition or an input, as K2=P_S@8e5; it holds at that value.",
    ),
]
Condition = Annotated[
    Names,
    typer.Option(
        "--condition",
        metavar="NAME[=V1,V2,...]",
        default_factory=list,
        help="A constant that each record brings itself, one value for each in their order (--validate last); NAME alone"
        " takes it from each file: a column of that name, or a comment line such as '# P_S = 801 kPa'.",
    ),
]
Loss = Annotated[
    str,
    typer.Option(
        "--loss",
        metavar="NAME[:K]",
        help="squares, or a robust one that outliers cannot pull: huber, student. K: noise standard deviations from which it"
        " bends, or degrees of freedom.",
    ),
]


def apply_schedule(model: Model, schedule: Iterable[str]) -> Model:
    """``model`` with constants that follow a condition. Raises GreyboxError."""
    for name, text in parse_pairs("--schedule", schedule).items():
        by, at, value = (part.strip() for part in text.partition("@"))
        said, example = f"--schedule {name}={text}", f"--schedule {name}={by}@2"
        if not at and by in [i.name for i in model.inputs]:
            raise GreyboxError(f"{said}: {by} is an input; say at which value of it {name} holds, as in {example}")
        model = model.schedule(name, by=by, about=parse_number(said, value, example) if at else None)
    return model


def apply_priors_and_ties(model: Model, prior: Iterable[str], tie: Iterable[str]) -> Model:
    """``model`` with priors and ties. Raises GreyboxError."""
    priors = {name: _mean_and_std(name, text) for name, text in parse_pairs("--prior", prior).items()}
    both = sorted(q.name for q in model.all_parameters if q.fixed and q.name in priors)
    if both:
        raise ModelError(
            f"--prior {', '.join(both)}: fixed in the model or by --fix, so a prior has nothing to say;"
            " free it, or leave out one of the two"
        )
    return model.prior(**priors).with_ties(parse_pairs("--tie", tie))


def read_records(
    condition: Sequence[str], model: Model, data: Sequence[Path], validate: Sequence[Path] = (),
    *, split: bool = False, at_rest: bool = False, **how: Any,
) -> tuple[tuple[Experiment, ...], tuple[Experiment, ...]]:  # fmt: skip
    """The records in ``data`` and those in ``validate``, each with its conditions: from its file, or as the command line has them.

    ``split``: cut where their time starts anew and at its gaps; if not, a long gap is refused. ``at_rest``: whether each begins at
    rest. ``how``: further arguments of `greybox.experiment.read_experiments`. Raises GreyboxError.
    """
    from greybox.experiment import read_experiments
    from greybox.experiment.time_gaps import refuse_unknown_input

    stated = dict.fromkeys(text.strip() for text in condition if "=" not in text)
    given = parse_pairs("--condition", (text for text in condition if "=" in text))
    both = [name for name in stated if name in given]
    if both:
        raise GreyboxError(f"--condition {both[0]}: given with values and from the files; keep one")
    records, judges = (
        read_experiments(files, model, conditions=stated, split=split, **how) if files else ()
        for files in (data, validate)
    )
    under = _under(given, records, [_known_as(judge, records) for judge in judges])
    if not split:
        refuse_unknown_input([*under[0], *under[1]])
        return under
    records, judges = split_records(at_rest, *under, runs=len(records) + len(judges) - len(data) - len(validate))
    return records, judges


def _known_as(judge: Experiment, records: Sequence[Experiment]) -> Experiment:
    """A record for validation, with a finding where it is one of those that are fitted."""
    from greybox.experiment.findings import RecordCode
    from greybox.findings import Finding, Severity

    same = next((r for r in records if r.fingerprint == judge.fingerprint), None)
    if same is None:
        return judge
    name = same.source or same.name
    finding = Finding(RecordCode.ALSO_FITTED, Severity.WARNING, values={"record": name})
    return replace(judge, findings=(*judge.findings, finding))


def _under(
    given: Mapping[str, str], records: Sequence[Experiment], judges: Sequence[Experiment]
) -> tuple[tuple[Experiment, ...], tuple[Experiment, ...]]:
    """The records and those for validation, each with the values ``given`` for it, separated by commas."""
    everything = [*records, *judges]
    for name, text in given.items():
        values = [parse_numbers("--condition", [f"{name}={one.strip()}"])[name] for one in text.split(",")]
        if len(values) not in (len(records), len(everything)):
            raise GreyboxError(
                f"--condition {name}: {len(values)} values for {len(records)} record{'s' * (len(records) != 1)}"
                + (f" and {len(judges)} for validation" if judges else "")
                + "; give one for each, in their order, separated by commas"
            )
        for k, value in enumerate(values):
            everything[k] = replace(everything[k], conditions={**everything[k].conditions, name: value})
    return tuple(everything[: len(records)]), tuple(everything[len(records) :])


def parse_names(texts: Iterable[str]) -> tuple[str, ...]:
    """``["B,K", "M"]`` as names."""
    return tuple(name for text in texts for name in text.replace(",", " ").split())


def _mean_and_std(name: str, text: str) -> tuple[float, float]:
    parts = PLUS_MINUS.split(text)
    if len(parts) != 2:
        raise GreyboxError(
            f"--prior {name}={text}: write mean and standard deviation, as in --prior {name}=0.0100+-0.0001"
        )
    example = f"--prior {name}=0.0100+-0.0001"
    mean, std = (parse_number(f"--prior {name}={text}", part.strip(), example) for part in parts)
    return mean, std
