"""Units of measure: what a unit is worth in SI, whether two agree, how data are converted, what a person calls them."""

from greybox.units.convert import convert, converter
from greybox.units.names import name, tidy
from greybox.units.symbols import parse
from greybox.units.unit import ONE, Unit

__all__ = ["ONE", "Unit", "convert", "converter", "name", "parse", "tidy"]
