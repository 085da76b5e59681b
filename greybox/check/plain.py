"""A check as plain values, for JSON."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

from greybox.check.check import ModelCheck


def to_plain_values(check: ModelCheck) -> dict[str, Any]:
    """Numbers, texts, lists and dictionaries; what is not finite is None."""
    structure, records = check.structure, check.practical
    found = {
        "model": check.model.title,
        "linear": check.linear,
        "discretisation": check.discretisation,
        "kernel": check.kernel,
        "records": [
            {
                "name": e.name,
                "rows": e.rows,
                "duration": e.duration,
                "sampling_time": e.sampling_time,
                "data": e.fingerprint,
                "notes": [str(finding) for finding in e.findings],
            }
            for e in check.experiments
        ],
        "assumed": check.assumed,
        "noise": {"std": dict(check.noise), "source": check.noise_source},
        "structure": {"doubt": check.doubt}
        if structure is None
        else asdict(structure) | {"verdict": structure.verdict},
        "data": asdict(records),
        "complete": check.complete,
    }
    return _finite(found)


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    return value
