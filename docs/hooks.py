"""What MkDocs does with a page before it is built.

Formulas between dollar signs become MathML, which browsers typeset offline. Lines such as ``<!-- public names -->`` become what the
program itself says: every public name with its docstring, the help of every command. Pages that
studies write into `studies/` join the navigation by themselves.

The studies of the gallery are run: a build fails where their code fails or prints something else than they show. The picture of each
is drawn from what its code has computed, by a line such as ``<!-- figure: fit -->`` with the name of a variable. A study is run once for
each state of its page and of the library: ``python docs/hooks.py docs/gallery/end_stop.md`` runs one before the pages are built.
"""

from __future__ import annotations

import ast
import hashlib
import importlib
import inspect
import io
import re
import sys
import tempfile
import tokenize
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert

FOLDER = Path(__file__).parent
DISPLAYED = re.compile(r"^\$\$(.+?)\$\$", re.DOTALL | re.MULTILINE)
INLINE = re.compile(r"(?<![\\$`\w])\$(?!\s)([^$\n`]+?)(?<!\s)\$(?![\w$])")
CODE = re.compile(r"(^```.*?^```|`[^`\n]+`)", re.DOTALL | re.MULTILINE)
STUDIES, DECISIONS, GALLERY = "Studies", "Decisions", "Gallery"
FIGURE = re.compile(r"<!-- figure: (\w+) -->")
# A mark, and what stands in its place where nobody has built the pages: up to the next `<!-- end -->`.
KEPT = r"(?:\n(?:(?!<!-- ).)*?<!-- end -->)?"
LISTED = re.compile(r"<!-- gallery: ([\w ]+) -->" + KEPT, re.DOTALL)
CACHE = FOLDER.parent / ".cache" / "gallery"
SIZE = (5.6, 3.6)  # inches of a study's picture


def on_config(config: Any) -> Any:
    """Every page of a folder that is not in the navigation yet joins it, under the heading of its folder."""
    known = set(_pages(config.nav))
    unlisted = sorted(path.relative_to(FOLDER).as_posix() for path in FOLDER.rglob("*.md"))
    for heading, folder in ((DECISIONS, "decisions/"), (GALLERY, "gallery/"), (STUDIES, "studies/")):
        pages = [page for page in unlisted if page not in known and page.startswith(folder)]
        for section in _sections(config.nav, heading):
            section.extend(pages)
            known.update(pages)
    return config


def _sections(nav: Any, heading: str) -> Iterator[list[Any]]:
    """The lists of pages under ``heading``, however deep."""
    for entry in nav if isinstance(nav, list) else ():
        for name, below in entry.items() if isinstance(entry, dict) else ():
            if name == heading:
                yield below
            yield from _sections(below, heading)


def _pages(nav: Any) -> Iterator[str]:
    if isinstance(nav, str):
        yield nav
    else:
        for entry in nav.values() if isinstance(nav, dict) else nav:
            yield from _pages(entry)


def on_files(files: Any, config: Any) -> Any:
    """Run the studies of the gallery; their pictures join the files of the site."""
    from mkdocs.structure.files import File

    for page in sorted((FOLDER / "gallery").glob("*.md")):
        files.append(File.generated(config, f"gallery/{page.stem}.png", content=run_study(page)))
    return files


def run_study(page: Path) -> bytes:
    """Run a study, compare what it prints with what it shows, and draw its picture (PNG).

    Raises
    ------
    ValueError
        When it prints something else than it shows.
    """
    text = page.read_text(encoding="utf-8")
    kept = CACHE / f"{page.stem}-{hashlib.sha256((text + _library()).encode()).hexdigest()[:16]}.png"
    if kept.exists():
        return kept.read_bytes()
    sys.path.insert(0, str(FOLDER.parent))
    try:
        from tests.support.documented import run_page
    finally:
        sys.path.pop(0)
    with tempfile.TemporaryDirectory() as folder:
        run = run_page(page, Path(folder))
    if run.missing:
        raise ValueError("\n".join(run.missing))
    (name,) = FIGURE.findall(text)
    picture = _draw(run.scope[name])
    CACHE.mkdir(parents=True, exist_ok=True)
    for old in CACHE.glob(f"{page.stem}-*.png"):
        old.unlink()
    kept.write_bytes(picture)
    return picture


