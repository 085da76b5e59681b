"""Damaged files of measuring systems, and damaged FMUs: read, or refused in one sentence that names the file.

Slow; sizes and figures as of `tests.hardening.test_fuzz_records`.
"""

from __future__ import annotations

import shutil
import sys
import zipfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from greybox.base.errors import DataError, ModelError
from greybox.data.read import read_csv
from greybox.extensions.fmu.plant import read_fmu
from tests.data.test_measuring_files import LAG_MODEL, WRITERS
from tests.hardening.mutations import mutate_bytes, mutate_text
from tests.hardening.test_fuzz_records import LONGEST_MESSAGE, time_limit
from tests.support.child import run_in_child
from tests.support.reference_fmus import VAN_DER_POL, build_reference_fmu
from tests.support.reliability import note_row, size_of

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(7200),
    pytest.mark.skipif(sys.platform != "linux", reason="alarms of Linux"),
]
PACKAGES = {"mdf": "asammdf", "tdms": "nptdms", "hdf5": "h5py", "excel": "openpyxl", "mcap": "mcap"}


def judge(read: Callable[[], object], path: Path) -> str:
    """What one read comes to: "read", "refused", or what is wrong with it."""
    try:
        with time_limit(60):
            read()
    except (DataError, ModelError) as error:
        text = str(error)
        if path.name not in text:
            return f"the file is not named: {text[:100]}"
        return "refused" if len(text) < LONGEST_MESSAGE else f"a message of {len(text)} characters"
    except BaseException as error:
        return f"{type(error).__name__}: {str(error)[:100]}"
    return "read"


def try_all(kind: str, path: Path, contents: list[bytes], read: Callable[[], object]) -> Counter[str]:
    """The outcomes of reading each content, each group in a process that may crash."""

    def run() -> Counter[str]:
        outcomes = Counter[str]()
        for content in contents:
            path.write_bytes(content)
            outcomes[judge(read, path)] += 1
        return outcomes

    result = run_in_child(run)
    return Counter({f"the process ended by signal {result}": 1}) if isinstance(result, int) else result


def conclude(kind: str, outcomes: Counter[str]) -> None:
    tried = sum(outcomes.values())
    failed = tried - outcomes["read"] - outcomes["refused"]
    figures = f"{outcomes['read']} read, {outcomes['refused']} refused"
    note_row(f"damaged files: {kind}", tried, failed, figures)
    assert not failed, outcomes


@pytest.mark.parametrize("kind", WRITERS)
def test_damaged_files_of_measuring_systems(tmp_path, kind):
    name, write, columns = WRITERS[kind]
    pytest.importorskip(PACKAGES.get(kind, "rosbags"))
    path, rng = tmp_path / name, np.random.default_rng(len(kind))
    write(path)
    whole = path.read_bytes()
    contents = [mutate_bytes(whole, rng) for _ in range(size_of(60))]
    conclude(kind, try_all(kind, path, contents, lambda: read_csv(path, LAG_MODEL, columns=columns)))


def test_damaged_fmus(tmp_path):
    pytest.importorskip("fmpy")
    if not any(map(shutil.which, ("cc", "gcc", "clang"))):
        pytest.skip("there is no C compiler on the path")
    whole = build_reference_fmu(VAN_DER_POL, tmp_path, "2.0", "ModelExchange")
    path, rng = tmp_path / "damaged.fmu", np.random.default_rng(3)
    with zipfile.ZipFile(whole) as archive:
        description = archive.read("modelDescription.xml")
    contents = []
    for k in range(size_of(200)):
        if k % 2:
            contents.append(mutate_bytes(whole.read_bytes(), rng))
            continue
        with zipfile.ZipFile(path, "w") as archive:  # a sound archive with a damaged description
            archive.writestr("modelDescription.xml", mutate_text(description, rng))
        contents.append(path.read_bytes())
    conclude("FMU", try_all("FMU", path, contents, lambda: read_fmu(path)))
