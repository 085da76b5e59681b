"""`greybox init`."""

from __future__ import annotations

import json as json_format
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from greybox.base import ExitCode, Finding, GreyboxError
from greybox.base.texts import to_word
from greybox.shell import options
from greybox.shell.inputs import add_effects, check_writable
from greybox.shell.progress import show_search_progress
from greybox.shell.study import Answer, Command, Excludes, Idle, Needs, NextCommand, Study
from greybox.shell.terminal import CommandCode, exit_with_error, print_findings, print_note, write_report

if TYPE_CHECKING:
    from greybox.model import Effect, Model
    from greybox.model.effects.catalogue import EffectListing, Placement
    from greybox.shell.project import ModelListing


def _as_json(data: object) -> str:
    return json_format.dumps(data, indent=2)


def init(study: Study) -> Answer:
    """Create a project in DIR with example files: models/, fits/ and a notebook, or one plant to start from."""
    from greybox.base.document import Document
    from greybox.shell.template import write_project
    from greybox.show.sentences.wording import count_noun

    folder = check_writable(study.directory or Path(), "DIR")
    files = write_project(folder, plant=study.plant, force=study.force)
    command = "python twin.py && greybox fit study.toml" if study.plant else "greybox models"
    following = f"cd {to_word(str(folder))} && {command}"
    data = {"folder": str(folder), "files": list(map(str, files)), "next": following}
    what = f"the plant {study.plant} and its simulated rig" if study.plant else "models, studies and a notebook"
    text = f"A project was written to {folder}: {count_noun(len(files), 'file')} with {what}."
    return Answer(Document("init", text), lambda _: _as_json(data), next=following)


INIT = Command(
    init,
    "Create a project with example files.",
    (Study.directory, Study.plant, Study.force, Study.json),
    ("greybox init my_rig", "cd my_rig && greybox models"),
)

# `greybox demo`.


def demo(study: Study) -> Answer:
    """Run every step on a simulated actuator with an effect that its model lacks.

    Fits the model (its residual is about a hundred times the noise), identifies the missing effect, prints the error on a
    validation record before and after, compares the model with black-box models, and writes the state space for controller
    design. An integrator that the fits do not use simulates the actuator. Takes half a minute; see DIR/report.html.
    """
    from greybox.shell.demonstration import run_demo

    folder = check_writable(study.output or Path("results/demo"))
    with show_search_progress() as (say, report):
        result = run_demo(folder, say=say, report=report, pictures=study.figures)
    if result.plain.status == "interrupted":
        exit_with_error(f"interrupted; the results so far are in {folder}", ExitCode.INTERRUPTED)

    def write_page() -> Path:
        page = write_report(result, folder / "report.html")
        if study.opened:
            click.launch(page.resolve().as_uri())
        return page

    return Answer(
        result,
        lambda _: (folder / "discovery.json").read_text(encoding="utf-8"),
        [*result.records, *result.files],
        page=write_page,
        next=f"greybox export {to_word(str(folder / 'fit.json'))} --to control",
        kept=f"the results are in {folder}",
        code=ExitCode.SUCCESS if result.fit.success else ExitCode.UNSUCCESSFUL,
    )


DEMO = Command(
    demo,
    "Run every step on a simulated actuator.",
    (
        Study.output.but(help="Folder for records and results. [default: results/demo]"),
        *(Study.opened, *options.SHOWING, Study.figures),
    ),
    ("greybox demo", "greybox demo --output somewhere"),
    (Excludes(Study.opened, Study.no_report, "there is a report to open, or none"),),
)

# `greybox models`.


def models(study: Study) -> Answer:
    """List the models, or print the equations and parameters of one."""
    from greybox.model.system import unused_parameters
    from greybox.shell.project import find_model, list_models
    from greybox.show.sentences.model import write_model

    if study.some_model:
        one = add_effects(find_model(study.some_model), study.added)
        print_findings(Finding(CommandCode.UNUSED_PARAMETER, subject=name) for name in unused_parameters(one.system))
        shown = write_model(one, in_full=True) if study.details else one
        return Answer(shown, lambda _: _as_json(_outline(one)), next=f"greybox check {to_word(study.some_model)}")
    listing = list_models()
    for problem in listing.problems:
        print_note(f"warning: {problem}")
    first = listing.models[0].name if listing.models else "MODEL"
    return Answer(listing, lambda _: _as_json(_list(listing)), next=f"greybox models {first}")


def _list(listing: ModelListing) -> dict[str, Any]:
    rows = [{"name": e.name, **_take(e.model, ("title", "description")), "where": e.where} for e in listing.models]
    return {"models": rows, "problems": list(listing.problems)}


def _take(value: object, names: Iterable[str]) -> dict[str, Any]:
    return {name: getattr(value, name) for name in names}


def _outline(model: Model) -> dict[str, Any]:
    from greybox.base import to_json_data
    from greybox.model import equations_text
    from greybox.shell.printed import OutlinedParameter

    groups: dict[str, Sequence[Any]] = {"states": model.all_states, "inputs": model.inputs, "outputs": model.outputs}
    data = {
        **_take(model, ("name", "title", "description")),
        "equations": equations_text(model),
        **{group: {s.name: s.unit for s in signals} for group, signals in groups.items()},
        "parameters": {q.name: _take(q, OutlinedParameter.__annotations__) for q in model.all_parameters},
    }
    return dict(to_json_data(data))


