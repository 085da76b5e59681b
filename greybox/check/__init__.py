"""What can be said about a model, and about records for it, before anything is fitted."""

from greybox.check.check import Check, check

__all__ = ["Check", "check"]
