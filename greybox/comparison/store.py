"""A comparison as JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from greybox.comparison.result import Comparison, ComparisonEntry, ComparisonScore
from greybox.result import to_json_data


def save(comparison: Comparison, path: str | Path, further: Mapping[str, Any]) -> Path:
    """Write ``comparison`` to ``path`` (folders are made)."""
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(
        json.dumps(to_json_data({**to_data(comparison), **further}), indent=1, allow_nan=False) + "\n", encoding="utf-8"
    )
    return target


def to_data(comparison: Comparison) -> dict[str, Any]:
    """The comparison as nested dictionaries: ``models`` -> name -> kind, parameters, validation ..., and the verdict."""
    return {
        "models": {entry.name: _entry(entry) for entry in comparison.entries},
        "outputs": dict(comparison.outputs),
        "training": list(comparison.training),
        "validation": list(comparison.validation),
        "skip": comparison.skip,
        "verdict": list(comparison.verdict),
        "notes": list(comparison.notes),
    }


def _entry(entry: ComparisonEntry) -> dict[str, Any]:
    return {
        "kind": entry.kind,
        "parameters": entry.parameters,
        "structure": dict(entry.structure),
        "validation": _scores(entry.validation),
        "training": _scores(entry.training),
        "records": {record: _scores(scores) for record, scores in entry.records.items()},
        "bic": entry.bic,
        "stable": entry.stable,
        "feedthrough": dict(entry.feedthrough),
        "seconds": entry.seconds,
        "notes": list(entry.notes),
    }


def _scores(scores: Mapping[str, ComparisonScore]) -> dict[str, Any]:
    return {
        output: {
            "rmse": s.rmse, "best_fit_percent": s.best_fit_percent, "one_step_rmse": s.one_step_rmse,
            "samples": s.samples, "unit": s.unit,
            **({"ahead_rmse": {str(k): v for k, v in s.ahead_rmse.items()}} if s.ahead_rmse else {}),
        }
        for output, s in scores.items()
    }  # fmt: skip
