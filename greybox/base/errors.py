"""Errors a person can act on: what, where, which rule, what to do."""

from __future__ import annotations

import difflib
import traceback
from collections.abc import Iterable
from enum import IntEnum
from typing import Any

from greybox.base.texts import to_line

# What callers catch, and exit codes; the functions below serve the messages of this library.
__all__ = [
    "DataError",
    "ExitCode",
    "FitError",
    "GreyboxError",
    "MissingNameError",
    "ModelError",
    "OutputError",
    "UnitError",
    "WorkersLostError",
]


class GreyboxError(Exception):
    """Base of every error the library raises on purpose. The command line ends with exit code 2."""


class ModelError(GreyboxError):
    """A model, an effect or a constant is stated in a way that cannot be right."""


class MissingNameError(ModelError):
    """A model has no site, signal or parameter of the name or role that an effect asks for.

    Attributes
    ----------
    kind
        ``site``, ``state``, ``input``, ``parameter``, or ``unit`` for something whose unit is asked for.
    name
        Its name or role.
    """

    def __init__(self, message: str, kind: str, name: str) -> None:
        self.kind, self.name = kind, name
        super().__init__(message)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (str(self), self.kind, self.name)


class UnitError(ModelError):
    """A term of an equation has another unit than the equation."""


class DataError(GreyboxError):
    """A record cannot be read as the model needs it."""


class FitError(GreyboxError):
    """A fit ended without success and the caller asked for an exception."""


class OutputError(GreyboxError, OSError):
    """A file cannot be written; what it held before stands. The command line ends with exit code 1.

    ``errno``, ``strerror`` and ``filename`` are those of the system's error.
    """

    def __str__(self) -> str:
        return f"{self.filename}: cannot be written ({self.strerror}); what was there before stands"


# What models, solvers and compilers raise: errors of this library, CasADi's (RuntimeError), those of arithmetic, and what a compiler or a
# full disk gives.
NUMERICAL_ERRORS = (GreyboxError, RuntimeError, ArithmeticError, OSError, MemoryError)


def is_numerical(error: Exception) -> bool:
    """Whether models, solvers and compilers raise such an error, so that it is a result of theirs; any other is a bug.

    ``ValueError`` is what libraries raise for arrays that are not finite and for singular matrices. Raised in a line of this library, or by
    NumPy called there, it is a wrong shape.
    """
    if not isinstance(error, ValueError):
        return isinstance(error, NUMERICAL_ERRORS)
    is_plain = type(error) is ValueError and "NaN" not in str(error)  # a singular matrix is a class of NumPy's
    return not (is_plain and is_raised_here(error))


def is_raised_here(error: Exception) -> bool:
    """Whether a line of this library raised an error, or NumPy called there: not a function that a user wrote."""
    return _package_of(error, but="numpy") == _OWN


def is_own_bug(error: Exception) -> bool:
    """Whether lines of this library raised an error that neither models and solvers nor damaged files do: it must end the run."""
    # A class of another library (zlib.error) comes from its compiled code, which has no line of its own.
    is_expected = isinstance(error, (*NUMERICAL_ERRORS, ValueError)) or type(error).__module__ != "builtins"
    return _package_of(error) == _OWN and not is_expected


_OWN = __name__.partition(".")[0]


def _package_of(error: Exception, but: str = "") -> str:
    """The package whose line raised an error, apart from one that was called there."""
    modules = [str(frame.f_globals.get("__name__")) for frame, _ in traceback.walk_tb(error.__traceback__)]
    packages = [module.partition(".")[0] for module in modules]
    return next((package for package in reversed(packages) if package != but), "")


class WorkersLostError(GreyboxError):
    """The workers cannot go on: their cluster is lost, or they are of another version. The command line ends with exit code 1.

    Attributes
    ----------
    fault
        What is wrong with the workers.
    results
        The `greybox.base.parallel.jobs.JobResult` of each job, None for those that are not finished.
    """

    def __init__(self, fault: str, results: Iterable[Any]) -> None:
        self.fault, self.results = fault, tuple(results)
        done = sum(result is not None for result in self.results)
        super().__init__(f"workers lost: {fault}; {done} of {len(self.results)} jobs are finished")


def shorten(text: str, length: int = 60) -> str:
    """``text`` on one line, fit for a message whatever a file held: no control characters, and not too long."""
    words = " ".join(to_line(text[: 4 * length]).split())
    return words if len(words) <= length else f"{words[: length - 3]}..."


# Known names up to this number are all listed.
MOST_LISTED = 30


def nearest(name: str, known: Iterable[str]) -> str:
    """Remedy for an unknown name: the closest known names, and all of them unless there are too many.

    >>> nearest("Kff", ["Kf", "M"])
    "did you mean 'Kf'? (known: Kf, M)"
    """
    names = list(dict.fromkeys(known))
    close = difflib.get_close_matches(name, names, n=3, cutoff=0.5)
    if close:  # beside a name that is much closer the others only distract
        closest = difflib.SequenceMatcher(None, close[0], name).ratio()
        close = difflib.get_close_matches(name, names, n=3, cutoff=closest - 0.2)
    listing = ", ".join(names) if names else "none"
    if not close:
        return f"known: {listing}"
    beside = f"known: {listing}" if len(names) <= MOST_LISTED else f"{len(names)} are known"
    return f"did you mean {' or '.join(repr(c) for c in close)}? ({beside})"


# Similarity from which one name is another one with a slip of the pen.
SLIP_SIMILARITY = 0.75


def is_slip_of(name: str, known: Iterable[str]) -> bool:
    """Whether an unknown name is one of those that are known but for its case or a letter.

    >>> is_slip_of("P_s", ["P_S", "M"]), is_slip_of("load", ["P_S", "M"])
    (True, False)
    """
    lower = name.lower()
    return any(difflib.SequenceMatcher(None, lower, k.lower()).ratio() >= SLIP_SIMILARITY for k in known)


class ExitCode(IntEnum):
    """How a command ended: a contract with whoever runs it from a script."""

    SUCCESS = 0
    UNSUCCESSFUL = 1
    """The computation ran and did not succeed, for instance a fit that did not converge."""
    BAD_INPUT = 2
    """Something that was typed or read cannot be used; nothing was computed or written."""
    INTERRUPTED = 130
    """Ctrl-C, as shells report it: 128 plus the number of the signal."""
