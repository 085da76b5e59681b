"""Slopes where they differ by side: dry friction at standstill, the edge of a dead zone, a valve that is just shut."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from greybox.export.model_functions import ModelFunctions
from greybox.units import format_unit

# Two slopes that differ by less than this share are one.
SAME = 1e-9


@dataclass(frozen=True)
class OneSidedDerivatives:
    """Slopes of the rates (nx, nx + nu) and of the outputs (ny, nx + nu), and what was chosen where there was a choice."""

    rates: np.ndarray
    outputs: np.ndarray
    notes: tuple[str, ...]


def differentiate_one_sided(equations: ModelFunctions, z: np.ndarray, p: np.ndarray) -> OneSidedDerivatives:
    """Slopes at ``z``, of each variable on the side where they are larger; dry friction at standstill without its jump."""
    slopes, kinks = _slopes(equations, z, p)
    notes = _frictions(equations, z, p)
    notes += [_kink(equations, z, p, column, side) for column, side in kinks]
    return OneSidedDerivatives(slopes[: equations.nx], slopes[equations.nx :], tuple(notes))


def _slopes(equations: ModelFunctions, z: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, list[tuple[int, int]]]:
    """Slopes (nx + ny, nx + nu), and the variables in which they differ by side with the side (1 or -1) that was taken."""
    sizes, still = equations.sizes(z, p), [k for k in equations.bodies if z[k] == 0]
    direction = equations.direction(z)
    if not still:
        return _by_column(equations, z, p, sizes, direction)
    # Friction jumps at standstill: its slope is the mean of those while sliding either way, from which the jump is left out.
    ways = []
    for way in (1, -1):
        there = np.where([d.state in still for d in equations.system.dry], way, direction)
        slopes, kinks = _by_column(equations, z, p, sizes, there, dict.fromkeys(still, way))
        ways.append((slopes, kinks))
    return (ways[0][0] + ways[1][0]) / 2, ways[0][1]


def _by_column(
    equations: ModelFunctions, z: np.ndarray, p: np.ndarray, sizes: np.ndarray, direction: np.ndarray,
    decided: dict[int, int] | None = None,
) -> tuple[np.ndarray, list[tuple[int, int]]]:  # fmt: skip
    """Slopes column by column; ``decided`` are the sides of variables that leave no choice."""
    switches = equations.switches(direction)
    edges = switches.edges(z, sizes, p)
    slopes = switches.jacobian(edges, z, np.zeros(len(z)), p)[1]
    if not len(edges):
        return slopes, []
    slopes, kinks = slopes.copy(), []
    weight = 1 / np.maximum(np.abs(slopes * sizes).sum(axis=1), 1e-300)
    for column in range(len(z)):
        way = np.zeros(len(z))
        way[column] = sizes[column]
        above, below = (switches.jacobian(edges, z, side * way, p)[1][:, column] for side in (1, -1))
        if decided and column in decided:
            slopes[:, column] = above if decided[column] > 0 else below
            continue
        apart = np.abs(above - below) > SAME * np.maximum(np.abs(above), np.abs(below))
        larger = 1 if np.linalg.norm(weight * above) >= np.linalg.norm(weight * below) else -1
        slopes[:, column] = above if larger > 0 else below
        if apart.any():
            kinks.append((column, larger))
    return slopes, kinks


def _frictions(equations: ModelFunctions, z: np.ndarray, p: np.ndarray) -> list[str]:
    """What stands in the place of dry friction."""
    notes = []
    for k, (push, static) in equations.holding(z, p).items():
        names = " and ".join(d.effect for d in equations.system.dry if d.state == k)
        state = equations.names[k]
        balance = next(b for b in equations.system.balances if b.state == state)
        unit = format_unit(balance.unit)
        if static == 0:
            continue
        held = f" of which {abs(push):.4g} {unit} are in use" if push else ""
        notes.append(
            f"{names} cannot be linearised at {state} = 0 (it holds up to {static:.4g} {unit}{held}): used instead is the body sliding,"
            f" with friction left out of the matrices; treat it as a disturbance of up to {static:.4g} {unit}, or compensate it"
        )
    return notes


def _kink(equations: ModelFunctions, z: np.ndarray, p: np.ndarray, column: int, side: int) -> str:
    model = equations.model
    guilty = []
    for effect in model.effects:
        reduced = ModelFunctions(model.without(effect.name))
        here = np.array([z[equations.names.index(name)] for name in reduced.names])
        own = np.array(list(reduced.model.values.values()))
        if column >= len(equations.names) or equations.names[column] not in reduced.names:
            continue
        number = reduced.names.index(equations.names[column])
        if number not in [c for c, _ in _slopes(reduced, here, own)[1]]:
            guilty.append(effect.name)
    who = " and ".join(guilty) or f"the equations of {model.name}"
    name, unit = equations.names[column], format_unit(equations.units[column])
    return (
        f"{who} cannot be linearised at {name} = {z[column]:.6g} {unit} (slopes differ by side): used instead is the side"
        f" {'above' if side > 0 else 'below'} it"
    )
