"""Which programs computed a result."""

from __future__ import annotations

import platform
from functools import cache
from importlib.metadata import PackageNotFoundError, version

import casadi as ca
import numpy as np


def read_versions() -> dict[str, str]:
    """Versions of what computed a result."""
    return {
        "greybox": _read_greybox_version(),
        "casadi": ca.__version__,
        "numpy": np.__version__,
        "python": platform.python_version(),
    }


@cache
def _read_greybox_version() -> str:
    """Of the installed package, from its files: read once."""
    try:
        return version("greybox-sysid")
    except PackageNotFoundError:
        return "not installed"
