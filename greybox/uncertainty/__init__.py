"""Intervals that do not lean on the curvature at the optimum: profile likelihood and the block bootstrap."""

from greybox.uncertainty.bootstrap import Bootstrap, bootstrap
from greybox.uncertainty.profile import Profile, profile

__all__ = ["Bootstrap", "Profile", "bootstrap", "profile"]
