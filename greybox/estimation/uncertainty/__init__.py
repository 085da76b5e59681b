"""Intervals that do not lean on the curvature at the optimum: profile likelihood and the block bootstrap."""

from greybox.estimation.uncertainty.bootstrap import Bootstrap, bootstrap, load_bootstrap
from greybox.estimation.uncertainty.profile import Profile, load_profile, profile

__all__ = ["Bootstrap", "Profile", "bootstrap", "load_bootstrap", "load_profile", "profile"]
