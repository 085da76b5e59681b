"""Limits of the cache of compiled kernels, how they are laid out, and when one is worth its compilation."""

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
    compile_memory: float = 1e9
    """Bytes of memory that a compiler may take, where the system can hold it to that. Models of 500 constants need a tenth of it; for
    200 states it goes on to 5 GB and does not end in time."""


CACHE_POLICY = CachePolicy()


@dataclass(frozen=True)
class CodePolicy:
    """How the instructions of a step are laid out."""

    most_values_ahead: int = 1000
    """Values that may be computed before the first tangent, in a step that calls functions such as ``tanh``: they lie in memory until
    then. A step of 700 values gains 6 % by that, a filter of 3000 takes 40 % more time."""


CODE_POLICY = CodePolicy()


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
    largest_scratch_bytes: int = 200_000
    """Registers of the machine lie on the stack; a thread may have as little as 512 kB of it. A model of ten states takes 20 kB."""


GRADUAL_POLICY = GradualPolicy()
