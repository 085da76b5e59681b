"""Where model and data disagree, which effect is missing, and whether one may say so."""

from greybox.discover.bench import Bench, Trial
from greybox.discover.discover import discover
from greybox.discover.result import Discovery

__all__ = ["Bench", "Discovery", "Trial", "discover"]
