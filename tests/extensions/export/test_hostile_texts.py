"""Texts of a stranger's fit in every language that is written: they stay comments and literals."""

from __future__ import annotations

import ast
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest

import greybox as gb
from greybox.base.extensions import ExtensionKind, load_extension
from greybox.base.texts import escape_line, to_comment, to_line
from greybox.estimation.linear.exported_model import to_plant
from greybox.estimation.result import Fit
from greybox.extensions.export.discrete_step import make_discrete_step
from greybox.extensions.export.fmu import write_description
from models.micro_actuator import micro_actuator
from tests.support.hostile import CODE, MARKUP

CC = shutil.which("cc")
TEXTS = (*CODE, MARKUP[0])


@pytest.fixture(scope="module")
def plain() -> Fit:
    t = 5e-4 * np.arange(300)
    run = gb.simulate(micro_actuator, gb.Experiment("bench", t, {"u": np.sin((40 + 600 * t) * t)}, {}))
    record = run.record({"x": 2e-7, "i": 5e-3}, np.random.default_rng(1))
    known = micro_actuator.fix("M", "Ra", "Kf", "Kv", "La")
    return gb.fit(known, record, noise={"x": 2e-7, "i": 5e-3}, options=gb.FitOptions(at_rest=True))


def carry(fit: Fit, text: str) -> Fit:
    """``fit`` with ``text`` wherever it holds a text that is no name."""
    model = fit.model
    groups = {
        name: tuple(replace(s, description=text) for s in getattr(model, name))
        for name in ("states", "inputs", "outputs")
    }
    groups["parameters"] = tuple(replace(q, description=text, source=text) for q in model.parameters)
    return replace(
        fit,
        model=replace(model, **groups, description=text, source=text),
        traces=tuple(replace(trace, name=text, fingerprint=text) for trace in fit.traces),
    )


def read_c(fit: Fit, folder: Path) -> str:
    """The C of a fit without its comments; it compiles by two standards."""
    source, _ = gb.export.to_c(fit, folder / "c" / "plant.c")
    for standard in ("-std=c99", "-std=gnu11"):
        library = folder / f"{standard}.so"
        subprocess.run([CC, standard, "-w", "-shared", "-fPIC", "-o", library, source], check=True, capture_output=True)
        assert b"hurt" not in library.read_bytes()
    return leave_comments_out(source)


def leave_comments_out(source: Path) -> str:
    """A C file and its header without their comments."""
    written = source.read_text(encoding="utf-8") + source.with_suffix(".h").read_text(encoding="utf-8")
    assert written.count("/*") == written.count("*/")
    return re.sub(r"/\*.*?\*/", "", written, flags=re.DOTALL)


def read_modelica(fit: Fit, folder: Path) -> list[str]:
    """The lines of a Modelica file to their first text."""
    lines = gb.export.to_modelica(fit, folder / "plant.mo").read_text(encoding="utf-8").splitlines()
    return [line.partition('"')[0] for line in lines if not line.startswith("//")]


def read_description(fit: Fit, _folder: Path) -> list[tuple[str, list[str]]]:
    """The elements of the description of an FMU."""
    plant = to_plant(fit)
    step = make_discrete_step(plant, None, method="rk4")
    root = ET.fromstring(write_description(plant, step, "plant", "{0}").encode())
    return [(element.tag, sorted(element.attrib)) for element in root.iter()]


def read_observer_c(fit: Fit, folder: Path) -> str:
    """The C of an observer without its comments; it compiles."""
    source, _ = gb.export.to_c(observe(fit), folder / "c" / "observer.c")
    subprocess.run([CC, "-std=c99", "-w", "-fsyntax-only", source], check=True, capture_output=True)
    symbols = leave_comments_out(source)
    assert "hurt" not in symbols
    return symbols


def read_observer_class(fit: Fit, folder: Path) -> str:
    """The tree of the file of an observer, but for its docstring, which holds the texts."""
    tree = ast.parse(gb.export.to_python(observe(fit), folder / "observer.py").read_bytes())
    del tree.body[0]
    return ast.dump(tree)


def read_observer_description(fit: Fit, _folder: Path) -> list[tuple[str, list[str]]]:
    """The elements of the description of an observer as an FMU."""
    observer = observe(fit)
    root = ET.fromstring(write_description(observer.plant, observer.predicted, "plant", "{0}").encode())
    return [(element.tag, sorted(element.attrib)) for element in root.iter()]


@pytest.fixture(scope="module")
def read_plain(plain, tmp_path_factory) -> Callable:
    """What is read of the fit that carries no text: once for each way to read it."""
    return cache(lambda read: read(plain, tmp_path_factory.mktemp("plain")))