@cache
def _library() -> str:
    """A digest of everything that a study's result depends on beside its own page."""
    sources = sorted((FOLDER.parent / "greybox").rglob("*.py"))
    return hashlib.sha256(b"".join(path.read_bytes() for path in sources)).hexdigest() + inspect.getsource(_draw)


def _draw(result: Any) -> bytes:
    """The one figure that shows a result best."""
    from greybox.extensions.changes.figures import plot_changes
    from greybox.show.figures.comparison import plot_model_errors
    from greybox.show.figures.discovery import plot_effect_signal, plot_surrogate
    from greybox.show.figures.figure import Cell, Sheet
    from greybox.show.figures.matplotlib_backend import draw_sheet
    from greybox.show.figures.records import liveliest_window, plot_residuals_before_after, plot_run

    window, panel = None, 0
    match type(result).__name__:
        case "Discovery" if result.effect_signals:
            signal = result.effect_signals[0]
            figure = plot_effect_signal(signal, "missing")
            panel = 0 if signal.dependence.share > 0.5 else 1  # over time, where it is a function of no variable
        case "Discovery" if result.surrogate is not None:
            figure = plot_surrogate(result.surrogate)
        case "Discovery":  # a law: no site of the catalogue, so the error that it takes away
            before, after = (fit.validation.traces[0] for fit in (result.base, result.best))
            units = {o.name: o.unit for o in result.best.model.outputs}
            figure = plot_residuals_before_after(before, after, units, result.best.noise.std, "left", "with the law")
        case "Fit":
            trace = (result.validation.traces or result.traces)[0]
            figure = plot_run(trace, {o.name: o.unit for o in result.model.outputs}, "run")
            window = liveliest_window(trace.time, next(iter(trace.measured.values())))
        case "Comparison":
            figure = plot_model_errors(result)
        case _:
            figure = plot_changes(result)
    sheet = Sheet("study", (Cell(figure.panels[panel], 0, window=window),), figure.caption, SIZE)
    picture, file = draw_sheet(sheet), io.BytesIO()
    picture.suptitle("")  # the page has a title
    picture.savefig(file, format="png")
    return file.getvalue()


def list_studies(names: str, *, pictures: bool = True) -> str:
    """Titles of the studies with these names, with their pictures and first sentences unless `pictures` is false."""
    rows = []
    for name in names.split():
        title, sentence = (FOLDER / "gallery" / f"{name}.md").read_text(encoding="utf-8").split("\n\n")[:2]
        link = f"gallery/{name}.md"
        picture = f"[![](gallery/{name}.png)]({link}) " if pictures else ""
        told = f" {sentence}" if pictures else ""
        rows.append(f"- {picture}**[{title.removeprefix('# ')}]({link})**{told}")
    if not pictures:
        return "\n".join(rows)
    return "\n".join(['<div class="gallery" markdown>', "", *rows, "", "</div>"])


def on_page_markdown(markdown: str, page: Any = None, **_: Any) -> str:
    """The page's text, with what the program says put in and its formulas typeset; code is left as it is."""
    markdown = LISTED.sub(lambda match: list_studies(match[1]), markdown)
    if page is not None and FIGURE.search(markdown):
        markdown = FIGURE.sub(f"![The result of this study]({Path(page.file.src_path).stem}.png)", markdown)
    for words, write in GENERATED.items():
        mark = re.compile(f"<!-- {words} -->{KEPT}", re.DOTALL)
        if mark.search(markdown):
            written = write()
            markdown = mark.sub(lambda _, text=written: text, markdown)
    pieces = CODE.split(markdown)
    return "".join(piece if k % 2 else _typeset(piece) for k, piece in enumerate(pieces))


def _typeset(text: str) -> str:
    text = DISPLAYED.sub(
        lambda match: f'<div class="math">{_line(convert(match[1].strip(), display="block"))}</div>', text
    )
    # In a span, because Markdown takes a line that begins with another tag for a block.
    return INLINE.sub(lambda match: f"<span>{_line(convert(match[1]))}</span>", text)


def _line(mathml: str) -> str:
    """In one line, so that Markdown takes it for one piece."""
    return " ".join(mathml.split())


