"""Names as other programs allow them: letters, digits and underscores, each once."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable


def to_identifier(name: str) -> str:
    """``micro_actuator + coulomb_friction`` as ``micro_actuator_coulomb_friction``."""
    text = re.sub(r"\W+", "_", name).strip("_")
    return text if text and not text[0].isdigit() else f"_{text}"


def to_identifiers(names: Iterable[str], taken: Collection[str] = ()) -> list[str]:
    """Each of ``names`` as an identifier that is none of the others and not ``taken``."""
    result: list[str] = []
    for name in names:
        plain = unique = to_identifier(name)
        number = 1
        while unique in result or unique in taken:
            number += 1
            unique = f"{plain}_{number}"
        result.append(unique)
    return result
