"""A project's own catalogue: effects that were written or kept in its folder ``effects/``."""

from __future__ import annotations

import keyword
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from greybox.base import GreyboxError, ModelError, nearest, parse_unit, read_json, shorten, write_file
from greybox.base.texts import escape_line, to_comment
from greybox.model import Effect, Parameter, literal
from greybox.model.effect import formula_effect
from greybox.model.effects.catalogue import AT, all_effects, effect
from greybox.shell.project import EFFECTS, display_path, import_standalone, project_root, template_root, values_in


def find_own_effects() -> tuple[Effect, ...]:
    """The effects in ``effects/`` of the project around the working folder. One with files of another user is none: nothing in it is run.

    Returns
    -------
    tuple of Effect
        In the order of files and of names in them; none where there is no such folder.

    Raises
    ------
    ModelError
        For a file that cannot be run, with the line, and for two effects of one name.
    """
    root = project_root()
    if root is None or root == template_root().resolve():
        return ()
    effects: dict[str, tuple[Effect, Path]] = {}
    for file in sorted((root / EFFECTS).glob("*.py")):
        if file.name == "__init__.py":
            continue
        for entry in values_in(import_standalone(file), Effect).values():
            if entry.name in effects:
                other = display_path(effects[entry.name][1])
                raise ModelError(
                    f"{display_path(file)}: effect {entry.name!r} is in {other} already; rename one of them"
                )
            effects[entry.name] = entry, file
    return tuple(entry for entry, _ in effects.values())


def find_effect(name: str) -> Effect:
    """An effect of the project, else of the catalogue, by its name; with ``_at_`` and the name of a site for that one.

    Raises ModelError for an unknown name; the message lists the nearest ones.
    """
    kept = {e.name: e for e in find_own_effects()}
    if name in kept:
        return kept[name]
    if kept and name.partition(AT)[0] not in {e.name for e in all_effects()}:
        raise ModelError(
            f"neither the project nor the catalogue has an effect {name!r}; {nearest(name, [*kept, *(e.name for e in all_effects())])}"
        )
    return effect(name)


def keep_effect(name: str, result: Path | None = None) -> Path:
    """Write the law of a discovery into ``effects/`` of the project, where every later discovery tries it.

    Parameters
    ----------
    name
        What the effect is called from now on.
    result
        The ``discovery.json`` with the law; None for the newest in ``results/``.

    Returns
    -------
    Path
        The file that was written.

    Raises
    ------
    ModelError
        Without a project, for a name that is taken or none, and for a result without a law that can be kept.
    """
    from greybox.discovery.result import Discovery

    root = project_root()
    if root is None:
        raise ModelError("no project here to keep an effect in: a project has a folder models/; see greybox init")
    if not name.isidentifier() or keyword.iskeyword(name):
        raise ModelError(f"effect {name!r}: give a name of letters, digits and underscores, such as soft_stop")
    if name in {e.name for e in (*all_effects(), *find_own_effects())}:
        raise ModelError(f"effect {name!r}: there is one of this name already; give another one")
    source = result or _newest_result(root)
    laws = [e for e in read_json(source, Discovery)["effects"] if "formula" in e]
    if not laws:
        raise ModelError(f"{display_path(source)} has no law to keep; greybox discover MODEL ... --laws looks for one")
    text = _write_module(name, laws, display_path(source))
    path = root / EFFECTS / f"{name}.py"
    path.parent.mkdir(exist_ok=True)
    return write_file(path, text)


def _newest_result(root: Path) -> Path:
    results = sorted(
        (f for base in {root, Path.cwd()} for f in (base / "results").glob("*/discovery.json")),
        key=lambda f: f.stat().st_mtime,
    )
    if not results:
        raise ModelError("no results/*/discovery.json here; give the file: greybox effects keep NAME --result FILE")
    return results[-1]


def _write_module(name: str, laws: list[Mapping[str, Any]], source: str) -> str:
    """The Python file of the effect; a law of several terms is several effects. Nothing that ``laws`` say becomes code.

    Raises ModelError where they lack something or state no formula.
    """
    lines = [
        '"""' + escape_line(f"{name}: a law kept from {source}.") + '"""',
        "",
        "from greybox import Parameter",
        "from greybox.model.effects import formula_effect",
    ]
    try:
        for k, law in enumerate(laws):
            lines += _write_law(name if k == 0 else f"{name}_{k + 1}", law, f"a law of the records, {source}")
    except (GreyboxError, KeyError, TypeError, ValueError, AttributeError, ArithmeticError) as error:
        what = f"it lacks {error}" if isinstance(error, KeyError) else shorten(str(error), 100)
        raise ModelError(
            f"{source}: its law cannot be kept: {what}; repeat greybox discover MODEL ... --laws, which writes it anew"
        ) from None
    return "\n".join(lines) + "\n"


def _write_law(variable: str, law: Mapping[str, Any], source: str) -> list[str]:
    """The lines of one effect, which is made here too: what states no effect is refused before it is written."""
    amplitude = law["formula"].partition("*")[0]
    seen = ", ".join(f"{v} from {low:.4g} to {high:.4g}" for v, (low, high) in law["range"].items())
    equation = f"{law['equation']}, seen with {seen}" if seen else str(law["equation"])
    lines = ["", f"# {to_comment(equation)}", f"{variable} = formula_effect("]
    lines += [f"    {literal(text)}," for text in (variable, law["site"], law["formula"])]
    lines.append("    [")
    parameters = []
    for q, values in law["parameters"].items():
        value = float(values["value"])
        parse_unit(values["unit"])
        has_bounds = q != amplitude and value > 0
        bounds = (abs(value) / 1e3, abs(value) * 1e3) if has_bounds else (-math.inf, math.inf)
        parameters.append(Parameter(q, values["unit"], value, bounds))
        ends = f", {literal(bounds)}" if has_bounds else ""
        lines.append(f"        Parameter({literal(q)}, {literal(values['unit'])}, {literal(value)}{ends}),")
    options = {"amplitude": amplitude}
    if law.get("memory"):
        options |= {"lag": list(law["parameters"])[-1], "lag_unit": law["memory"]}
    formula_effect(variable, law["site"], law["formula"], parameters, **options)
    return [
        *lines,
        "    ],",
        *(f"    {key}={literal(value)}," for key, value in options.items()),
        f"    source={literal(source)},",
        ")",
    ]