def public_names() -> str:
    """Every public name for mkdocstrings: those at the top, then each namespace with what only it holds."""
    import greybox

    lines = ["## greybox", "", "The verbs and values of the first week.", ""]
    for module, names in greybox._NAMES.items():
        lines += [line for name in names for line in _entry(f"greybox.{module}", name)]
    listed = set(greybox.__all__)
    # `gb.design` is the verb, so that its package has its place's name alone.
    for namespace, place in (*greybox._NAMESPACES.items(), ("extensions.design", "extensions.design")):
        module = importlib.import_module(f"greybox.{place}")
        doc = inspect.getdoc(module) or ""
        names = list(getattr(module, "__all__", ())) or _defined_in(module)
        names = [n for n in names if n not in listed]
        listed.update(names)
        lines += [f"## greybox.{namespace}", "", doc.split("\n\n")[0], ""]
        lines += [line for name in names for line in _entry(module.__name__, name)]
    return "\n".join(lines)


def _entry(module: str, name: str) -> list[str]:
    value = getattr(importlib.import_module(module), name)
    return [f"::: {_where(value, f'{module}.{name}')}", ""]


def _defined_in(module: Any) -> list[str]:
    """Public classes and functions of a namespace that is a single file."""
    return [
        name
        for name, value in vars(module).items()
        if not name.startswith("_") and getattr(value, "__module__", "") == module.__name__
    ]


def _where(value: Any, otherwise: str) -> str:
    """The full name of a function or class; of anything else the one it is imported by."""
    named = inspect.isfunction(value) or inspect.isclass(value)
    return f"{value.__module__}.{value.__qualname__}" if named else otherwise


def commands() -> str:
    """What each command says when asked for help."""
    from click.testing import CliRunner

    from greybox.shell.commands import COMMANDS, app

    runner = CliRunner()

    def help_of(*words: str) -> str:
        return runner.invoke(app, [*words, "--help"], prog_name="greybox", color=False).output.strip()

    sections = [f"```text\n{help_of()}\n```"]
    for name, command in sorted(COMMANDS.items()):
        rules = "\n".join(f"- {relation}" for relation in command.relations)
        sections.append(f"## greybox {name}\n\n```text\n{help_of(name)}\n```\n\n{rules}".rstrip())
    return "\n\n".join(sections)


def study_fields() -> str:
    """By table of a study file: the name of each place, with its option where that is spelt otherwise."""
    from greybox.shell.commands import COMMANDS
    from greybox.shell.study_file import study_commands

    tables: dict[str, dict[str, str]] = {"At the top": {}}
    of_names: dict[str, str] = {}  # tables with a line for each name
    for command in study_commands(COMMANDS).values():
        for option in command.in_study().values():
            key, typed = option.key or option.table, option.flag if option.flags else option.usage
            spelt = f"--{key.replace('_', '-')}"
            place = f"`{key}`" if option.key else f"`[{key}]`"
            title = f"`[{option.table}]`" if option.table else "At the top"
            within = tables.setdefault(title, {}) if option.key else of_names
            within.setdefault(key, place if typed == spelt else f"{place} (`{typed}`)")
    of_tables = [f"- {title}: {', '.join(places.values())}" for title, places in tables.items()]
    return "\n".join([*of_tables, f"- A line for each name: {', '.join(of_names.values())}"])


def result_files() -> str:
    """Each kind of result file with its keys, from the schema that files are checked against."""
    from greybox.base.json_shape import definition_name, make_definitions
    from greybox.discovery.execution import RefitEntry
    from greybox.discovery.result import Discovery
    from greybox.estimation.check import ModelCheck
    from greybox.estimation.uncertainty import Bootstrap, Profile
    from greybox.extensions.changes.result import ChangeDetection
    from greybox.extensions.design.campaign import Campaign
    from greybox.extensions.design.problem import Design
    from greybox.extensions.export.linear_files import LinearFile
    from greybox.extensions.fleet.result import FleetResult
    from greybox.shell.answers import FitAnswer
    from greybox.shell.printed import ComparisonAnswer

    kinds: tuple[type, ...] = (
        FitAnswer,
        Discovery,
        ComparisonAnswer,
        Profile,
        Bootstrap,
        Design,
        Campaign,
        ChangeDetection,
    )
    kinds += (ModelCheck, LinearFile, FleetResult, RefitEntry)
    titles = {definition_name(kind): vars(kind)["FILE"].title.capitalize() for kind in kinds}
    definitions = make_definitions(*kinds)[1]
    sections = []
    for kind in map(definition_name, kinds):
        schema = definitions[kind]
        rows = ["| key | holds |", "|---|---|"]
        for key, value in schema["properties"].items():
            inner = definitions[value["$ref"].rpartition("/")[2]] if "$ref" in value else value
            needed = "" if key in schema.get("required", ()) else " (later files)" if kind == "fit_answer" else ""
            rows.append(f"| `{key}` | {value.get('description') or inner['description']}{needed} |")
        sections.append(
            "\n".join(
                [
                    f"## {titles[kind]}",
                    "",
                    schema["description"],
                    "",
                    *rows,
                ]
            )
        )
    return "\n\n".join(sections)


