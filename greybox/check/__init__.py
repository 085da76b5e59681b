"""What can be said about a model, and about records for it, before anything is fitted."""

from greybox.check.check import ModelCheck, check

__all__ = ["ModelCheck", "check"]
