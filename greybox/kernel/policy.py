"""Limits of the cache of compiled kernels."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class CachePolicy:
    """How large the cache of compiled kernels may become, and what is kept."""

    largest_bytes: int = 500_000_000
    """Size of all libraries together; the ones that were used longest ago go first. A library takes 20 to 200 kB, a search makes thirty."""
    longest_unused_days: float = 90.0
    """Days after which a library that nobody used goes: a project that rests for a quarter compiles anew in a minute."""
    leftover_days: float = 1.0
    """Days after which the folder of a compilation that was killed goes: no compiler works so long."""
    compile_seconds: float = 300.0
    """Seconds after which a compilation is given up. The largest models take one tenth of it on a slow machine."""


CACHE_POLICY = CachePolicy()


@dataclass(frozen=True)
class CodePolicy:
    """How the instructions of a step are laid out."""

    most_values_ahead: int = 1000
    """Values that may be computed before the first tangent, in a step that calls functions such as ``tanh``: they lie in memory until
    then. A step of 700 values gains 6 % by that, a filter of 3000 takes 40 % more time."""


CODE_POLICY = CodePolicy()