def modules() -> str:
    """A table a package: each module with the first sentence of its docstring, read without importing it."""
    folder = FOLDER.parent / "greybox"
    house = (FOLDER / "architecture.md").read_text(encoding="utf-8").split("```text\n")[1].partition("```")[0]
    # From the bottom of the drawing up, as imports go.
    names = [name for line in reversed(house.splitlines()) for name in re.findall(r"\b(\w+)/", line)]
    order = [name for name in dict.fromkeys(names) if (folder / name / "__init__.py").is_file()]
    return "\n".join(line for package in order for line in _module_table(folder / package))


def _module_table(folder: Path) -> Iterator[str]:
    yield from (f"## {folder.name}", "", _first_sentence(folder / "__init__.py"), "", "| module | holds |", "|---|---|")
    for path in sorted(folder.rglob("*.py")):
        if path.name not in ("__init__.py", "__main__.py"):
            yield f"| `{path.relative_to(folder).as_posix()}` | {_first_sentence(path)} |"
    yield ""


def _first_sentence(path: Path) -> str:
    # The docstring is the first token: the rest of the module need not be parsed.
    with path.open(encoding="utf-8") as file:
        tokens = tokenize.generate_tokens(file.readline)
        first = next(t for t in tokens if t.type not in (tokenize.COMMENT, tokenize.NL))
    text = inspect.cleandoc(ast.literal_eval(first.string)) if first.type == tokenize.STRING else ""
    return " ".join(text.split("\n\n")[0].split()).replace("|", "\\|")


GENERATED: dict[str, Callable[[], str]] = {
    "public names": public_names,
    "commands": commands,
    "study fields": study_fields,
    "result files": result_files,
    "modules": modules,
}


def keep(markdown: str) -> str:
    """A page as it stands in a clone: lists of studies and the fields of a study file below their marks, without pictures."""
    fields = re.compile(f"<!-- study fields -->{KEPT}", re.DOTALL)
    if fields.search(markdown):
        written = f"<!-- study fields -->\n\n{study_fields()}\n\n<!-- end -->"
        markdown = fields.sub(lambda _: written, markdown)
    return LISTED.sub(
        lambda match: f"<!-- gallery: {match[1]} -->\n\n{list_studies(match[1], pictures=False)}\n\n<!-- end -->",
        markdown,
    )


# The pages of effects and of roles: words around what the program says of each.

CATALOGUE_HEAD = """# Catalogue of effects

These effects are tried by `greybox discover` and added to a model by `--effect NAME` or `model + gb.effect("NAME")`. `greybox effects
MODEL` lists those that find a place in a model. Where there are several (bodies, inputs, outputs), the name alone means the
first, and `NAME_at_SITE` another one. If yours is missing, write [your own](own_effect.md).

In equations `x` and `v` are displacement and velocity of a body, `u` is the input and `y` the output at the site; `{force}` is the unit
of the model's balance. Behind each equation stand the [parts](#parts-of-a-rig-and-what-is-usual) that a rig must have and how usual the
effect is; below, the experiment that tells it from its rivals.
"""

PARTS_HEAD = """
## Parts of a rig, and what is usual

Say what the rig has: `Model(..., has=("gear", "fluid"), lacks=("spring",))`, or `--has gear --lacks spring`. Effects whose parts the rig
lacks are not tried; what nobody has said is possible. Some follows from the model: without an input there is no motor. Of the
`candidates` that a model lists only parts that it is told to lack leave one out.

The classes ({classes}), the share of the rigs with the part that lack the effect in their plain model, are a judgement on 109
published, shipped or fitted models, good to a factor of two. They [order](how_it_works.md#which-effect-is-missing) what does equally
well on the records. An effect of your own counts as common.

"""

