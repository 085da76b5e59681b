"""What the commands print: one golden text for each code, and the answers in plain text."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from greybox.base.document import REMARK, Document, Paragraphs, TableBlock
from greybox.base.values import Finding
from greybox.estimation.result_parts import Misfit
from greybox.model import Input, Output
from greybox.shell.answers import CodeAnswer, FitAnswer, LinearAnswer, RecordMisfit, SimulationAnswer
from greybox.shell.terminal import CommandCode as Code
from greybox.show import text
from greybox.show.printers.text import block_lines, print_text, wrap_command
from greybox.show.sentences.shell import study_line

SENTENCES = {
    Code.SPLIT_WITHOUT_EFFECT: (
        Finding(Code.SPLIT_WITHOUT_EFFECT),
        "--split-holes has no effect: time has no gap and does not restart in any record",
    ),
    Code.RECORD_SPLIT: (
        Finding(Code.RECORD_SPLIT, subject="a.csv", values={"pieces": 3}),
        "a.csv is split into 3 records at the gaps in time",
    ),
    Code.PIECES_AT_REST: (
        Finding(Code.PIECES_AT_REST),
        "with --at-rest each piece starts at rest; omit --at-rest if the plant still moves after a gap",
    ),
    Code.SUBSTEPS_WITHOUT_EFFECT: (
        Finding(Code.SUBSTEPS_WITHOUT_EFFECT, values={"substeps": 4}),
        "--substeps 4 has no effect on a linear model, which is integrated exactly; use --method rk4 for substeps",
    ),
    Code.FILES_REPLACED: (
        Finding(Code.FILES_REPLACED, values={"files": [Path("a/fit.json"), Path("a/report.html")]}),
        "a/fit.json, a/report.html held something else and were overwritten",
    ),
    Code.STUDY_FIELDS_UNUSED: (
        Finding(Code.STUDY_FIELDS_UNUSED, subject="study.toml", values={"places": ["[priors]", "[records] skip"]}),
        "study.toml: a check does not use [priors], [records] skip",
    ),
    Code.OTHER_MODEL_IN_STUDY: (
        Finding(Code.OTHER_MODEL_IN_STUDY, subject="study.toml", values={"lines": ["B was 1 and is 2"]}),
        "study.toml: written for another model: B was 1 and is 2",
    ),
    Code.STARTS_AS_DECLARED: (
        Finding(Code.STARTS_AS_DECLARED, subject="x", values={"states": "x = 0 m, v = 0 m/s"}),
        "the run begins at the initial state of the model, x = 0 m, v = 0 m/s, and not where a record may begin; begin it elsewhere with"
        " --initial x=VALUE, or at rest under its first inputs with --settled",
    ),
    Code.UNUSED_PARAMETER: (
        Finding(Code.UNUSED_PARAMETER, subject="q"),
        "parameter 'q' is in no equation: a term is missing, or the parameter is not needed",
    ),
}


@pytest.mark.parametrize("code", Code)
def test_each_code_has_its_sentence(code: Code) -> None:
    finding, sentence = SENTENCES[code]
    assert str(finding) == sentence


def test_one_record_is_written_in_the_singular() -> None:
    assert "into 1 record at" in str(Finding(Code.RECORD_SPLIT, subject="a.csv", values={"pieces": 1}))


class Text(SimpleNamespace):
    """A value that says its ``text``: with an answer the first line, else a detail."""

    def __str__(self) -> str:
        return str(self.text)

    def describe(self) -> Document:
        if hasattr(self, "answer"):
            return Document("rig", self.answer, notes=["a note"], details=[Paragraphs(["a detail"])])
        return Document(self.text, details=[Paragraphs([self.text])])


def answer(**more: Any) -> FitAnswer:
    return FitAnswer(Text(text="the fit", answer="rig explains its records."), **more)  # type: ignore[arg-type]


def test_a_fit_prints_its_answer_then_what_was_asked_for_then_notes_and_on_request_all_else() -> None:
    bootstrap = SimpleNamespace(
        samples=[0] * 200, block=12, names=("K",), std={"K": 0.1234}, interval={"K": (4.75, 5.25)}
    )
    misfit = Misfit(rmse=2e-7, unit="m", best_fit_percent=98.5, noise_ratio=1.02, samples=100)
    value = answer(
        remedies=("measure i", "fix M"),
        profiles=(Text(text="K: 5 N/m"),),
        zero_noise=("noise_v",),
        bootstrap=bootstrap,
        refusal="no intervals",
        scores=Text(text="table"),
        validation_scores=Text(text="other table"),
        tests=Text(text="white"),
        misfits=[RecordMisfit("a", "x", misfit), RecordMisfit("b", "x", misfit)],
    )
    asked = [
        "rig explains its records.",
        "profile likelihood",
        "  K: 5 N/m",
        "  noise_v: zero; its limit is listed with the parameters",
        "block bootstrap, 200 replicates in blocks of 12 rows",
        "  K: standard deviation 0.123, 95 % [4.75, 5.25]",
        "note: no intervals",
        "remedy: measure i",
        "note: a note",
        "remedy: fix M",
    ]
    more = [
        "a detail",
        "free run and prediction",
        "  table",
        "free run and prediction, validation records",
        "residual tests (an alarm: p below 0.01, as in 1 % of correct fits)",
        "  white",
    ]
    assert str(value).splitlines()[0] == asked[0]
    lines = text(value, details=True).splitlines()
    places = [lines.index(line) for line in (*asked, *more)]
    assert places == sorted(places)
    assert not {*more} & {*str(value).splitlines()} and "estimation record" in "\n".join(lines)


def test_lines_are_broken_between_words_and_notes_end_where_a_screen_does() -> None:
    notes = [f"{number}: " + "word " * 20 for number in range(9)]
    document = Document("rig", "One sentence. " * 9, notes=notes, details=[Paragraphs(["x" * 90])])
    lines = print_text(document, 60, details=False).splitlines()
    assert max(map(len, lines)) <= 60 and all(line.strip() in " ".join([document.answer, *notes]) for line in lines[:2])
    assert lines[-1] == "(4 more notes: --details, or the page)" and len(lines) < 25
    assert "x" * 90 in print_text(document, 60, details=True).splitlines()  # a word stays whole
    assert print_text(document, 60).splitlines()[-1] == "(4 more notes: gb.report(result, FOLDER))"  # in Python


def test_a_table_that_is_too_wide_wraps_its_words_and_then_its_columns() -> None:
    wide = TableBlock("t", ["name", "what it is", REMARK], [["a", "many words " * 12, "fixed"], ["b", "few", ""]])
    lines = block_lines(wide, 60)
    assert max(map(len, lines)) <= 60 and lines[1].split()[0] == "a" and lines[1].endswith("fixed")
    numbers = TableBlock("t", ["name", *(f"column{k}" for k in range(9))], [["row", *["1.234567e-08"] * 9]])
    lines = block_lines(numbers, 60)
    assert max(map(len, lines)) <= 60 and sum(line.split()[0] == "row" for line in lines) == 3


def test_a_command_to_copy_keeps_each_option_with_its_value() -> None:
    command = "next: greybox fit my/rig.py 'a record.csv' --fix M=0.01 --validate other.csv --at-rest"
    lines = wrap_command(command, 40)
    assert max(map(len, lines)) <= 40 and all(line.endswith(" \\") for line in lines[:-1])
    assert " ".join(line.removesuffix(" \\").strip() for line in lines) == command
    assert any("--fix M=0.01" in line for line in lines)


def test_a_simulation_says_its_rows_and_signals() -> None:
    model = SimpleNamespace(title="rig", all_states=(), inputs=(Input("u", "V"),), outputs=(Output("x", "m"),))
    time = np.array([0.0, 1.0, 2.0])
    run = SimpleNamespace(
        time=time, inputs={"u": time}, outputs={"x": 1e-3 * time}, states={}, discretisation="exact hold", overflow=None
    )
    lines = str(SimulationAnswer(run, model, "x 1 m")).splitlines()  # type: ignore[arg-type]
    assert lines[0] == "rig was simulated: 3 rows over 2 s, one every 1 s."
    assert "  x       output  0 to 2 mm" in lines and lines[-2:] == [
        "note: the written outputs contain added white noise: x 1 m",
        "note: integrated by exact hold",
    ]


def test_an_export_says_what_was_written() -> None:
    assert str(CodeAnswer("rig", "C", 1e-3, "one step of")) == "rig was written as C, one step of 0.001 s."
    assert str(CodeAnswer("rig", "Modelica", None, "")) == "rig was written as Modelica."
    linear = LinearAnswer(Text(text="", answer="stable"), Text(text="family"))  # type: ignore[arg-type]
    assert text(linear, details=True) == "stable\n\nnote: a note\n\na detail\n\nfamily"


def test_a_study_that_was_written_says_how_to_run_it() -> None:
    assert study_line(Path("s.toml"), "fit").splitlines()[-1] == "next: greybox fit s.toml"
