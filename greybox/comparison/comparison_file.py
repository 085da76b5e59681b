"""A comparison as JSON: ``compare.json``."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from greybox.comparison.result import Comparison, ComparisonEntry, ComparisonScore
from greybox.files import write_file
from greybox.result import to_json_data
from greybox.schemas import ResultKind, read_json

FORMAT = 1
"""Version of ``compare.json``."""


def save_comparison(comparison: Comparison, path: str | Path, extra: Mapping[str, Any] | None = None) -> Path:
    """Write a comparison as JSON.

    Parameters
    ----------
    comparison
        What `greybox.compare` gave.
    path
        The file; missing folders are made.
    extra
        Further entries beside those of the comparison.

    Returns
    -------
    Path
        The file. Numbers that are not finite become null.

    Examples
    --------
    >>> comparison = gb.compare([fit], record)  # doctest: +SKIP
    >>> gb.comparison.save_comparison(comparison, "results/compare.json")  # doctest: +SKIP
    """
    data = to_json_data({**comparison_data(comparison), **(extra or {})})
    return write_file(path, json.dumps(data, indent=1, allow_nan=False) + "\n")


def load_comparison(path: str | Path) -> dict[str, Any]:
    """What ``compare.json`` holds, checked.

    Parameters
    ----------
    path
        The file that `save_comparison` or ``greybox compare`` has written.

    Returns
    -------
    dict
        ``models`` -> name -> kind, parameters, validation ..., ``outputs``, ``verdict`` and more, as ``docs/result_files.md`` lists them.

    Raises
    ------
    DataError
        If it cannot be read, or is not a comparison as the schema says, with the first offence.

    Examples
    --------
    >>> gb.comparison.load_comparison("results/compare.json")["verdict"]  # doctest: +SKIP
    """
    return read_json(path, ResultKind.COMPARISON)


def comparison_data(comparison: Comparison) -> dict[str, Any]:
    """The comparison as nested dictionaries: ``models`` -> name -> kind, parameters, validation ..., and the verdict."""
    return {
        "format": FORMAT,
        "models": {entry.name: _entry_data(entry) for entry in comparison.entries},
        "outputs": dict(comparison.outputs),
        "training": list(comparison.training),
        "validation": list(comparison.validation),
        "skip": comparison.skip,
        "verdict": list(map(str, comparison.verdict)),
        "notes": list(map(str, comparison.findings)),
        "findings": [*comparison.verdict, *comparison.findings],
        "policy": comparison.policy,
        "options": None if comparison.options is None else comparison.options.to_data(),
    }


def _entry_data(entry: ComparisonEntry) -> dict[str, Any]:
    return {
        "kind": str(entry.kind),
        "parameters": entry.parameters,
        "structure": dict(entry.structure),
        "validation": _scores_data(entry.validation),
        "training": _scores_data(entry.training),
        "records": {record: _scores_data(scores) for record, scores in entry.records.items()},
        "bic": entry.bic,
        "stable": entry.stable,
        "feedthrough": dict(entry.feedthrough),
        "seconds": entry.seconds,
        "notes": list(map(str, entry.findings)),
        "findings": entry.findings,
    }


def _scores_data(scores: Mapping[str, ComparisonScore]) -> dict[str, Any]:
    return {
        output: {
            "rmse": score.rmse,
            "best_fit_percent": score.best_fit_percent,
            "one_step_rmse": score.one_step_rmse,
            "samples": score.samples,
            "unit": score.unit,
            **({"ahead_rmse": {str(k): v for k, v in score.ahead_rmse.items()}} if score.ahead_rmse else {}),
        }
        for output, score in scores.items()
    }
