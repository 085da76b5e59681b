"""Every number with a unit or per cent that a command prints, or puts on its page, stands in its JSON under a name, to the digits shown."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import greybox as gb
from greybox.shell.commands import app
from greybox.simulation.simulate import write_csv
from models.micro_actuator import micro_actuator
from models.silverbox import silverbox
from tests.support.command import CliRunner
from tests.support.hidden_rigs import simulate_records

# Unit as it is shown -> what a number in the unit of the model is multiplied by.
PREFIXES = {"m": 1e3, "\u00b5": 1e6, "n": 1e9, "k": 1e-3}
BASES = ("m/s", "m", "A", "V", "kg", "N*s/m", "N/m", "N/A", "N", "V*s/m", "ohm", "H", "rad/s", "Hz", "1/s", "s")
UNITS = dict.fromkeys(BASES, (1.0,))
UNITS |= {prefix + base: (factor,) for prefix, factor in PREFIXES.items() for base in BASES if base != "kg"}
UNITS |= {"%": (100.0, 1.0), "times": (1.0,), "x": (1.0,), "std": (1.0,)}  # a share, or per cent already (best fit)
UNIT = "|".join(re.escape(unit) for unit in sorted(UNITS, key=len, reverse=True))
NUMBER = re.compile(rf"(?<![\w.\-])([+\-\u2212]?\d+(?:\.\d+)?(?:e[+\-]?\d+)?)(?:\s?({UNIT})(?![\w/*]))?")
# Between two numbers these say that the first has the unit of the second.
JOINED = re.compile(r"\s*(to|->|instead of|\+-|\u00b1|,|\[)\s*")
RAISED = str.maketrans("\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079\u207b", "0123456789-")

# Words whose numbers stand in no JSON, and why.
EXEMPT = {
    r"\w+ measured -?[\d.]+ to -?[\d.]+ \w+ -?[\d.]+": "the range of a column is in the record, which the JSON names by its fingerprint",
    r"(fitted|validation) \d+ [\d.]+ s( [\d.]+ s)?": "rows, duration and sampling time of a record: likewise",
    r"^([\w, ]+ [\d.]+ %; )+[\w, ]+ [\d.]+ %\.?$": "half of each interval over its value, both of which stand under parameters",
    r"[\d.]+ % of it within two standard deviations of the noise, [\d.]+ \w+": "twice the noise, and a count of drawn points",
    r"strongest at [\d.]+ k?Hz": "the highest point of a drawn spectrum",
    r"false-alarm rate of 1 %|p below 0\.01": "the level of the tests",
    r"(casadi|numpy|python|greybox) [\d.]+": "versions stand there as texts",
    r"95 % (interval|band|by profile|confidence|\[)|interval over 50 %": "the level of the intervals",
    r"No correlation exceeds 0\.95": "from when on two constants are told as correlated",
    r"60 % of it in 25 % of the time": "from when on a misfit counts as concentrated",
}
NOT_TOLD = re.compile("|".join(EXEMPT))


class PageText(HTMLParser):
    """What a page says: its text without scripts and drawings, a line for each paragraph and row."""

    SILENT = ("script", "style", "svg", "template")
    LINES = ("p", "tr", "li", "div", "h1", "h2", "h3", "section", "dt", "dd", "figcaption")

    def __init__(self, html: str) -> None:
        super().__init__()
        self.silent, self.parts = 0, [""]
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self.silent += tag in self.SILENT
        self.parts.append("\n" if tag in self.LINES else " ")

    def handle_endtag(self, tag: str) -> None:
        self.silent -= tag in self.SILENT
        self.parts.append(" ")

    def handle_data(self, data: str) -> None:
        if not self.silent:
            self.parts.append(data)


def stored_numbers(data: Any) -> Iterator[float]:
    """Numbers of a JSON, those in texts left out: of a signal its ends and its extremes, or any number would be among them."""
    if isinstance(data, dict):
        for value in data.values():
            yield from stored_numbers(value)
    elif isinstance(data, list) and len(data) > 12 and all(isinstance(v, (int, float, type(None))) for v in data):
        values = [float(v) for v in data if v is not None]
        yield from (values[0], values[-1], min(values), max(values)) if values else ()
    elif isinstance(data, list):
        for value in data:
            yield from stored_numbers(value)
    elif isinstance(data, (int, float)) and not isinstance(data, bool):
        yield float(data)


def shown_numbers(text: str) -> Iterator[tuple[str, str, str]]:
    """Number, unit and line of each number with a unit, or with digits after its point, the last of a line first."""
    text = re.sub(
        r"\u00b710([\u2070\u00b9\u00b2\u00b3\u2074-\u2079\u207b]+)", lambda k: "e" + k[1].translate(RAISED), text
    )
    lines = [re.sub(r"\s+", " ", line).strip() for line in text.replace("\u2212", "-").splitlines()]
    for line, of_table in zip(lines, find_table_units(lines), strict=True):
        told = NOT_TOLD.sub("", line)
        unit, end = "", len(told)
        for here in reversed(list(NUMBER.finditer(told))):
            unit = here[2] or (unit if JOINED.fullmatch(told[here.end() : end]) else of_table)
            end = here.start()
            if unit or re.search(r"[.e]", here[1]):
                yield here[1], unit, told


# A table of errors says their unit once: at the head of its rows in a terminal, and below them on a page.
ABOVE, BELOW, FIRST = (
    re.compile(rf"\[({UNIT})\] box "),
    re.compile(rf"rms errors in ({UNIT})\.$"),
    re.compile(r"^model box "),
)


def find_table_units(lines: list[str]) -> list[str]:
    """The unit that its table gives to the bare numbers of each line; "" where it gives none."""
    units = [""] * len(lines)
    for k, line in enumerate(lines):
        if head := ABOVE.search(line):
            end = next((n for n in range(k, len(lines)) if not lines[n]), len(lines))
            units[k + 1 : end] = [head[1]] * (end - k - 1)
        if foot := BELOW.search(line):
            first = max(n for n in range(k) if FIRST.search(lines[n]))
            units[first + 1 : k] = [foot[1]] * (k - first - 1)
    return units


def is_stored(number: str, unit: str, stored: np.ndarray) -> bool:
    """Whether a stored number, in the shown unit, is the shown one to its digits."""
    mantissa, _, exponent = number.partition("e")
    half = 0.5 * 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2])) * (1 + 1e-6)
    return any(bool(np.any(np.abs(factor * stored - abs(float(number))) <= half)) for factor in UNITS.get(unit, (1.0,)))


@pytest.fixture(scope="module")
def records(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two records of a coil with dry friction that its model does not have, and two of an oscillator."""
    folder, rng = tmp_path_factory.mktemp("records"), np.random.default_rng(0)
    pair = simulate_records(micro_actuator, {"coulomb_friction": {"Fc": 0.05}}, (2e-7, 5e-3), rows=600)
    for name, record in zip(("train", "test"), pair, strict=True):
        write_csv(record, micro_actuator, folder / f"{name}.csv")
    for name in ("a", "b"):
        t, u = 0.00164 * np.arange(300), rng.normal(0, 0.05, 300)
        y = gb.simulate(silverbox, {"time": t, "u": u}).outputs["y"] + 1e-3 * rng.normal(size=300)
        write_csv(gb.Experiment(name, t, {"u": u}, {"y": y}), silverbox, folder / f"{name}.csv")
    return folder


