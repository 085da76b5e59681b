"""The text of a unit, read and written: ``N*s/m`` is a number and the powers of symbols."""

from __future__ import annotations

import math
import re
from fractions import Fraction
from functools import lru_cache

from greybox.errors import ModelError
from greybox.units.policy import UNIT_POLICY

Powers = dict[str, float]  # symbol -> exponent, in the order in which the symbols were written

TOKEN = re.compile(r"(\d+\.?\d*(?:[eE][+-]?\d+)?|\.\d+(?:[eE][+-]?\d+)?)|([^\W\d]\w*|%)|(\*\*|[*/^()+-])")
SPELLINGS = {"°C": "degC", "°F": "degF", "°": "deg", "·": "*", "²": "^2", "³": "^3"}
# Both code points of the micro sign (U+00B5, U+03BC) and of the ohm sign (U+03A9, U+2126) are found in files.
SPELLINGS |= {"\u00b5": "u", "\u03bc": "u", "\u03a9": "ohm", "\u2126": "ohm"}


@lru_cache(maxsize=4096)
def parse_powers(unit: str) -> tuple[float, Powers]:
    """Number and powers of symbols in a unit's text, multiplied out from left to right."""
    text = unit.strip()
    for special, plain in SPELLINGS.items():
        text = text.replace(special, plain)
    if text in ("", "-"):
        return 1.0, {}
    longest = UNIT_POLICY.longest_unit
    shown = unit if len(unit) <= longest else f"{unit[:longest]}..."
    try:
        if len(text) > longest:
            raise ValueError("too long")
        tokens = _tokens(text)
        factor, powers = _product(tokens)
        if tokens or not (0 < factor < math.inf and all(map(math.isfinite, powers.values()))):
            raise ValueError(tokens[-1] if tokens else factor)
    except (ValueError, IndexError, ArithmeticError):
        raise ModelError(
            f"unit {shown!r} cannot be read; write symbols with *, / and ^, as in N*s/m or m^3/(s*Pa)"
        ) from None
    return factor, {symbol: exponent for symbol, exponent in powers.items() if exponent}


def _tokens(text: str) -> list[str]:
    """Tokens in reverse order, so that the next one is popped from the end."""
    tokens = []
    position = 0
    while position < len(text):
        match = TOKEN.match(text, position)
        if not match and not text[position].isspace():
            raise ValueError(text[position])
        if match:
            tokens.append(match.group())
        position = match.end() if match else position + 1
    return tokens[::-1]


def _product(tokens: list[str]) -> tuple[float, Powers]:
    factor, powers = _power(tokens)
    while tokens and tokens[-1] != ")":
        sign = 1.0
        if tokens[-1] in ("*", "/"):
            sign = -1.0 if tokens.pop() == "/" else 1.0
        more, others = _power(tokens)
        factor *= more**sign
        for symbol, exponent in others.items():
            powers[symbol] = round(powers.get(symbol, 0.0) + sign * exponent, 9)
    return factor, powers


def _power(tokens: list[str]) -> tuple[float, Powers]:
    token = tokens.pop()
    if token == "(":
        factor, powers = _product(tokens)
        _expect(tokens, ")")
    elif token[0].isdigit() or token[0] == ".":
        factor, powers = float(token), {}
        if not factor:
            raise ValueError(token)
    elif token == "%" or token[0].isalpha() or token[0] == "_":
        factor, powers = 1.0, {token: 1.0}
    else:
        raise ValueError(token)
    if tokens and tokens[-1] in ("^", "**"):
        tokens.pop()
        exponent = _exponent(tokens)
        return factor**exponent, {symbol: e * exponent for symbol, e in powers.items()}
    return factor, powers


def _exponent(tokens: list[str]) -> float:
    token = tokens.pop()
    if token in ("+", "-"):
        return _exponent(tokens) * (-1.0 if token == "-" else 1.0)
    if token != "(":
        return float(token)
    value = _exponent(tokens)
    if tokens[-1] == "/":
        tokens.pop()
        value /= _exponent(tokens)
    _expect(tokens, ")")
    return value


def _expect(tokens: list[str], token: str) -> None:
    if tokens.pop() != token:
        raise ValueError(token)


def format_powers(factor: float, powers: Powers, digits: int = 6) -> str:
    """``N*s/m``, ``m^3/(s*Pa)``, ``1000 N``, ``1/s``: the text of a unit, in the order of ``powers``."""
    above = [_power_text(s, e) for s, e in powers.items() if e > 0]
    below = [_power_text(s, -e) for s, e in powers.items() if e < 0]
    number = [f"{factor:.{digits}g}"] if factor != 1 or not above else []
    text = " ".join([*number, *(["*".join(above)] if above else [])])
    if not below:
        return text
    return f"{text}/({'*'.join(below)})" if len(below) > 1 else f"{text}/{below[0]}"


def _power_text(symbol: str, exponent: float) -> str:
    if exponent == 1:
        return symbol
    short = f"{exponent:.4g}"
    return (
        f"{symbol}^{short}" if float(short) == exponent else f"{symbol}^({Fraction(exponent).limit_denominator(1000)})"
    )
