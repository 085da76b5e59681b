"""Physical quantities as people read them: millivolts rather than 1e-3 V."""

from __future__ import annotations

import math
import re
import string
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from greybox.estimation.result_parts import Misfit

# Units that take a prefix as they are; others (m/s**2, rad, bar) are left alone.
PREFIXED = {"m", "m/s", "s", "V", "V/s", "A", "N", "Pa", "W", "Hz", "H", "F", "T", "N*m", "J"}
PREFIXES = {-9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}


def with_unit(number: str, unit: str) -> str:
    """A number and its unit, whose powers are written ``s^2`` however the model writes them; a pure number has none."""
    return number if unit == "1" else f"{number} {unit.replace('**', '^')}".rstrip()


def value_with_unit(value: float, unit: str, digits: int = 3) -> str:
    """``0.31 mV`` as it is, without another prefix."""
    return with_unit(f"{value:.{digits}g}", unit)


def percent_text(share: float, digits: int = 3) -> str:
    """A share in percent with so many digits, more where the whole percents need them: ``582 %``, never as a power of ten."""
    whole = len(f"{abs(100 * share):.0f}")
    return f"{100 * share:.{max(digits, whole)}g} %"


def spread_text(spread: float, unit: str, relative: bool) -> str:
    """A standard deviation as ``2.1 %``, or in the unit; one of zero is one that the records do not show."""
    if not spread:
        return "not visible"
    return percent_text(spread, 2) if relative else value_with_unit(spread, unit, 2)


def range_with_unit(low: float, high: float, unit: str) -> str:
    """``-1 to 2.5 V``; ``no values`` where there are none."""
    return with_unit(f"{low:.4g} to {high:.4g}", unit) if math.isfinite(low) else "no values"


def choose_prefix(unit: str, largest: float) -> tuple[float, str]:
    """Factor and prefix with which a ``largest`` value in ``unit`` has one to three digits: ``(1e6, "µ")``."""
    if unit not in PREFIXED or not (largest > 0 and math.isfinite(largest)):
        return 1.0, ""
    # 0.9997 V is written 1 V, not 1000 mV.
    exponent = 3 * math.floor(math.log10(float(f"{largest:.3g}")) / 3)
    exponent = min(max(exponent, min(PREFIXES)), max(PREFIXES))
    return 10.0**-exponent, PREFIXES[exponent]


def quantity_text(value: float, unit: str, digits: int = 3, beside: float = 0.0) -> str:
    """``0.31 mV``, in the unit that suits the larger of it and the value ``beside`` it."""
    factor, prefix = choose_prefix(unit, max(abs(value), abs(beside)))
    return with_unit(f"{factor * value:.{digits}g}", f"{prefix}{unit}")


def change_text(before: float, after: float, unit: str, digits: int = 3) -> str:
    """``8.84 to 0.31 mV``: both in the unit that suits the larger one."""
    factor, prefix = choose_prefix(unit, max(abs(before), abs(after)))
    return with_unit(f"{factor * before:.{digits}g} to {factor * after:.{digits}g}", f"{prefix}{unit}")


def limit_text(low: float, high: float, unit: str = "", digits: int = 3) -> str:
    """``0.5 to 1.5 A``; ``at most 1.5 A`` or ``at least 0.5 A`` where the other end is open."""
    if math.isinf(low):
        return f"at most {quantity_text(high, unit, digits)}"
    return f"at least {quantity_text(low, unit, digits)}" if math.isinf(high) else change_text(low, high, unit, digits)


# What templates are written with: sentences as data, lists, counts, capitals.

# Beginnings of a sentence that may take a capital; a name of a signal or a parameter stays as it is.
_WORD = re.compile(r"[a-z]{3,}[ :,-]|(?:no|at|on|in|it|of|is|an?|as|by|if|to)[ :]")


def count_noun(count: int, noun: str) -> str:
    """``1 record``, ``2 records``."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def join_names(names: Sequence[str]) -> str:
    """``a``, ``a and b``, ``a, b and c``."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}" if names else ""


def record_text(name: str) -> str:
    """A record as a sentence names it: ``record steps``, and ``record 1`` for one that has only its number for a name."""
    return name if name.startswith("record ") else f"record {name}"


def capitalise(text: str) -> str:
    """With a capital at its beginning, where that is a word and not a name."""
    return text[:1].upper() + text[1:] if _WORD.match(text) else text


def as_sentence(text: str) -> str:
    """With a capital at its beginning, where that is a word, and a full stop at its end."""
    text = capitalise(text.strip())
    return text + ("" if text.endswith((".", "!", "?", ":")) or not text else ".")


class _Quantity(NamedTuple):
    value: float
    unit: str


