"""Units as loggers write them, read as this library spells them: ``U/min``, ``Nm``, ``m3/h``, ``min-1``, ``Grad``, ``inc``."""

from __future__ import annotations

import re
from functools import lru_cache
from itertools import product

from greybox.base import ModelError, is_unit, parse_unit, unit_converter
from greybox.base.units import Conversion, UnitError, has_zero_point, parse_powers

# Everyday words, English and German, in small letters unless their case tells them apart.
WORDS: dict[str, str] = {
    word: unit
    for unit, words in {
        "s": "sec secs second seconds sek sekunde sekunden",
        "ms": "msec msecs millis millisec millisecond milliseconds millisekunde millisekunden",
        "us": "usec usecs micros microsec microsecond microseconds mikrosekunde mikrosekunden",
        "ns": "nsec nsecs nanos nanosec nanosecond nanoseconds nanosekunde nanosekunden",
        "min": "min mins minute minutes minuten",
        "h": "hr hrs hour hours std stunde stunden",
        "day": "day days tag tage",
        "turn": "U rev revs rot rots rotation rotations umdr umdrehung umdrehungen tr r",
        "deg": "degs degree degrees Grad winkelgrad",
        "rad": "rads radian radians radiant",
        "degC": "degc celsius °c ºc ºC",
        "degF": "degf fahrenheit °f ºF",
        "K": "°K degk kelvin",
        "V": "volt volts vdc",
        "A": "amp amps ampere",
        "%": "pct percent prozent",
        "permille": "promille ‰",
        "rpm": "rpm upm",
        "psi": "psia",
        "kPa": "kpa",
        "hPa": "hpa",
        "l/min": "lpm",
        "gal/min": "gpm",
        "m^3": "cbm",
        "cm^3": "ccm",
        "kgf": "kp",
        "lb": "lbs",
        "metric_horsepower": "ps PS",
        "knot": "kts",
        "km/h": "kmh",
        "m/s": "mps",
        "Hz": "hz",
        "kHz": "khz",
        "ohm": "ohms",
        "inch": "zoll",
    }.items()
    for word in words.split()
}
# Words of readings that are in nobody's unit: each is 1.
COUNT_WORDS = frozenset(
    word
    for words in (
        "inc incs increment increments ink inkrement inkremente raw raws rohwert rohwerte count counts cnt cnts cts step steps schritt",
        "schritte tick ticks pulse pulses puls imp impuls impulse digit digits dig lsb lsbs bit bits adc dac code codes dn adu stk stück",
        "edge edges a.u. au arb arb. none n/a unitless dimensionless bool boolean flag p.u. pu px pixel pixels",
        "pel dots ct pcs pts",
    )
    for word in words.split()
)
COUNT = "count"
# Texts of several meanings, or of none that a number could be converted by, and the rule.
_UNCLEAR: tuple[tuple[re.Pattern[str], str], ...] = tuple(
    (re.compile(pattern, re.IGNORECASE), rule)
    for pattern, rule in (
        (
            r"m?(bar|psi|k?pa|mpa|hpa)[ _]?(\(?[gü]\)?|gauge)",
            "a gauge pressure counts from the pressure around; add that, or state the unit without the g where the model's does too",
        ),
        (r"slpm|slm|sccm|scfm|(?-i:sl|ln|Nl|NL|Nm3|Nm³)/(min|h|s)", "a flow of standard litres is one of mass"),
        (r"(?-i:grad|GRAD)(/.*)?", "it is gon (400 to a turn) to some and deg (360) to others"),
        (r"tons?(/.*)?", "it is 907 kg to some, 1016 or 1000 to others; say t for the last"),
        (r"(?-i:d[bB])(m|v|u|uv|mv|a|c|i|w|z|fs|spl)?", "a logarithm is no unit; convert it to the quantity itself"),
    )
)
_ABSOLUTE = re.compile(r"(?P<unit>m?bar|[kMh]?Pa|psi)[ _]?(\(a\)|a|\(?abs\.?\)?|absolute?)")
_SUPERSCRIPTS = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹º", "-0123456789°")
# Nm, mNm, Nms, kgm, Ws, Pas: products without a sign.
PRODUCT = re.compile(r"(?P<first>[pnumkMG]?(?:N|V|A|W|Pa|J)|kg)(?P<length>mm|cm|m)?(?P<last>s|A)?")
# A symbol and its exponent: min-1, s^2, and of lengths and times m3.
_SYMBOL = re.compile(r"(?P<word>°?[^\W\d_]+|°|%|‰)(?:\^(?P<power>-?\d)|(?P<below>-\d)|(?<=[mnshdt])(?P<digit>[2-4]))?")
# Letters that are another unit (coulomb, farad, gram), which signals of these dimensions cannot be in.
_BY_DIMENSION = {parse_unit("K").dimensions: {"C": "degC", "F": "degF"}, parse_unit("m/s^2").dimensions: {"g": "g_0"}}


# A number beside these (12 bit) is a resolution, whoever says it.
BITS = frozenset((COUNT, "bit", "byte", "B"))


