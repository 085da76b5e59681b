"""Pages whose commands and code are run: blocks of a Markdown page, what they print, and what the page says that they print.

A page is run from top to bottom in one folder. ``sh`` blocks hold commands, ``python`` blocks code (with a title the content of a
file), and a ``text`` block what the block before it prints: its lines, in their order, others may stand between them. What stands below a
line ``<!-- slow -->`` is left out of a quick run, up to the next block that is not an output.
"""

from __future__ import annotations

import contextlib
import io
import math
import os
import re
import shlex
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from unittest import mock

import matplotlib as mpl

from greybox.shell.commands import app
from tests.support.command import CliRunner

ROOT = Path(__file__).resolve().parents[2]
BLOCK = re.compile(r"^(<!-- slow -->\n)?```(\w*)[^\S\n]*([^\n]*)\n(.*?)^```", re.DOTALL | re.MULTILINE)
TITLE = re.compile(r'title="([^"]+)"')
NUMBER = re.compile(r"(?<![\w.])[-+]?\d[\d,]*\.?\d*(?:e[-+]?\d+)?")
# Numbers of a page are those of one machine: another may differ in the last digits of a search, and by more where they are small.
SAME = 0.03
# What a page may show without its being run here: it sets up, or is run by a test of its own.
ELSEWHERE = ("make ", "source ", "git clone", "python3 -m venv", "uv ", ".venv/")


@dataclass(frozen=True)
class Block:
    """A block of a page: its language, title and text, and the line of the page it begins in."""

    language: str
    title: str
    text: str
    line: int
    slow: bool = False


@dataclass
class Run:
    """A page that was run: ``printed`` by each block, ``scope`` its Python names, ``missing`` what was shown and not printed."""

    scope: dict = field(default_factory=lambda: {"__name__": "__page__"})
    printed: str = ""
    missing: list[str] = field(default_factory=list)
    commands: list[str] = field(default_factory=list)


def blocks(page: Path) -> list[Block]:
    """The fenced blocks of a page, in order."""
    text = page.read_text(encoding="utf-8")
    found = []
    for match in BLOCK.finditer(text):
        title, language = TITLE.search(match[3]), match[2]
        slow = bool(match[1]) or (language == "text" and bool(found) and found[-1].slow)
        found.append(Block(language, title[1] if title else "", match[4], text[: match.start()].count("\n") + 1, slow))
    return found


def run_page(page: Path, folder: Path, *, slow: bool = False) -> Run:
    """Run the page in ``folder``; a command or code that fails raises, what is not printed as shown is in ``missing``."""
    run, found = Run(), blocks(page)
    # What a figure shows is looked at elsewhere; drawing them would take half of the time.
    with _in(folder), mock.patch("matplotlib.figure.Figure.savefig", autospec=True):
        for block in (b for b in found if slow or not b.slow):
            where = f"{page.name}:{block.line}"
            if block.language == "text":
                shown = missing(block.text, run.printed)
                run.missing += [f"{where}: not printed: {line}" for line in shown]
            elif block.title:
                Path(block.title).parent.mkdir(parents=True, exist_ok=True)
                Path(block.title).write_text(block.text, encoding="utf-8")
            elif block.language == "python":
                run.printed = _python(block.text, where, run.scope)
            elif block.language == "sh":
                run.printed = "".join(_command(line, where, run) for line in commands(block.text))
    return run


def commands(text: str) -> list[str]:
    """The commands of a block: lines joined where they end in a backslash, without comments."""
    joined = text.replace("\\\n", " ").splitlines()
    return [line for raw in joined if (line := re.sub(r"\s+#\s.*$", "", raw).strip()) and not line.startswith("#")]


def missing(shown: str, printed: str) -> list[str]:
    """Lines of ``shown`` that ``printed`` lacks, in this order; numbers need only be nearly the same."""
    lines, lacking, at = printed.splitlines(), [], 0
    for wanted in (line for line in shown.splitlines() if line.strip() not in ("", "...")):
        hit = next((k for k in range(at, len(lines)) if same(wanted, lines[k])), None)
        if hit is None:
            lacking.append(wanted)
        else:
            at = hit + 1
    return lacking


def same(one: str, other: str) -> bool:
    """Whether two lines have the same words, and nearly the same numbers; ``one`` may leave the end out, as in ``a, b ...``."""
    if one.endswith(" ..."):
        one = one.removesuffix(" ...")
        other = " ".join(other.split()[: len(one.split())])
    if NUMBER.sub("#", one).split() != NUMBER.sub("#", other).split():
        return False
    pairs = zip(_numbers(one), _numbers(other), strict=True)
    return all(math.isclose(a, b, rel_tol=SAME) or abs(a - b) <= _rounding(a, b) for a, b in pairs)


def _numbers(line: str) -> list[float]:
    return [float(text.replace(",", "")) for text in NUMBER.findall(line)]


def _rounding(a: float, b: float) -> float:
    """Standard deviations and the like are shown in one or two digits."""
    return 0.15 * max(abs(a), abs(b))


def _python(code: str, where: str, scope: dict) -> str:
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        exec(compile(code, where, "exec"), scope)
    return said.getvalue()


def _command(line: str, where: str, run: Run) -> str:
    if line.startswith(ELSEWHERE):
        return ""
    run.commands.append(line)
    name, *arguments = shlex.split(line)
    if name == "cd":
        os.chdir(arguments[0])
        return ""
    if name != "greybox":
        raise AssertionError(f"{where}: {line!r}: a page's commands begin with greybox")
    done = CliRunner().invoke(app, arguments)
    if done.exit_code:
        raise AssertionError(f"{where}: {line}\nended with {done.exit_code}\n{done.output}\n{done.exception!r}")
    return done.output


@contextlib.contextmanager
def _in(folder: Path) -> Iterator[None]:
    """Inside ``folder``, with search path, modules of a project and styles as they were before."""
    here, path = Path.cwd(), list(sys.path)
    before = {name: module for name, module in sys.modules.items() if name.split(".")[0] == "models"}
    for name in before:  # a page begins as a new process does, whatever project the test before it had
        del sys.modules[name]
    os.chdir(folder)
    try:
        with mpl.rc_context():
            yield
    finally:
        os.chdir(here)
        sys.path[:] = path
        for name in [n for n in sys.modules if n.split(".")[0] == "models"]:
            del sys.modules[name]
        sys.modules.update(before)
