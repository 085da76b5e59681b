"""Which programs computed a result."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version

import casadi as ca
import numpy as np


def read_versions() -> dict[str, str]:
    """Versions of what computed a result."""
    try:
        own = version("greybox-sysid")
    except PackageNotFoundError:
        own = "not installed"
    return {"greybox": own, "casadi": ca.__version__, "numpy": np.__version__, "python": platform.python_version()}
