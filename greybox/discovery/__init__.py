"""Where model and data disagree, which effect is missing, and whether one may say so."""

from greybox.discovery.attempt import Attempt, drop_effect, try_effect
from greybox.discovery.bench import Bench, Trial
from greybox.discovery.find import discover
from greybox.discovery.further import Deepened, Further, further
from greybox.discovery.gap import Gap
from greybox.discovery.look import Signal, Site, Unexplained, unexplained
from greybox.discovery.missing import Missing
from greybox.discovery.region import Region
from greybox.discovery.result import Discovery, Rank
from greybox.discovery.spectrum import Spectrum, residual_spectrum
from greybox.discovery.stand_in import StandIn, Tone
from greybox.discovery.when import Window

__all__ = [
    "Attempt", "Bench", "Deepened", "Discovery", "Further", "Gap", "Missing", "Rank", "Region", "Signal", "Site", "Spectrum", "StandIn",
    "Tone", "Trial", "Unexplained", "Window",
    "discover", "drop_effect", "further", "residual_spectrum", "try_effect", "unexplained",
]  # fmt: skip
