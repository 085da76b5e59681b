"""The equations of a model as a person writes them: each balance with the names of its terms below, then inputs and outputs."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import casadi as ca

from greybox.base import format_unit
from greybox.model.balance import Balance, stores_nothing
from greybox.model.expressions.graph import as_scalar, nodes, walk
from greybox.model.expressions.operations import operation_name
from greybox.model.expressions.printer import MODELICA, Printer
from greybox.model.expressions.text import expression_text, signed_text
from greybox.model.model import Model
from greybox.model.system import System, intensity_unit

Line = Callable[[str, str, str], str]  # name, unit, text -> one line of the equations

# System -> width -> text: models that share a system differ in values alone, of which the equations say nothing.
_TEXTS: WeakKeyDictionary[System, dict[int, str]] = WeakKeyDictionary()
_EXACTLY: WeakKeyDictionary[System, dict[str, str]] = WeakKeyDictionary()


def equations_text(model: Model, width: int = 110, *, in_full: bool = False) -> str:
    """The equations of a model: one balance after the other, each term above its name, then inputs and outputs.

    Effects are written out: an added term stands under the effect's name, a changed input, output or parameter shows as what stands in
    its place.

    Parameters
    ----------
    model
        The model.
    width
        In characters: a longer balance is written one term a line. Results hold their equations at the default.
    in_full
        Whether what stands behind the name of a `Block` follows.

    Returns
    -------
    str
        Lines with name, unit and equation.
    """
    if not model.has_equations:
        effects = [f"  {b.effect.name} at {b.site}  {b.effect.equation}" for b in model.bound_effects]
        ties = [f"  tied  {tie}" for tie in model.ties]
        return "\n".join(["  no equations: it is run from outside", *effects, *ties])
    texts = _TEXTS.setdefault(model.system, {})
    if width not in texts:
        texts[width] = _write_equations(model, width)
    return "\n".join([texts[width], *(_blocks_in_full(model.system) if in_full else [])])


def _blocks_in_full(system: System) -> list[str]:
    """``joint_1: rigid body = ...`` of each block, after the parts that several places share."""
    blocks = [(b, name) for b in system.stated_balances for name in b.blocks]
    terms = [ca.SX(b.terms[name]) for b, name in blocks]
    names = {s.name(): s.name() for s in ca.symvar(ca.vertcat(*terms))} if blocks else {}
    printer = Printer(MODELICA, names)
    printer.count_uses(terms)
    lines = [
        f"  {b.name}: {b.blocks[name].name} = {('-' if b.blocks[name].is_negative else '')}({printer.write(term)})"
        for (b, name), term in zip(blocks, terms, strict=True)
    ]
    return [*(f"  {part} = {text}" for part, text in printer.shared), *lines]


def _write_equations(model: Model, width: int) -> str:
    system = model.system
    heads = [(b.name, _bracketed(b.unit)) for b in system.stated_balances]
    pushed = {
        k: _bracketed(intensity_unit(s)) for k, s in enumerate(model.all_states) if not system.diffusion[k].is_zero()
    }
    sticking = [d for d in system.dry if d.static.element_hash() != d.sliding.element_hash()]
    extra = [*("standstill" for _ in sticking), *("after a step" for _ in system.updates), "outputs"]
    extra += [*("process noise" for _ in pushed), *("tied" for _ in model.ties)]
    name_width = max(map(len, [*(name for name, _ in heads), *extra])) + 2
    units = {q.name: _bracketed(q.unit) for q in model.stated_parameters}
    tie_units = [units[tie.name] for tie in model.ties]
    unit_width = max(map(len, [*(unit for _, unit in heads), *pushed.values(), *tie_units])) + 2
    indent = 2 + name_width + unit_width

    def line(name: str, unit: str, text: str) -> str:
        return f"  {name:{name_width}}{unit:{unit_width}}{text}".rstrip()

    lines = []
    for balance, head in zip(system.stated_balances, heads, strict=False):
        first, *rest = _balance(balance, width - indent)
        lines += [line(*head, first), *(" " * indent + text for text in rest)]
    for d in sticking:
        unit = next(b.unit for b in system.balances if b.name == d.balance)
        lines.append(line("standstill", _bracketed(unit), f"{d.effect} holds up to {expression_text(d.static)}"))
    for update in system.updates:
        state = model.all_states[update.state]
        lines.append(
            line("after a step", _bracketed(state.unit), f"{state.name} becomes {expression_text(update.value)}")
        )
    for k, unit in pushed.items():
        text = f"{expression_text(system.diffusion[k])} dw pushes {model.all_states[k].name}"
        lines.append(line("process noise", unit, text))
    lines += [line("tied", unit, str(tie)) for tie, unit in zip(model.ties, tie_units, strict=True)]
    if model.inputs:
        delays = {
            k: " + ".join(expression_text(d.seconds) for d in system.delays if d.column == k)
            for k in range(len(model.inputs))
        }
        inputs = [
            f"{i.name} {_bracketed(i.unit)}" + f" delayed by {delays[k]}" * bool(delays[k])
            for k, i in enumerate(model.inputs)
        ]
        lines += _listed(line, "inputs", inputs, width - indent)
    outputs = system.outputs if system.stated_outputs is None else system.stated_outputs
    measured = [f"{o.name} {_bracketed(o.unit)} = {expression_text(outputs[k])}" for k, o in enumerate(model.outputs)]
    lines += _listed(line, "outputs", measured, width - indent)
    return "\n".join(lines)


def _bracketed(unit: str) -> str:
    return f"[{format_unit(unit) or '-'}]"


def _balance(balance: Balance, width: int) -> list[str]:
    """``M dv/dt = Kf i - B v`` and, below, the names of the terms."""
    left = "0 = " if stores_nothing(balance) else f"{_storage(balance)} = "
    if not balance.terms:  # a random walk
        return [f"{left}0"]
    count = len(balance.terms)
    terms = [
        (block.is_negative, block.name, name) if (block := balance.blocks.get(name)) else (*_term(value, count), name)
        for name, value in balance.terms.items()
    ]
    equation, names = left, " " * len(left)
    for k, (negative, text, name) in enumerate(terms):
        sign = (" - " if negative else " + ") if k else "-" * negative
        column = max(len(text), len(name))
        equation += sign + text.ljust(column)
        names += " " * len(sign) + name.ljust(column)
    if len(equation.rstrip()) <= width:
        return [equation.rstrip(), names.rstrip()]
    return _one_term_a_line(left, terms)


def _one_term_a_line(left: str, terms: Sequence[tuple[bool, str, str]]) -> list[str]:
    signs = [
        ("- " if negative else "+ ") if k else ("-" if negative else "") for k, (negative, _, _) in enumerate(terms)
    ]
    texts = [sign + text for sign, (_, text, _) in zip(signs, terms, strict=True)]
    column = max(map(len, texts)) + 2
    starts = [left, *[" " * len(left)] * (len(terms) - 1)]
    return [start + text.ljust(column) + name for start, text, (_, _, name) in zip(starts, texts, terms, strict=True)]


def _term(value: ca.SX | float, of: int) -> tuple[bool, str]:
    return signed_text(value) if of > 1 else (False, expression_text(value))


def _storage(balance: Balance) -> str:
    state = balance.state
    rate = f"d{state}/dt" if state.isidentifier() else f"d({state})/dt"
    negative, text = signed_text(balance.storage)
    if text == "1":
        return "-" * negative + rate
    return "-" * negative + (f"({text})" if "/" in text and text[0] != "(" else text) + " " + rate


def _listed(line: Line, head: str, items: Sequence[str], width: int) -> list[str]:
    together = ",  ".join(items)
    if len(together) <= width:
        return [line(head, "", together)]
    return [line(head if k == 0 else "", "", item) for k, item in enumerate(items)]


# What a model states, as a value that a result keeps: how a result is joined with a model, and how finished work is known.


class Difference(NamedTuple):
    """A line of a stored definition and the line of the model in its place; "" where one of them has none."""

    stored: str
    present: str

    def __str__(self) -> str:
        return f"{self.stored or 'nothing'} -> {self.present or 'nothing'}"


def declare(model: Model) -> dict[str, str]:
    """What a model states besides its equations, a line for each name: constants with units and bounds, states with starts, the plant."""
    system = model.system
    # Bounds of an effect follow the records that it is fitted to, and the plant that a search puts it into.
    tailored = {q.name for bound in model.bound_effects for q in bound.parameters}
    lines = {
        q.name: _declare_constant(q.name, q.unit)
        + ("" if q.name in tailored else f" within {q.bounds[0]:.12g} to {q.bounds[1]:.12g}")
        for q in model.all_parameters
    }
    for k, state in enumerate(system.states):
        limits = f", within {state.bounds[0]:.12g} to {state.bounds[1]:.12g}"
        start = f"{expression_text(system.start[k])}{' and is fitted' * state.free_start}"
        lines[f"state {state.name}"] = (
            f"state {state.name} [{format_unit(state.unit) or '-'}] starts at {start}{limits}"
        )
    lines |= {f"output {o.name}": f"output {o.name} wraps at {o.wraps:.12g}" for o in model.outputs if o.wraps}
    lines |= {f"record of {e.name}": f"{e.name} holds {e.hold}, late {e.late}" for e in model.effects if e.is_of_record}
    if model.identity:
        return lines | {"plant": f"plant {model.identity}"}
    if system not in _EXACTLY:
        _EXACTLY[system] = dict(_declare_exactly(system))
    return lines | _EXACTLY[system]


# What the equations do not show, which are written with six digits and the names of blocks, is kept under keys that begin with this.
EXACTLY = "exactly "


def _declare_exactly(system: System) -> Iterator[tuple[str, str]]:
    """The numbers of each equation with their digits, and a hash of what stands behind the name of a block."""
    outputs = system.outputs if system.stated_outputs is None else system.stated_outputs
    others = [system.start, *(d.static for d in system.dry), *(u.value for u in system.updates), system.diffusion]
    equations = {
        b.name: [b.storage, *(term for name, term in b.terms.items() if name not in b.blocks)]
        for b in system.stated_balances
    }
    for name, parts in {**equations, "outputs": [outputs], "states": others}.items():
        roots = [as_scalar(part[k]) for part in map(ca.SX, parts) for k in range(part.numel())]
        numbers = sorted({float(node) for node in nodes(roots) if node.is_constant()})
        yield f"{EXACTLY}{name}", f"{name}: the numbers {', '.join(f'{number:.12g}' for number in numbers)}"
    for balance in system.stated_balances:
        for term, block in balance.blocks.items():
            text = f"{balance.name}: what stands for {block.name}: {_hash_exactly([ca.SX(balance.terms[term])])[:8]}"
            yield f"{EXACTLY}{balance.name}.{term}", text


def _hash_exactly(expressions: Iterable[ca.SX]) -> str:
    """A hash of scalar expressions, with numbers to twelve digits."""

    def combine(node: ca.SX, operands: list[bytes]) -> bytes:
        return hashlib.sha256(b"|".join([operation_name(node.op()).encode(), *operands])).digest()

    parts = [walk(e, str.encode, lambda number: f"{number:.12g}".encode(), combine) for e in expressions]
    return hashlib.sha256(b"|".join(parts)).hexdigest()


def _declare_constant(name: str, unit: str) -> str:
    return f"{name} [{format_unit(unit) or '-'}]"


def compare_definition(
    model: Model, equations: str, declared: Mapping[str, str], units: Mapping[str, str]
) -> tuple[Difference, ...]:
    """What a model states otherwise than the definition that a result keeps.

    Parameters
    ----------
    model
        The model of today, with the effects and ties of the result.
    equations
        The equations of the result (`equations_text`).
    declared
        What else its model stated (`declare`); empty in files of earlier versions, of which constants are compared by name and unit.
    units
        Constant -> unit, of the result.

    Returns
    -------
    tuple of Difference
        Each line that differs; none where the result belongs to this model.
    """
    present = declare(model) if declared else {q.name: _declare_constant(q.name, q.unit) for q in model.all_parameters}
    if declared and not any(name.startswith(EXACTLY) for name in declared):
        present = {name: line for name, line in present.items() if not name.startswith((EXACTLY, "output "))}
    stored = declared or {name: _declare_constant(name, unit) for name, unit in units.items()}
    return compare_statements((equations, stored), (equations_text(model) if equations else "", present))


Statements = tuple[str, Mapping[str, str]]
"""The equations of a model and what else it states (`declare`)."""


def state_whole(model: Model, besides: Collection[str] = ()) -> Statements:
    """Everything that a model states, with values and priors of its constants but those ``besides``: what a study was written for."""
    values = {
        f"value {q.name}": f"{q.name} = {q.value:.12g} {format_unit(q.unit)}".rstrip()
        + (f", prior {q.prior[0]:.12g} +- {q.prior[1]:.12g}" if q.prior else "")
        for q in model.all_parameters
        if q.name not in besides
    }
    return equations_text(model), declare(model) | values


def compare_statements(stored: Statements, present: Statements) -> tuple[Difference, ...]:
    """Each line that differs; none for statements of one model."""
    before, now = _entries(stored[0]), _entries(present[0])
    heads = [head for head in {**before, **now} if before.get(head) != now.get(head)]
    pairs = [pair for head in heads for pair in _pair(before.get(head, []), now.get(head, []))]
    # An equation that is seen to differ needs no further line on its digits.
    shown = tuple(f"{EXACTLY}{head.partition(' ')[0]}" for head in heads)
    names = [name for name in {**stored[1], **present[1]} if not (shown and name.startswith(shown))]
    pairs += [(stored[1].get(name, ""), present[1].get(name, "")) for name in names]
    return tuple(Difference(*pair) for pair in pairs if pair[0] != pair[1])


def _entries(equations: str) -> dict[str, list[str]]:
    """Name of a balance, or of another part -> its lines, without the spaces that align them."""
    entries: dict[str, list[str]] = {}
    lines: list[str] = []
    for line in equations.splitlines():
        text = " ".join(line.split())
        # A part begins two characters in; what goes on stands below its equation.
        if line[2:3].strip():
            lines = entries.setdefault(text.partition("[")[0] if "[" in text else text, [])
        lines.append(text)
    return entries


def _pair(before: list[str], now: list[str]) -> list[tuple[str, str]]:
    if len(before) == len(now):
        return list(zip(before, now, strict=True))
    return [(" ".join(before), " ".join(now))]


def identify(model: Model) -> list[Any]:
    """Everything about a model that decides where a search ends: equations or the plant, constants, ties, bounds."""
    system = model.system
    return [
        _hash_exactly(e[k] for e in [*system.free_run_expressions, system.diffusion] for k in range(e.numel())),
        [(q.name, q.value, q.bounds, q.fixed, q.prior) for q in model.all_parameters],
        [(tie.name, tie.formula) for tie in model.ties],
        [(s.name, s.bounds, s.free_start) for s in model.all_states],
        [(e.hold, e.late) for e in model.effects],
        # Of a plant without equations these say nothing.
        model.identity,
    ]
