"""What the commands print: one golden text for each code, and the answers in plain text."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from greybox.base.document import Document, Paragraphs
from greybox.base.findings import Finding
from greybox.estimation.result_parts import Misfit
from greybox.shell.answers import CodeAnswer, FitAnswer, LinearAnswer, RecordMisfit, SimulationAnswer
from greybox.shell.terminal import CommandCode as Code
from greybox.show.sentences.shell import report_line, study_line, written

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
    """A value that says its ``text``."""

    def __str__(self) -> str:
        return str(self.text)

    def describe(self) -> Document:
        return Document(self.text, [Paragraphs([self.text])])


def answer(**more: Any) -> FitAnswer:
    noise = SimpleNamespace(bound=lambda _: None)
    fit = Text(
        text="the fit",
        provenance=SimpleNamespace(equations="dx/dt = v"),
        model=SimpleNamespace(title="rig"),
        noise=noise,
    )
    return FitAnswer(fit, **more)  # type: ignore[arg-type]


def test_a_fit_prints_what_was_asked_for_in_order() -> None:
    bootstrap = SimpleNamespace(
        samples=[0] * 200, block=12, names=("K",), std={"K": 0.1234}, interval={"K": (4.75, 5.25)}
    )
    misfit = Misfit(rmse=2e-7, unit="m", best_fit_percent=98.5, noise_ratio=1.02, samples=100)
    text = str(
        answer(
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
    )
    lines = text.splitlines()
    assert lines[:5] == ["dx/dt = v", "", "the fit", "", "remedy: measure i"]
    order = [
        "or: fix M",
        "profile likelihood",
        "  K: 5 N/m",
        "  noise_v: zero; its limit is listed with the parameters",
        "block bootstrap, 200 replicates in blocks of 12 rows",
        "  K: standard deviation 0.123, 95 % [4.75, 5.25]",
        "no intervals",
        "free run and prediction",
        "  table",
        "free run and prediction, validation records",
        "residual tests (p below 0.01 is an alarm; each test has a false-alarm rate of 1 %)",
        "  white",
    ]
    places = [lines.index(line) for line in order]
    assert places == sorted(places)
    assert "estimation record" in text and "validation record " not in text


def test_a_plain_fit_prints_no_more() -> None:
    assert str(answer()) == "dx/dt = v\n\nthe fit"


def test_a_simulation_prints_file_rows_and_integration() -> None:
    run = SimpleNamespace(time=[0, 1, 2], inputs={"u": 0}, outputs={"x": 0, "i": 0}, discretisation="exact hold")
    assert str(SimulationAnswer(run, Path("a.csv"))) == "a.csv: 3 rows, u, x, i; integrated by exact hold"  # type: ignore[arg-type]


def test_an_export_prints_what_was_written() -> None:
    files = (Path("plant.h"), Path("plant.c"))
    assert str(CodeAnswer("rig", "C", 1e-3, "one step of", files)) == (
        "rig as C, one step of 0.001 s\nwritten: plant.h, plant.c"
    )
    assert str(CodeAnswer("rig", "Modelica", None, "", files[:1])) == "rig as Modelica\nwritten: plant.h"
    linear = LinearAnswer(Text(text="matrices", name="rig"), Text(text="family"), (Path("plant.mat"),))  # type: ignore[arg-type]
    assert str(linear) == "matrices\n\nfamily\n\nwritten: plant.mat"


def test_files_reports_and_studies_have_their_lines() -> None:
    assert written([Path("a"), Path("b")]) == "written: a, b"
    assert report_line(Path("r.html")) == "report: r.html (open it in a browser; it needs no network)"
    assert study_line(Path("s.toml"), "fit") == "written: s.toml; run it with: greybox fit s.toml"
