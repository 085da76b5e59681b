"""Results as values: a fit, its constants, its misfit; saved and loaded as JSON."""

from greybox.result.store import layout, load_fit, plain
from greybox.result.values import End, Estimate, Fit, Misfit, PriorCheck, Trace

__all__ = ["End", "Estimate", "Fit", "Misfit", "PriorCheck", "Trace", "layout", "load_fit", "plain"]
