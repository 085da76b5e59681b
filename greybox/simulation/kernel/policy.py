"""Limits of the cache of compiled kernels, how they are laid out, and when one is worth its compilation."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class CachePolicy:
    """How large the cache of compiled kernels may become, and what is kept."""

    largest_bytes: int = 500_000_000
    """Size of all libraries together; the ones that were used longest ago go first. A library takes 20 to 200 kB, a search makes thirty."""


CACHE_POLICY = CachePolicy()


@dataclass(frozen=True)
class GradualPolicy:
    """When a structure that the tape machine runs has earned a library of its own."""

    earned_seconds: float = 0.1
    """Seconds that the machine spends on a library's work before the library is compiled, quickly: half of what that takes, on another
    core if there is one. Most structures of a search never spend so much."""
    translated_seconds: float = 0.02
    """The same where LLVM is installed, which takes 30 to 100 ms."""
    most_translated: int = 64
    """Steps whose translated routines a process keeps for a kernel that comes again; beyond, those that were used longest ago go. Each
    takes about 1 MB, a search makes twenty to fifty, and without a limit a process that searches all day fills the memory."""
    full_seconds: float = 0.5
    """Seconds in what was compiled quickly before it is compiled with all optimisation, in the background: half a second, for code that
    takes a tenth to a half less time and is there when the same model comes again."""
    most_instructions: float = 1e8
    """Instructions of one pass from which the compiler is waited for: the machine would take a quarter of a second, the
    compiler no longer."""


GRADUAL_POLICY = GradualPolicy()
