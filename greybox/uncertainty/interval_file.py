"""Profiles and bootstraps as JSON files that are written and read without loss."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from greybox.files import write_file
from greybox.result.json_data import iterate_json, to_json_data
from greybox.schemas import ResultKind, read_json

FORMAT = 1
"""Version of the files. Their keys are the names of the fields."""


class IntervalFile:
    """A value about intervals that can be saved: its fields are the keys of the file."""

    def to_data(self) -> dict[str, Any]:
        """The file as plain values; numbers that are not finite become None."""
        return {"format": FORMAT, "kind": type(self).__name__.lower(), **to_json_data(self)}

    def save(self, path: str | Path) -> Path:
        """Write it as JSON; `load_profile` or `load_bootstrap` reads it back without loss.

        Parameters
        ----------
        path
            Where to; folders are made. Numbers that are not finite become null.

        Returns
        -------
        Path
            The file that was written.
        """
        return write_file(path, iterate_json(self.to_data()))


def read_intervals(path: str | Path, kind: ResultKind) -> dict[str, Any]:
    """The fields of what was saved of a ``kind``. Raises DataError for anything else."""
    data = read_json(path, kind)
    return {name: value for name, value in data.items() if name not in ("format", "kind")}


def restore_interval(ends: list[float | None]) -> tuple[float, float]:
    """An interval whose open ends are null in a file."""
    low, high = ends
    return -np.inf if low is None else low, np.inf if high is None else high


def restore_policy(policy: type, data: dict[str, Any]) -> Any:
    """A policy as it was stored; what an older file lacks is the default, what this version lacks is left out."""
    return policy(**{f.name: data[f.name] for f in fields(policy) if f.name in data})
