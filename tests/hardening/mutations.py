"""Damage to valid files: of bytes, of lines and fields, of the values of a JSON document."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

Rng = np.random.Generator


def mutate_bytes(data: bytes, rng: Rng) -> bytes:
    """One to four faults of a disk or a transfer: changed, lost, doubled, zeroed or exchanged bytes, a lost end."""
    changed = bytearray(data)
    for _ in range(int(rng.integers(1, 5))):
        if not changed:
            break
        place, length = int(rng.integers(len(changed))), int(rng.integers(1, 65))
        match int(rng.integers(8)):
            case 0:
                changed[place] ^= 1 << int(rng.integers(8))
            case 1:
                changed[place] = int(rng.choice([0, 1, 0x7F, 0x80, 0xFF, 0x22, 0x2C, 0x0A, 0x23]))
            case 2:
                del changed[place : place + length]
            case 3:
                changed[place:place] = changed[place : place + length]
            case 4:
                changed[place : place + length] = bytes(len(changed[place : place + length]))
            case 5:
                changed[place : place + length] = rng.bytes(length)
            case 6:
                del changed[place:]
            case _:
                # lengths and counts of binary formats
                changed[place : place + 4] = int(rng.choice([0, 1, 2**16, 2**31 - 1, 2**31, 2**32 - 1])).to_bytes(
                    4, "little"
                )
    return bytes(changed)


FIELDS = (
    *(
        "",
        "nan",
        "inf",
        "-inf",
        "1e999",
        "1e300",
        "-1e-320",
        "0x10",
        "1_000",
        "1,5",
        '"',
        '""',
        '"a',
        "#N/A",
        "#",
        "%",
        "=1+1",
    ),
    *(
        "true",
        "None",
        "null",
        "1e",
        "١٢",
        "²",
        "\x00",
        "\ufeff",
        "\u202e",
        "'",
        "\t",
        ";",
        ",",
        " ",
        "9" * 400,
        "-",
        "2024-05-03",
    ),
)


def mutate_text(data: bytes, rng: Rng) -> bytes:
    """One to four faults of a logger or a person: fields, lines and headers that are wrong, missing, doubled or exchanged."""
    lines = data.decode("utf-8", "replace").split("\n")
    for _ in range(int(rng.integers(1, 5))):
        k = int(rng.integers(len(lines))) if rng.random() < 0.7 else 0
        fields = lines[k].split(",")
        j, field = int(rng.integers(len(fields))), str(rng.choice(FIELDS))
        match int(rng.integers(7)):
            case 0 | 1:
                fields[j] = field
            case 2:
                fields.insert(j, field)
            case 3:
                del fields[j]
            case 4:
                fields = [*fields, *fields] if rng.random() < 0.5 else fields[::-1]
            case 5:
                lines.insert(k, lines[int(rng.integers(len(lines)))])
                continue
            case _:
                lines[k] = ""
                continue
        lines[k] = ",".join(fields)
    return "\n".join(lines).encode("utf-8", "surrogatepass")


VALUES: tuple[Any, ...] = (
    *(
        None,
        True,
        0,
        -1,
        10**400,
        1e308,
        -1e308,
        "",
        "nan",
        "text",
        "\ud800",
        "../../x",
        "<script>",
        [],
        {},
        [[]],
        {"a": {}},
        [None],
    ),
    *([1, "2"], "x" * 10_000, 1.5, -0.0),
)


def places_of(data: Any, place: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    """The path to every value of a JSON document; of a long list to a few of its values."""
    if place:
        yield place
    if isinstance(data, dict):
        for key, value in data.items():
            yield from places_of(value, (*place, key))
    elif isinstance(data, list):
        for k in sorted({*range(min(3, len(data))), max(0, len(data) - 1)} if data else ()):
            yield from places_of(data[k], (*place, k))


def mutate_json(data: Any, places: Sequence[tuple[str | int, ...]], rng: Rng) -> Any:
    """One to three values that are missing, of another kind, elsewhere or out of range."""
    changed = copy.deepcopy(data)
    for _ in range(int(rng.integers(1, 4))):
        *way, last = places[int(rng.integers(len(places)))]
        try:
            inner = changed
            for step in way:
                inner = inner[step]
            match int(rng.integers(4)):
                case 0:
                    del inner[last]
                case 1 | 2:
                    inner[last] = VALUES[int(rng.integers(len(VALUES)))]
                case _:
                    inner[last] = copy.deepcopy(_value_at(data, places[int(rng.integers(len(places)))]))
        except (LookupError, TypeError):  # another fault has taken the place away
            continue
    return changed


def _value_at(data: Any, place: tuple[str | int, ...]) -> Any:
    for step in place:
        data = data[step]
    return data


Mutation = Callable[[bytes, Rng], bytes]
