"""Results as values: a fit, its constants, its misfit; saved and loaded as JSON."""

from greybox.result.store import layout, load_fit, plain
from greybox.result.values import Estimate, Fit, Misfit, Trace

__all__ = ["Estimate", "Fit", "Misfit", "Trace", "layout", "load_fit", "plain"]
