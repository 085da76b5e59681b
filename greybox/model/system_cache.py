"""The equations of models that were written out before: a search changes numbers a thousand times and equations rarely."""

from __future__ import annotations

from functools import lru_cache

from greybox.model.build_system import build_system
from greybox.model.system import Statement, System
from greybox.model.unit_check import check_units
from greybox.model.validation import check_expressions, check_names


def build_checked_system(statement: Statement) -> System:
    """Write out the equations of a model and check all of it that no value of a parameter can change.

    Raises ModelError for names that clash or are unknown and for balances or outputs that are no expressions, UnitError for a term whose
    unit is not its balance's.
    """
    check_names(statement)
    check_expressions(statement)
    system = build_system(statement)
    check_units(statement, system)
    return system


class SystemCache:
    """Systems by the `Statement` that determines them, the most recently used ones.

    Parameters
    ----------
    size
        How many are kept: more than a search over pairs of effects of the catalogue has in use at a time.
    """

    def __init__(self, size: int = 1024) -> None:
        self._build = lru_cache(maxsize=size)(build_checked_system)

    def system(self, statement: Statement) -> System:
        """The checked equations of a statement; one that cannot be hashed is written out every time.

        Raises ModelError and UnitError as `build_checked_system` does.
        """
        try:
            hash(statement)
        except TypeError:
            return build_checked_system(statement)
        return self._build(statement)

    def clear(self) -> None:
        """Forget every system."""
        self._build.cache_clear()

    def __len__(self) -> int:
        return self._build.cache_info().currsize


SYSTEMS = SystemCache()