ROLES_HEAD = """# Roles

A role says what a signal or a parameter is physically; names are yours. Effects of the catalogue ask for roles, so that one Coulomb
friction serves every body:

```text
State("w", "rad/s", role="velocity")
Input("Ta", "K", role="ambient_temperature")
Parameter("Ra", "ohm", 8.0, role="resistance")
```

Many follow from the units, as the table says. `greybox check MODEL` shows the role of each signal, the effects that find a place, and
what would open the others; `greybox effects MODEL` lists the same effect by effect. Several signals may have one role: each body has
its own velocity, each tank its own level. Where the site of an effect does not tell which is meant, it is the first.
"""

ROLES_TAIL = """The effects at `pressure_a` and `upper_level` look for balances of these names. What an effect needs stands with it in the
[catalogue](catalogue.md).

## Plants to start from

`greybox init DIR --plant NAME` writes a model with all roles: `rotary-drive` (velocity, current, resistance, inductance),
`two-mass` (two bodies on a shaft), `stage` (displacement and velocity), `cylinder` (pressure and valve), `thermal` (temperature
and ambient temperature), `tanks` and `tank-chain` (levels), `chamber` (pressure of a vessel), `circuit` (current, inductance).
"""


def write_catalogue_page(entries: Sequence[Any]) -> str:
    """The page of the documentation: all effects by where they act, then a section for each."""
    from greybox.model.parts import PARTS, Occurrence
    from greybox.model.sites import NEEDED
    from greybox.show.sentences.model import write_plain_unit

    at_site: dict[str, list[Any]] = {}
    for e in entries:
        at_site.setdefault(e.site, []).append(e)
    lines = [CATALOGUE_HEAD.rstrip()]
    classes = ", ".join(f"{kind} {kind.probability:g}" for kind in Occurrence)
    lines += [PARTS_HEAD.format(classes=classes) + "| part | what it is |", "|---|---|"]
    lines += [f"| `{p.name}` | {p.meaning} |" for p in PARTS]
    told: dict[str, str] = {}  # what tells effects apart, with the first that it is said of
    for site, at in at_site.items():
        lines += ["", f"## At {site}", "", f"Needs {NEEDED.get(site, f'the balance `{site}`')}."]
        for e in at:
            parts = f"{' or '.join(f'`{name}`' for name in e.needs)}; " if e.needs else ""
            usual = ", ".join([e.occurs, *(f"`{name}` {kind}" for name, kind in e.occurs_with.items())])
            lines += ["", f"### {e.name}", "", f"`{e.equation}` ({parts}{usual})", ""]
            lines += [f"- `{q.name}` [{write_plain_unit(q.unit)}]: {q.description}" for q in e.parameters]
            lines += [""] if e.parameters else []
            if e.parents:
                lines += [f"Contains {_names(e.parents)}.", ""]
            if e.approaches:
                lines += [f"Approaches {_names(e.approaches)} at the end of its range.", ""]
            if e.stands_for:
                lines += [
                    f"Says the same as {_names(e.stands_for, ' with ')}, and is no candidate where these are.",
                    "",
                ]
            first = told.setdefault(e.tells_apart, e.name)
            lines += [e.tells_apart if first == e.name else f"Told apart as [{first}](#{first}).", "", f"*{e.source}.*"]
    return "\n".join(lines) + "\n"


def write_roles_page(roles: Sequence[Any]) -> str:
    """The page of the documentation: every role with units, meaning and what it opens."""
    lines = [ROLES_HEAD, "| role | of | units | what it is | opens |", "|---|---|---|---|---|"]
    lines += [
        f"| `{r.name}` | {', '.join(r.owners)} | {', '.join(r.units)} | {r.meaning} | {r.needed_for} |" for r in roles
    ]
    return "\n".join([*lines, "", ROLES_TAIL])


def _names(names: Sequence[str], word: str = " and ") -> str:
    return word.join(f"[{name}](#{name})" for name in names)


def rewrite_kept_pages() -> None:
    """Write anew what the pages hold of the program's own words: ``python docs/hooks.py``."""
    from greybox.model.effects import CATALOGUE, ROLES

    (FOLDER / "roles.md").write_text(write_roles_page(ROLES), encoding="utf-8")
    (FOLDER / "catalogue.md").write_text(write_catalogue_page(CATALOGUE), encoding="utf-8")
    for page in (FOLDER / "gallery.md", FOLDER / "study_files.md"):
        page.write_text(keep(page.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    if sys.argv[1:]:
        for study in sys.argv[1:]:
            run_study(Path(study).resolve())
    else:
        rewrite_kept_pages()
