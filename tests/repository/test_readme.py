"""What the README shows works as it stands."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import pytest

from tests.support.documented import ROOT, Run, blocks, run_page

pytestmark = pytest.mark.rest

README = ROOT / "README.md"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("readme")


@pytest.fixture(scope="module")
def run(folder: Path) -> Run:
    return run_page(README, folder)


def test_every_command_and_line_of_code_runs_and_prints_what_is_shown(run: Run) -> None:
    assert not run.missing, "\n".join(run.missing)
    said = {command.split()[1] for command in run.commands}
    assert said == {"simulate", "models", "check", "fit", "discover", "export", "init"}


@pytest.mark.rest
def test_the_friction_that_the_model_was_not_told_about_is_named(run: Run, folder: Path) -> None:
    found = json.loads((folder / "results" / "micro_actuator-discover" / "discovery.json").read_text())
    assert found["verdict"] == "named"
    assert [e["name"] for e in found["effects"]] == ["coulomb_friction"]
    assert (folder / "results" / "fit.json").exists()
    assert (folder / "my_rig" / "models" / "micro_actuator.py").exists()


def test_the_eight_lines_give_constants_a_verdict_and_a_black_box(run: Run) -> None:
    fit = run.scope["fit"]
    for name, truth in {"K": 5895.5, "Fc": 0.05}.items():
        e = fit.parameters[name]
        assert e.value == pytest.approx(truth, abs=4 * e.std) and math.isfinite(e.std)
    for words in ("95 % interval", "whiteness", "output_error", "is best"):
        assert words in run.printed
    (code,) = (b.text for b in blocks(README) if b.language == "python")
    assert len([line for line in code.splitlines() if not re.match(r"from|import|\s*$", line)]) <= 8


@pytest.mark.slow
def test_what_takes_longer_runs_too(tmp_path: Path) -> None:
    run = run_page(README, tmp_path, slow=True)
    assert not run.missing, "\n".join(run.missing)
    assert any(command.startswith("greybox compare") for command in run.commands)


@pytest.mark.parametrize("command", ["make demo", "make test", "make docs"])
def test_the_readmes_commands_are_those_of_the_makefile(command: str) -> None:
    assert command in README.read_text(encoding="utf-8")
    assert f"\n{command.split()[1]}:" in (ROOT / "Makefile").read_text(encoding="utf-8")


def test_what_the_readme_links_to_is_there() -> None:
    targets = re.findall(r"\]\(([^)#]+)\)", README.read_text(encoding="utf-8"))
    assert targets
    assert not [t for t in targets if not (ROOT / t).exists()]
    assert (ROOT / "docs" / "figures" / "gap.png").stat().st_size < 200_000
