"""Profiles and bootstraps as JSON files that are written and read without loss."""

from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from greybox.errors import DataError
from greybox.files import write_file
from greybox.result.json_data import format_json, to_json_data

if TYPE_CHECKING:
    from greybox.uncertainty.bootstrap import Bootstrap
    from greybox.uncertainty.profile import Profile

FORMAT = 1
"""Version of the files. Their keys are the names of the fields."""


def save_intervals(value: Profile | Bootstrap, path: str | Path) -> Path:
    """Write a profile or a bootstrap (folders are made); numbers that are not finite become null."""
    data = {"format": FORMAT, "kind": type(value).__name__.lower(), **to_json_data(value)}
    return write_file(path, format_json(data) + "\n")


def read_intervals(path: str | Path, kind: str) -> dict[str, Any]:
    """What `save_intervals` wrote of a ``kind``. Raises DataError for anything else."""
    source = Path(path)
    try:
        data = json.loads(source.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise DataError(
            f"{source}: not a readable {kind} ({error}); give the file that a {kind} was saved to"
        ) from error
    if not isinstance(data, dict) or (data.get("format"), data.get("kind")) != (FORMAT, kind):
        raise DataError(
            f"{source}: not a {kind} of this program (format {FORMAT}); give the file that a {kind} was saved to"
        )
    return {name: value for name, value in data.items() if name not in ("format", "kind")}


def restore_interval(ends: list[float | None]) -> tuple[float, float]:
    """An interval whose open ends are null in a file."""
    low, high = ends
    return -np.inf if low is None else low, np.inf if high is None else high


def restore_policy(policy: type, data: dict[str, Any]) -> Any:
    """A policy as it was stored; what an older file lacks is the default, what this version lacks is left out."""
    return policy(**{f.name: data[f.name] for f in fields(policy) if f.name in data})