MODELS = Command(
    models,
    "List the models, or print one model.",
    (
        Study.some_model.but(help="The model to print: its name or its file. Without MODEL, all are listed."),
        *(Study.added, Study.json, Study.details.but(help="Write blocks of terms out in full.")),
    ),
    ("greybox models", "greybox models micro_actuator", "greybox models my/rig.py"),
)

# `greybox effects`.

KEEP = "keep"


def effects(study: Study) -> Answer:
    """List the effects of the catalogue, or where they find a place in a model; or show one of them.

    greybox effects keep NAME writes the law of a discovery to effects/NAME.py of the project: from then on it is a candidate
    beside those of the catalogue. Any effect of your own in effects/ is.

    Prints name, site, parameters with units, and equation of each, and why an effect has no place.
    """
    from greybox.base.document import Document
    from greybox.model.effects import EffectListing, all_effects, find_placements
    from greybox.shell.own_effects import find_own_effects, keep_effect
    from greybox.shell.project import find_model

    model = study.some_model
    if _keeps(study):
        if not study.own_name:
            raise GreyboxError(
                "effects keep: NAME is missing; write greybox effects keep NAME, as in greybox effects keep soft_stop"
            )
        kept = keep_effect(study.own_name, study.kept_result)
        answer = f"The law {study.own_name} is an effect of this project now: discover tries it."
        return Answer(Document("effects", answer), str, [kept])
    entries = (*all_effects(), *find_own_effects())
    alone = tuple(entry for entry in entries if entry.name == model)
    listing = EffectListing("", alone or entries)
    if model and not alone:
        plant = add_effects(find_model(model), study.added)
        listing = EffectListing(plant.title, entries, tuple(find_placements(plant, entries)), tuple(plant.candidates))
    following: NextCommand | str = "greybox effects MODEL" if not model else ""
    if model and not alone:
        following = study.but(effects=study.added).then("discover", model, "RECORD.csv")
    return Answer(listing, lambda _: _as_json(_to_data(listing)), next=following)


def _keeps(study: Study) -> bool:
    return study.some_model == KEEP


EFFECTS = Command(
    effects,
    "List the effects, or where they act in a model.",
    (
        Study.some_model.but(
            help="The model in which they look for a place: its name or its file; or the name of one effect. Without MODEL, the"
            " catalogue is listed. The word keep: the law of a discovery becomes an effect of the project."
        ),
        *(Study.own_name, Study.added, Study.kept_result, Study.json, Study.details),
    ),
    (
        "greybox effects",
        "greybox effects coulomb_friction",
        "greybox effects micro_actuator",
        "greybox effects my/rig.py --json",
    ),
    (
        Idle((Study.added, Study.json), "with keep, which writes one file", _keeps),
        Idle(
            (Study.kept_result, Study.own_name),
            "without keep",
            lambda study: not _keeps(study),
            ", or write greybox effects keep NAME",
        ),
        Needs(Study.added, (Study.some_model,), "there is no model to add it to"),
    ),
)


def _to_data(listing: EffectListing) -> list[dict[str, object]]:
    if not listing.model:
        return [{**_take(e, ("name", "site", "equation")), "parameters": _units(e)} for e in listing.entries]
    equations = (
        {"equation": p.effect.equation if p.effect else "", "parameters": _units(p)} for p in listing.placements
    )
    rows = zip(listing.placements, equations, strict=True)
    return [{**_take(p, ("name", "site")), **equation, "reason": p.reason} for p, equation in rows]


def _units(entry: Effect | Placement) -> dict[str, str]:
    return {q.name: q.unit for q in entry.parameters}


# `greybox schema`.


def schema(study: Study) -> Answer:
    """Print the JSON Schema of what COMMAND prints with --json.

    For scripts and agents: what a key means, its unit, and what may be null. What a command writes to its folder (fit.json, discovery.json,
    changed.json ...) has the same content. Draft 2020-12, whole in itself. With or without --json the output is the same.
    """
    from greybox.shell.printed import schema_of_command

    text = json_format.dumps(schema_of_command(study.json_command), indent=1, ensure_ascii=False)
    return Answer(text, lambda _: text)


SCHEMA = Command(
    schema,
    "Print the JSON Schema of what a command prints with --json.",
    (Study.json_command, Study.json),
    ("greybox schema fit", "greybox schema changed > changed.schema.json"),
)


# `greybox extensions`.


def extensions(study: Study) -> Answer:
    """List what this package and others add to the core, and from which distribution each comes.

    An extension that cannot be loaded is listed with its reason; everything else works without it.
    """
    from greybox.base.extensions import ExtensionKind, list_extensions
    from greybox.model.effects.catalogue import all_effects
    from greybox.shell.printed import ListedExtension
    from greybox.show.sentences.shell import extensions_text

    all_effects()  # an effect that has the name of a shipped one is known as such from here on
    entries = [entry for kind in ExtensionKind for entry in list_extensions(kind)]
    rows = [_take(entry, ListedExtension.__annotations__) for entry in entries]
    return Answer(extensions_text(entries), lambda _: _as_json({"extensions": rows}))


EXTENSIONS = Command(
    extensions,
    "List what extensions add to the program.",
    (Study.json,),
    ("greybox extensions", "greybox extensions --json"),
)