@pytest.mark.crossed(3)
@pytest.mark.skipif(CC is None, reason="no C compiler to look with")
@pytest.mark.parametrize("text", TEXTS)
def test_c_defines_what_it_defines_without_the_text(plain, read_plain, tmp_path, text):
    assert read_c(carry(plain, text), tmp_path) == read_plain(read_c)


@pytest.mark.parametrize("text", TEXTS)
def test_modelica_has_the_same_lines(plain, read_plain, tmp_path, text):
    assert read_modelica(carry(plain, text), tmp_path) == read_plain(read_modelica)


@pytest.mark.parametrize("text", [*CODE[:2], *CODE[4:9], CODE[10]])
def test_modelica_is_read_by_another_program(plain, tmp_path, text):
    parser = pytest.importorskip("pymoca.parser", reason="pymoca is not installed")
    tree = parser.parse(gb.export.to_modelica(carry(plain, text), tmp_path / "plant.mo").read_text(encoding="utf-8"))
    assert "micro_actuator" in tree.classes and "hurt" not in tree.classes


@pytest.mark.crossed(3)
@pytest.mark.parametrize("text", TEXTS)
def test_python_files_import_and_run_nothing_of_the_text(plain, tmp_path, text):
    fit = carry(plain, text)
    gb.export.to_python(fit, tmp_path / "written.py")
    load_extension(ExtensionKind.EXPORTS, "control").write(
        gb.linearise(fit), tmp_path / "linear.py", plant=to_plant(fit)
    )
    for file in ("written.py", "linear.py"):
        code = compile((tmp_path / file).read_bytes(), file, "exec")
        assert "hurt" not in code.co_names and "os" not in code.co_names
    if text == CODE[6]:  # one that runs: the description comes back as it was
        look = "import os, written; assert written.micro_actuator.description == os.environ['TEXT'], 1; assert 'HURT' not in os.environ"
        environment = {
            **os.environ,
            "PYTHONPATH": f"{tmp_path}{os.pathsep}{Path.cwd()}",
            "TEXT": text.replace("\x00", ""),
        }
        again = carry(plain, text.replace("\x00", ""))
        gb.export.to_python(again, tmp_path / "written.py")
        subprocess.run([sys.executable, "-X", "utf8", "-c", look], env=environment, check=True)


@pytest.mark.crossed(3)
@pytest.mark.parametrize("text", TEXTS)
def test_the_description_of_an_fmu_is_xml_with_the_same_elements(plain, read_plain, tmp_path, text):
    assert read_description(carry(plain, text), tmp_path) == read_plain(read_description)


def observe(fit: Fit) -> gb.export.Observer:
    """An observer of a fit."""
    return gb.export.design_observer(fit, noise={"x": 2e-7, "i": 5e-3}, process_noise={"v": 1e-3})


@pytest.mark.crossed(3)
@pytest.mark.skipif(CC is None, reason="no C compiler to look with")
@pytest.mark.parametrize("text", TEXTS)
def test_the_c_of_an_observer_defines_what_it_defines_without_the_text(plain, read_plain, tmp_path, text):
    assert read_observer_c(carry(plain, text), tmp_path) == read_plain(read_observer_c)


@pytest.mark.crossed(3)
@pytest.mark.parametrize("text", TEXTS)
def test_the_class_of_an_observer_imports_and_runs_nothing_of_the_text(plain, read_plain, tmp_path, text):
    assert read_observer_class(carry(plain, text), tmp_path) == read_plain(read_observer_class)


@pytest.mark.parametrize("text", TEXTS)
def test_the_description_of_an_observer_is_xml_with_the_same_elements(plain, read_plain, tmp_path, text):
    assert read_observer_description(carry(plain, text), tmp_path) == read_plain(read_observer_description)


@pytest.mark.crossed(3)
@pytest.mark.parametrize("kind", ["mat", "json", "numpy"])
@pytest.mark.parametrize("text", TEXTS)
def test_matrices_are_written_with_any_text(plain, tmp_path, kind, text):
    fit = carry(plain, text)
    file = load_extension(ExtensionKind.EXPORTS, kind).write(
        gb.linearise(fit), tmp_path / "linear", plant=to_plant(fit)
    )
    assert file.stat().st_size > 500


@pytest.mark.parametrize("text", TEXTS)
def test_a_comment_is_one_line_without_its_marks(text):
    for line in (to_comment(text), to_comment(f"a{text}/"), to_comment(text * 3)):
        assert len(line.splitlines()) <= 1 and "\\" not in line and "??" not in line
        assert "*/" not in line and "/*" not in line
        line.encode("utf-8")
    assert len(to_line(text)) == len(text)
    assert eval(f'"{escape_line(text)}"') == text
