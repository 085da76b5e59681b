"""Which programs computed a result."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version

import casadi as ca
import numpy as np


def read_versions() -> dict[str, str]:
    """Versions of what computed a result."""
    try:
        greybox_version = version("greybox-sysid")
    except PackageNotFoundError:
        greybox_version = "not installed"
    return {
        "greybox": greybox_version,
        "casadi": ca.__version__,
        "numpy": np.__version__,
        "python": platform.python_version(),
    }
