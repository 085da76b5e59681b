"""The studies' verdicts hold. Those on measured data are skipped where the data are missing."""

import subprocess
import sys
from pathlib import Path

import pytest

from fits import cascaded_tanks_base, emps_dry_friction, silverbox_hardening
from greybox.shell.template import write_project

ROOT = Path(__file__).resolve().parents[2]
STUDIES = ("emps_dry_friction", "cascaded_tanks_base", "silverbox_hardening")


def run(folder: Path, *arguments: str) -> subprocess.CompletedProcess:
    """``python -m fits....`` in ``folder``, as a user types it."""
    return subprocess.run([sys.executable, "-m", *arguments], cwd=folder, capture_output=True, text=True, check=False)


@pytest.mark.rest
@pytest.mark.parametrize("study", STUDIES)
def test_a_study_without_its_data_says_what_it_needs(tmp_path, study):
    bare, empty = run(ROOT, f"fits.{study}"), run(ROOT, f"fits.{study}", str(tmp_path))
    assert (bare.returncode, empty.returncode) == (2, 2)
    assert bare.stderr.startswith(f"usage: python -m fits.{study} [-h] FOLDER\n")
    assert "give the folder of these records" in empty.stderr
    assert "Traceback" not in bare.stderr + empty.stderr


@pytest.mark.rest
def test_a_study_runs_inside_a_new_project(tmp_path, shared_data):
    write_project(tmp_path / "mine")
    done = run(tmp_path / "mine", "fits.cascaded_tanks_base", str(shared_data / "cascaded_tanks"))
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("cascaded_tanks does not explain its records")


@pytest.mark.rest
def test_dry_friction_explains_the_drive(shared_data):
    emps_dry_friction.verdict(*emps_dry_friction.study(shared_data / "emps"))


@pytest.mark.slow
def test_the_silverbox_hardens(shared_data):
    silverbox_hardening.verdict(*silverbox_hardening.study(shared_data / "silverbox"))


def test_torricelli_alone_does_not_carry_the_tanks(shared_data):
    cascaded_tanks_base.verdict(cascaded_tanks_base.study(shared_data / "cascaded_tanks"))
