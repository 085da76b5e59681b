"""Units of measure: what a unit is worth in SI, whether two agree, how data are converted, what a person calls them."""

from greybox.units.convert import convert, unit_converter
from greybox.units.formatting import format_unit, unit_name
from greybox.units.symbols import parse_unit
from greybox.units.unit import ONE, Unit

__all__ = ["ONE", "Unit", "convert", "format_unit", "parse_unit", "unit_converter", "unit_name"]
