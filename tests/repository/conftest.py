"""Every source is parsed once, before the first test that looks at one: no test is charged for all."""

from __future__ import annotations

import pytest

from tests.support.sources import ROOT, nodes


@pytest.fixture(scope="session", autouse=True)
def read_sources() -> None:
    for folder in ("greybox", "models", "fits", "plants", "tests"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            nodes(path)
