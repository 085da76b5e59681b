"""Where model and data disagree, which effect is missing, and whether one may say so."""

from greybox.discovery.bench import Bench, Trial
from greybox.discovery.discover import discover
from greybox.discovery.result import Discovery

__all__ = ["Bench", "Discovery", "Trial", "discover"]