COMMANDS = {
    "fit": ("micro_actuator train.csv --validate test.csv --fix M --fix Ra", "fit.json"),
    "discover": (
        "micro_actuator train.csv --validate test.csv --fix M --fix Ra --effects coulomb_friction,cubic_stiffness --workers 1",
        "discovery.json",
    ),
    "discover nothing that fits": (
        "micro_actuator train.csv --validate test.csv --fix M --fix Ra --effects cubic_stiffness --workers 1",
        "discovery.json",
    ),
    "fit with all that may be asked": (
        "micro_actuator train.csv test.csv --fix M --fix Ra --starts 4 --profile K --bootstrap 100 --workers 1",
        "fit.json",
    ),
    "compare": ("silverbox a.csv --validate b.csv --workers 1", "compare.json"),
}
LONG = ("discover", "compare")


@pytest.mark.rest
@pytest.mark.parametrize("command", [pytest.param(c, marks=[pytest.mark.slow] * (c in LONG)) for c in COMMANDS])
def test_every_number_that_is_told_stands_in_the_json(
    command: str, records: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(records)
    words, file = COMMANDS[command]
    # A number stands on one line with its unit.
    monkeypatch.setattr("greybox.shell.command_line.terminal_width", lambda stream: 2000)
    typed = [command.split()[0], *words.split(), "--details", "--output", str(tmp_path)]
    done = CliRunner().invoke(app, typed, prog_name="greybox")
    assert done.exit_code == 0, done.stderr
    stored = np.abs(np.unique(list(stored_numbers(json.loads((tmp_path / file).read_text(encoding="utf-8"))))))
    page = "".join(PageText((tmp_path / "report.html").read_text(encoding="utf-8")).parts)
    for where, text in (("text", done.stdout), ("page", page)):
        shown = list(shown_numbers(text))
        # An answer that names nothing has fewer.
        assert len(shown) > (10 if "nothing that fits" in command else 20), where
        missing = [
            f"{number} {unit} in: {line[:160]}" for number, unit, line in shown if not is_stored(number, unit, stored)
        ]
        assert not missing, "\n".join([f"numbers of the {where} that {file} does not have:", *missing])


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("falls from 18.5 to 0.187 \u00b5m (99 % less)", [("99", "%"), ("0.187", "\u00b5m"), ("18.5", "\u00b5m")]),
        ("3.2\u00b710\u207b\u2074 H", [("3.2e-4", "H")]),
        ("AR(6), 12 rows", []),
    ],
)
def test_numbers_are_read_with_their_units(text: str, told: list[tuple[str, str]]) -> None:
    assert [(number, unit) for number, unit, _ in shown_numbers(text)] == told


@pytest.mark.parametrize(
    ("number", "unit", "is_there"),
    [
        ("18.5", "\u00b5m", True),
        ("18.6", "\u00b5m", False),
        ("18.5", "mm", False),
        ("1.85e-05", "m", True),
        ("63", "%", True),
    ],
)
def test_a_number_is_found_in_its_unit_only(number: str, unit: str, is_there: bool) -> None:
    assert is_stored(number, unit, np.array([1.8546e-5, 0.634])) is is_there


@pytest.mark.parametrize(
    "table",
    [
        "validation: y [{}]  box    free run  best fit  one step\narx  black  982  98.90 %  1955\n\n7.5",
        "7.5\nmodel  box  free run  best fit  one step\n\narx  black  982  98.90 %  1955\n\nFree run ahead: rms errors in {}.",
    ],
)
@pytest.mark.parametrize(("unit", "is_there"), [("\u00b5V", True), ("mV", False), ("V", False)])
def test_a_bare_number_of_a_table_has_the_unit_of_the_table(table: str, unit: str, is_there: bool) -> None:
    shown = {number: of for number, of, _ in shown_numbers(table.format(unit))}
    assert shown == {"982": unit, "98.90": "%", "1955": unit, "7.5": ""}
    # A table whose head has another prefix than its numbers is found out.
    assert [is_stored(number, shown[number], np.array([9.82e-4, 1.955e-3])) for number in ("982", "1955")] == [
        is_there
    ] * 2
