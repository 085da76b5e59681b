"""Derivatives where they differ by side: dry friction at standstill, the edge of a dead zone, a valve that is just shut."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from greybox.export.findings import ExportFinding
from greybox.export.model_functions import ModelFunctions
from greybox.findings import Finding, Severity
from greybox.numerics import SAME_DERIVATIVE, TINY
from greybox.units import format_unit


@dataclass(frozen=True)
class OneSidedDerivatives:
    """Jacobians of the rates (nx, nx + nu) and of the outputs (ny, nx + nu), and what was chosen where there was a choice."""

    rates: np.ndarray
    outputs: np.ndarray
    findings: tuple[Finding, ...]


def differentiate_one_sided(functions: ModelFunctions, z: np.ndarray, p: np.ndarray) -> OneSidedDerivatives:
    """Jacobians at ``z``, of each variable on the side where they are larger; dry friction at standstill without its jump."""
    jacobian, kinks = _differentiate(functions, z, p)
    findings = _describe_friction(functions, z, p)
    findings += [_describe_kink(functions, z, p, column, side) for column, side in kinks]
    return OneSidedDerivatives(jacobian[: functions.nx], jacobian[functions.nx :], tuple(findings))


def _differentiate(functions: ModelFunctions, z: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, list[tuple[int, int]]]:
    """Jacobian (nx + ny, nx + nu), and the variables in which it differs by side with the side (1 or -1) that was taken."""
    sizes, at_rest = functions.sizes(z, p), [k for k in functions.bodies if z[k] == 0]
    direction = functions.direction(z)
    if not at_rest:
        return _differentiate_by_column(functions, z, p, sizes, direction)
    # Friction jumps at standstill: its derivative is the mean of those while sliding either way, from which the jump is left out.
    results = []
    for way in (1, -1):
        sliding = np.where([d.state in at_rest for d in functions.system.dry], way, direction)
        results.append(_differentiate_by_column(functions, z, p, sizes, sliding, dict.fromkeys(at_rest, way)))
    (forward, kinks), (backward, _) = results
    return (forward + backward) / 2, kinks


def _differentiate_by_column(
    functions: ModelFunctions,
    z: np.ndarray,
    p: np.ndarray,
    sizes: np.ndarray,
    direction: np.ndarray,
    decided: dict[int, int] | None = None,
) -> tuple[np.ndarray, list[tuple[int, int]]]:
    """Jacobian column by column; ``decided`` are the sides of variables that leave no choice."""
    switches = functions.switches(direction)
    edges = switches.edges(z, sizes, p)
    jacobian = switches.jacobian(edges, z, np.zeros(len(z)), p)[1]
    if not len(edges):
        return jacobian, []
    jacobian, kinks = jacobian.copy(), []
    weight = 1 / np.maximum(np.abs(jacobian * sizes).sum(axis=1), TINY)
    for column in range(len(z)):
        move = np.zeros(len(z))
        move[column] = sizes[column]
        above, below = (switches.jacobian(edges, z, side * move, p)[1][:, column] for side in (1, -1))
        if decided and column in decided:
            jacobian[:, column] = above if decided[column] > 0 else below
            continue
        differs = np.abs(above - below) > SAME_DERIVATIVE * np.maximum(np.abs(above), np.abs(below))
        larger = 1 if np.linalg.norm(weight * above) >= np.linalg.norm(weight * below) else -1
        jacobian[:, column] = above if larger > 0 else below
        if differs.any():
            kinks.append((column, larger))
    return jacobian, kinks


def _describe_friction(functions: ModelFunctions, z: np.ndarray, p: np.ndarray) -> list[Finding]:
    """What replaces dry friction."""
    findings = []
    for k, (push, static) in functions.holding(z, p).items():
        if static == 0:
            continue
        effects = [d.effect for d in functions.system.dry if d.state == k]
        state = functions.names[k]
        balance = next(b for b in functions.system.balances if b.state == state)
        values = {
            "effects": effects,
            "state": state,
            "level": static,
            "held": abs(push),
            "unit": format_unit(balance.unit),
        }
        findings.append(Finding(ExportFinding.FRICTION_LEFT_OUT, Severity.WARNING, " and ".join(effects), values))
    return findings


def _describe_kink(functions: ModelFunctions, z: np.ndarray, p: np.ndarray, column: int, side: int) -> Finding:
    model = functions.model
    responsible = []
    for effect in model.effects:
        reduced = ModelFunctions(model.without(effect.name))
        reduced_z = np.array([z[functions.names.index(name)] for name in reduced.names])
        reduced_p = np.array(list(reduced.model.values.values()))
        if column >= len(functions.names) or functions.names[column] not in reduced.names:
            continue
        number = reduced.names.index(functions.names[column])
        if number not in [c for c, _ in _differentiate(reduced, reduced_z, reduced_p)[1]]:
            responsible.append(effect.name)
    name = functions.names[column]
    values = {
        "effects": responsible,
        "model": model.name,
        "variable": name,
        "value": float(z[column]),
        "unit": format_unit(functions.units[column]),
        "side": "above" if side > 0 else "below",
    }
    return Finding(ExportFinding.KINK, Severity.WARNING, name, values)