class SentenceFormatter(string.Formatter):
    """What templates of sentences are filled in by: format strings that know lists, plurals, shares and units as well.

    ``{names:list}`` is ``a, b, c`` and ``{names:and}`` is ``a, b and c``; ``{gaps:noun gap}`` is ``2 gaps``; ``{names:is|are}`` goes by how
    many there are; ``{share:percent 2}`` is ``12 %``; ``{limit@unit:3}`` is a value with its unit, to three digits.
    """

    def get_value(self, key: int | str, args: Sequence[Any], kwargs: Mapping[str, Any]) -> Any:
        """The value of a name, or a quantity of two."""
        name, at, unit = str(key).partition("@")
        return _Quantity(kwargs[name], kwargs[unit]) if at else kwargs[name]

    def format_field(self, value: Any, spec: str) -> str:
        """A value as its spec says."""
        kind, _, rest = spec.partition(" ")
        if isinstance(value, _Quantity):
            return value_with_unit(*value, int(spec))
        if "|" in spec:
            one, several = spec.split("|")
            return one if (value if isinstance(value, int) else len(value)) == 1 else several
        match kind:
            case "list":
                return ", ".join(map(str, value))
            case "and":
                return join_names(list(value))
            case "noun":
                return count_noun(value, rest)
            case "percent":
                return percent_text(value, int(rest))
        return str(format(value, spec))


fill_in = SentenceFormatter().vformat


# Numbers and tables in plain text, for every renderer.


def format_number(value: float, digits: int = 5) -> str:
    """A number for people: ``digits`` significant digits, short."""
    return f"{value:.{digits}g}"


def format_with_std(value: float, std: float) -> str:
    """``value +- std`` with two digits of the uncertainty: ``0.26910 +- 0.00034``."""
    if not (std > 0 and math.isfinite(std)):
        return format_number(value)
    write = make_formatter(value, std)
    return f"{write(value)} +- {write(std)}"


# A value keeps so many significant digits of its own where its standard deviation leaves fewer: 0.044 +- 2.2, and not 0.0.
LEAST_DIGITS = 2


def make_formatter(value: float, std: float) -> Callable[[float], str]:
    """How to write numbers beside ``value +- std``, such as the ends of its interval: to two digits of the uncertainty."""
    if not (std > 0 and math.isfinite(std)):
        return format_number
    last = math.floor(math.log10(std)) - 1

    def places(v: float) -> int:
        """Decimal places that hold the last digit of the uncertainty, and two digits of the number."""
        second = math.floor(math.log10(abs(v))) - LEAST_DIGITS + 1 if v and math.isfinite(v) else last
        return -min(last, second)

    if not (abs(value) >= 1e6 or 0 < abs(value) < 1e-3 or -last > 8):
        return lambda v: f"{v:.{max(places(v), 0)}f}" if places(v) <= 8 else f"{v:.{LEAST_DIGITS - 1}e}"

    def scientific(v: float) -> str:
        leading = math.floor(math.log10(max(abs(v), std))) if math.isfinite(v) else 0
        return f"{v:.{min(max(leading - last, LEAST_DIGITS - 1), 9)}e}"

    return scientific


def plain_number(value: float) -> str:
    """Three digits, whole numbers in full up to a million: ``1320``, ``0.754``."""
    return f"{value:.0f}" if 1e3 <= abs(value) < 1e6 else f"{value:.3g}"


def times_text(ratio: float, what: str = "as much") -> str:
    """``1.5 times as much``; ``as much`` where the ratio is one as it is written."""
    times = f"{ratio:.3g}"
    return what if times == "1" else f"{times} times {what}"


def ratio_text(misfit: Misfit) -> str:
    """How many times its noise an error is: ``0.754``; ``at least 35.3`` where the noise has no more than a ceiling."""
    bound = {"at_most": "at least ", "at_least": "at most "}.get(misfit.direction or "", "")
    return f"{bound}{ratio_digits(misfit.noise_ratio)}"


def ratio_digits(ratio: float) -> str:
    """``0.754``, ``1.00``, ``35.3``, ``1320``: a ratio in three digits."""
    return plain_number(ratio) if ratio >= 1000 else f"{ratio:#.3g}".rstrip(".")


def noise_text(misfit: Misfit, beside: float = 0.0) -> str:
    """The noise that an error is divided by: ``0.2 µm``; ``at most 0.416 µm``, in the unit that suits the value ``beside`` it as well."""
    if misfit.noise is None or not math.isfinite(misfit.noise):
        return ""
    bound = {"at_most": "at most ", "at_least": "at least "}.get(misfit.direction or "", "")
    return f"{bound}{quantity_text(misfit.noise, misfit.unit, beside=beside)}"


def shorten(name: str, width: int) -> str:
    """A name of so many letters at most."""
    return name if len(name) <= width else f"{name[: width - 3]}..."


def format_shares(shares: Mapping[str, float]) -> str:
    """``2 % of x, 0.5 % of i`` from shares of one."""
    return ", ".join(f"{100 * share:.2g} % of {name}" for name, share in shares.items())


# What sentences leave out.

# Characters of a formula that are worth showing in a sentence.
LONGEST_FORMULA = 80
# Nothing is said to be more certain than this, in percent.
MOST_PERCENT = 99.0
# A noise level whose 95 % interval reaches further than a factor e to this is written without the interval: it says nothing.
NOISE_REACH = 5.0
# A change whose 95 % interval reaches further than so many times the value is not determined: its figures say nothing.
CHANGE_REACH = 10.0


COURSES = {
    "zero": "held between its rows",
    "first": "straight between its rows",
    "band-limited": "without content above half the rate between its rows",
    "mean": "as the mean over the interval before its row",
}
"""How an input moves between its rows."""