@lru_cache(maxsize=4096)
def read_notation(text: str, target: str = "", *, is_told: bool = False) -> str:
    """The unit that a logger's text stands for.

    Parameters
    ----------
    text
        As a header, an attribute or a row of units has it.
    target
        Unit of the signal that it is read for: ``C`` is a degree Celsius for one in K.
    is_told
        Whether a person says that this is what one count stands for: ``turn/2048``, ``10 ms``.

    Returns
    -------
    str
        The same unit in the spelling of this library; ``count`` for what is nobody's unit (``inc``, ``RAW``).

    Raises
    ------
    ModelError
        For a text that is no unit, holds a number (``8bits``, ``10 V``) or has several meanings.

    Examples
    --------
    >>> [read_notation(text) for text in ("U/min", "mNm", "m3/h", "min-1", "kgm²", "Grad", "inc")]
    ['turn/min', 'mN*m', 'm^3/h', 'min^-1', 'kg*m^2', 'deg', 'count']
    """
    plain = text.strip().removeprefix("in ")
    if plain == target or plain in ("", "-", "1"):
        return plain
    dimensions = parse_unit("K" if has_zero_point(target) else target).dimensions
    if plain in _BY_DIMENSION.get(dimensions, {}):
        return _BY_DIMENSION[dimensions][plain]
    for pattern, rule in _UNCLEAR:
        if pattern.fullmatch(plain):
            raise UnitError(f"unit {plain!r}: {rule}")
    words = plain.lower().split()
    if words[-1] in COUNT_WORDS and all(map(str.isalpha, words[:-1])):
        return COUNT
    absolute = _ABSOLUTE.fullmatch(plain)
    unit = absolute["unit"] if absolute else _spell(plain)
    number, powers = parse_powers(unit)
    if number != 1.0 and (not is_told or has_zero_point(unit) or BITS.intersection(powers)):
        raise UnitError(f"unit {plain!r}: the number in it may be a range or a resolution")
    if not is_unit(unit):
        parse_unit(unit)  # which says what is wrong with it
    return unit


def _spell(text: str) -> str:
    """Words, products and exponents in the place of their notations; the text as it is where that gives no unit."""
    plain = re.sub(r"\.?\s*([/*·]|$)\s*", r"\1", text.translate(_SUPERSCRIPTS))
    plain = re.sub(r"^(?:deg|°|[Gg]rad)\s*([CFK])$", r"°\1", plain)
    # m s-1, N.m: a blank or a point between symbols multiplies.
    plain = re.sub(r"(?<=[\w%])[ .](?=[^\W\d])", "*", plain)
    plain = f"1{plain}" if plain.startswith("/") else plain
    spelled = re.sub(r"^\(([^()]*)\)$", r"\1", _SYMBOL.sub(_spell_symbol, plain))
    return spelled if is_unit(spelled) else text


def _spell_symbol(match: re.Match[str]) -> str:
    word, exponent = match["word"], match["power"] or match["below"] or match["digit"]
    product = PRODUCT.fullmatch(word)
    if product and (product["length"] or product["last"]):
        # The exponent belongs to the last factor: kgm2 is kg m^2.
        symbol = "*".join(part for part in product.groups() if part)
    else:
        symbol = _spell_word(word)
    symbol = f"({symbol})" if "/" in symbol or ("^" in symbol and exponent) else symbol
    return f"{symbol}^{exponent}" if exponent else symbol


def _spell_word(word: str) -> str:
    small = word.lower()
    if word in WORDS or (len(word) > 2 and small in WORDS):
        return WORDS.get(word) or WORDS[small]
    if small in COUNT_WORDS:
        return COUNT
    # Capitals of a printed header (BAR, Sec), and K in the place of kilo.
    for other in (
        word,
        f"k{word[1:]}" if word[0] == "K" else word,
        small if len(word) > 2 and word.isupper() else word,
    ):
        if is_unit(other):
            return other
    return word


def is_notation(text: str) -> bool:
    """Whether a text is meant as a unit; one with a number (``8bits``) is, and is refused where it is used."""
    try:
        read_notation(text)
    except ModelError:
        return is_unit(text) or any(pattern.fullmatch(text) for pattern, _ in _UNCLEAR)
    return True


def read_conversion(text: str, target: str, *, is_told: bool = False) -> Conversion:
    """How numbers in the unit that a logger writes, or a person has said, become those of ``target``. Raises ModelError."""
    return unit_converter(read_notation(text, target, is_told=is_told), target)


def is_count(text: str) -> bool:
    """Whether a text names counts of a sensor and no unit (``inc``, ``RAW``)."""
    try:
        return read_notation(text) == COUNT
    except ModelError:
        return False


def converts(text: str, target: str, *, is_told: bool = False) -> bool:
    """Whether there is such a conversion."""
    try:
        read_conversion(text, target, is_told=is_told)
    except ModelError:
        return False
    return True


# Letters of a text whose cases are tried: each one doubles their number.
MOST_CASES = 6


def find_other_cases(text: str, target: str) -> tuple[str, ...]:
    """The units of the kind of ``target`` that a text is with other capitals: ``MS`` for seconds is ``ms`` or ``Ms``.

    Parameters
    ----------
    text
        A unit that does not convert to ``target`` as it is written.
    target
        Unit of the signal that it is read for.

    Returns
    -------
    tuple of str
        In the spelling of this library, the one with the most small letters first.
    """
    if sum(map(str.isalpha, text)) > MOST_CASES:
        return ()
    cases = map("".join, product(*(dict.fromkeys((letter.lower(), letter.upper())) for letter in text)))
    return tuple(dict.fromkeys(read_notation(case, target) for case in cases if converts(case, target)))
