"""Every source of the library is parsed once, before the first test that looks at one: no test is charged for all."""

from __future__ import annotations

import gc

import pytest

from tests.support.sources import ROOT, nodes


@pytest.fixture(scope="session")
def read_sources() -> None:
    for folder in ("greybox", "models", "fits"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            nodes(path)
    # The trees stay: the garbage collector looks at them no more.
    gc.freeze()
