"""Texts of strangers as terminals, shells, spreadsheets and other languages get them."""

from __future__ import annotations

import ast
import shlex
import tomllib

import pytest

from greybox.base.texts import escape_line, to_cell, to_line, to_lines, to_message, to_word

STEERING = [
    "\x1b[31mred",
    "\x9b2J",
    "a\u202eb",
    "zero\u200bwidth",
    "bell\x07",
    "\U000e0041tag",
    "\x7f",
    "\u2028",
    "a\rb",
]


@pytest.mark.parametrize("text", STEERING)
def test_nothing_steers_a_terminal(text: str) -> None:
    for write in (to_line, to_lines, to_message, to_word, to_cell):
        assert write(text).isprintable()


def test_a_line_of_a_file_is_no_message_of_its_own() -> None:
    assert to_message("x\nerror: all is lost") == "x\n  error: all is lost"
    assert to_message("x\n  not read: y") == "x\n  not read: y"
    assert to_lines("x\ny") == "x\ny"


@pytest.mark.parametrize(
    "text", ["a b", "$(touch ran)", "y'; touch ran; echo '", "`id`", "a\nb", "~", "*", "--option", "", "ä"]
)
def test_a_proposed_word_is_one_word_of_a_shell(text: str) -> None:
    assert shlex.split(to_word(text)) == [to_line(text)]


@pytest.mark.parametrize(
    "text", ["=A1", "+1", "-1+2", "@A1", " =A1", "\t=A1", "\n=A1", "\uff1dA1", "\u200b=A1", "\xa0@A1"]
)
def test_a_cell_is_no_formula(text: str) -> None:
    assert to_cell(text).startswith("'")
    assert to_cell("unit =1") == "unit =1"


@pytest.mark.parametrize("text", [*STEERING, 'a"b\\', "\n\t\x00", "\U0001f600", "\u0085"])
def test_python_and_toml_read_an_escaped_line_alike(text: str) -> None:
    quoted = f'"{escape_line(text)}"'
    assert quoted.isprintable()
    assert ast.literal_eval(quoted) == text
    assert tomllib.loads(f"key = {quoted}")["key"] == text
