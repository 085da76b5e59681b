"""Dry friction that sticks: the step is split where a velocity crosses zero or a held body leaves.

While it slides, friction is ``-level * direction`` with a direction that does not change; where the velocity reaches zero the
step ends there, and the body either stays (the applied force is at most the static level) or leaves in the direction of the
applied force; a body at rest leaves at the moment at which that force passes the static level. No smoothing width, no creep
at standstill; the times of stopping and leaving are smooth functions of the parameters, so the step can be differentiated.

Several bodies with friction split the step at the event that comes first, and what is left of it at the next one: as many events a
substep as there are bodies. A body that crosses zero after the last of them stops.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import reduce

import casadi as ca

from greybox.base import TINY
from greybox.model import System
from greybox.simulation.integrators.step import AdvanceFunction, IntegrationMethod


@dataclass(frozen=True)
class _Body:
    """A velocity with dry friction: its place among the states, and at standstill its acceleration without friction and what holds it."""

    state: int
    free: ca.Function
    static: ca.Function

    def compute_excess(self, x: ca.SX, u: ca.SX, p: ca.SX, push_direction: ca.SX) -> ca.SX:
        """At standstill: by how much the push in one direction exceeds the static level."""
        return push_direction * self.free(x, u, p) - self.static(x, u, p)


@dataclass(frozen=True)
class _Motion:
    """How a body moves during one piece of the step."""

    direction: ca.SX
    is_stuck: ca.SX


@dataclass(frozen=True)
class _Event:
    """What ends a piece for one body: after which share of it, and whether by a stop, or by leaving in which direction."""

    share: ca.SX
    has_crossed: ca.SX
    leaves: ca.SX
    leaving_direction: ca.SX


def split_at_standstill(system: System, one_step: IntegrationMethod) -> AdvanceFunction:
    """``advance(x, ua, ub, p, h)`` for a system with dry friction, from the smooth one-step method ``one_step(rate)``."""
    bodies = [_make_body(system, j) for j in sorted({d.state for d in system.dry})]
    slide = _make_sliding_rate(system, bodies)

    def step_piece(x: ca.SX, ua: ca.SX, ub: ca.SX, p: ca.SX, h: ca.SX, motions: list[_Motion]) -> ca.SX:
        """One smooth piece: each body slides in a given direction, or stands still."""
        directions = ca.vertcat(*[ca.if_else(m.is_stuck, 0, m.direction) for m in motions])

        def rate(x: ca.SX, u: ca.SX, p: ca.SX) -> ca.SX:
            rates = slide(x, u, p, directions)
            for body, motion in zip(bodies, motions, strict=True):
                # dv/dt = 0 exactly: a held body does not creep, however its forces round.
                rates[body.state] = ca.if_else(motion.is_stuck, 0, rates[body.state])
            return rates

        return one_step(rate)(x, ua, ub, p, h)

    def start_motion(body: _Body, x: ca.SX, ua: ca.SX, p: ca.SX, before: _Event | None) -> _Motion:
        v, push_direction = x[body.state], ca.sign(body.free(x, ua, p))
        if before is None:
            # Coulomb's law at v = 0: held as long as |free acceleration| <= static level. The comparison with zero
            # is exact because a stop sets the velocity to zero, not near it.
            is_stuck = ca.logic_and(v == 0, body.compute_excess(x, ua, p, push_direction) <= 0)
        else:  # at the moment of leaving the push is the static level but for rounding
            push_direction = ca.if_else(before.leaves, before.leaving_direction, push_direction)
            is_held = ca.logic_and(v == 0, body.compute_excess(x, ua, p, push_direction) <= 0)
            is_stuck = ca.logic_and(ca.logic_not(before.leaves), is_held)
        # A body at rest will go where it is pushed; friction points against that before it has a velocity.
        return _Motion(ca.if_else(v == 0, push_direction, ca.sign(v)), is_stuck)

    def find_event(
        body: _Body, motion: _Motion, x: ca.SX, end: ca.SX, ua: ca.SX, ub: ca.SX, p: ca.SX, h: ca.SX, first: ca.SX
    ) -> _Event:
        """``first`` is the body's acceleration at the start of the piece."""
        v, way = x[body.state], motion.direction
        # The smooth piece ran beyond the stop: its velocity at the end has the other sign, or is zero.
        has_crossed = ca.logic_and(ca.logic_not(motion.is_stuck), ca.logic_and(v != 0, way * end[body.state] <= 0))
        leaving_direction = ca.sign(body.free(end, ub, p))
        early_excess, late_excess = (
            body.compute_excess(x, ua, p, leaving_direction),
            body.compute_excess(end, ub, p, leaving_direction),
        )
        # A push that exceeds the static level within the step and falls below it again before the end is missed:
        # substeps are short against the input's course.
        leaves = ca.logic_and(motion.is_stuck, late_excess > 0)
        stop_share = _crossing_share(v, h * first, end[body.state], way)
        # The push is taken to grow in a straight line, which leaves an error of order h^2 in the time of leaving.
        leave_share = ca.fmin(ca.fmax(-early_excess / ca.fmax(late_excess - early_excess, TINY), 0), 1)
        share = ca.if_else(has_crossed, stop_share, ca.if_else(leaves, leave_share, 1))
        return _Event(share, has_crossed, leaves, leaving_direction)

    def advance_rest(
        x: ca.SX, ua: ca.SX, ub: ca.SX, p: ca.SX, h: ca.SX, before: list[_Event | None], events_left: int
    ) -> ca.SX:
        """What is left of a step, split at ``events_left`` events at most; ``before`` is what each body did where it begins."""
        motions = [start_motion(body, x, ua, p, event) for body, event in zip(bodies, before, strict=True)]
        # A small velocity of a held body is stopped at once: v = 0 whatever it is varied by, hence dv/dp = 0 as well.
        x = ca.SX(x)
        for body, motion in zip(bodies, motions, strict=True):
            x[body.state] = ca.if_else(motion.is_stuck, 0, x[body.state])
        end = step_piece(x, ua, ub, p, h, motions)
        # No event is left for a body that crosses zero now: its velocity is cut off at zero, and it is held from the
        # next substep on.
        if events_left == 0:
            for body, motion in zip(bodies, motions, strict=True):
                end[body.state] = motion.direction * ca.fmax(motion.direction * end[body.state], 0)
            return end
        first = slide(x, ua, p, ca.vertcat(*[m.direction for m in motions]))
        pairs = list(zip(bodies, motions, strict=True))
        events = [find_event(body, m, x, end, ua, ub, p, h, first[body.state]) for body, m in pairs]
        # The first event of all bodies ends the piece for all: forces between them jump there.
        share = reduce(ca.fmin, [event.share for event in events])
        u_at_event = ua + share * (ub - ua)
        # Integrated anew up to the event, not interpolated: the method keeps its order on both pieces.
        cut = step_piece(x, ua, u_at_event, p, share * h, motions)
        due: list[_Event | None] = []
        for (body, motion), event in zip(pairs, events, strict=True):
            is_due = event.share <= share
            # The others go on; one of them that has crossed by then, the parabola being only near, stops as well.
            moving = motion.direction * ca.fmax(motion.direction * cut[body.state], 0)
            cut[body.state] = ca.if_else(is_due, 0, moving)
            due.append(replace(event, leaves=ca.logic_and(event.leaves, is_due)))
        rest = advance_rest(cut, u_at_event, ub, p, (1 - share) * h, due, events_left - 1)
        any_event = reduce(ca.logic_or, [ca.logic_or(event.has_crossed, event.leaves) for event in events])
        # Both branches are evaluated by the kernel; without an event the whole piece keeps the bits of the smooth
        # method.
        return ca.if_else(any_event, rest, end)

    def advance(x: ca.SX, ua: ca.SX, ub: ca.SX, p: ca.SX, h: ca.SX) -> ca.SX:
        return advance_rest(x, ua, ub, p, h, [None] * len(bodies), len(bodies))

    return advance


def _make_sliding_rate(system: System, bodies: list[_Body]) -> ca.Function:
    """``(x, u, p, directions) -> rates``, one direction a body; a body without friction for now has 0."""
    directions = ca.SX.sym("directions", len(bodies))
    numbers = {body.state: k for k, body in enumerate(bodies)}
    per_term = ca.vertcat(*[directions[numbers[d.state]] for d in system.dry])
    rhs = ca.substitute(system.rhs, system.direction, per_term)
    return ca.Function("slide", [system.x, system.u, system.p, directions], [rhs])


def _make_body(system: System, j: int) -> _Body:
    arguments = [system.x, system.u, system.p]
    # Acceleration with every direction of friction at zero: what pushes the body while nothing holds it.
    free = ca.substitute(system.rhs[j], system.direction, ca.SX.zeros(len(system.dry)))
    levels = [d.static for d in system.dry if d.state == j]
    # Levels are forces, the excess compares accelerations: F_s / m. A level that falls with the velocity (Stribeck)
    # counts at v = 0.
    static = ca.substitute(sum(levels, ca.SX(0)) / system.storages[j], system.x[j], 0)
    return _Body(j, ca.Function("free", arguments, [free]), ca.Function("static", arguments, [static]))


def _crossing_share(v: ca.SX, first: ca.SX, last: ca.SX, direction: ca.SX) -> ca.SX:
    """Share of the step after which the velocity is zero: root of the parabola through ``v``, its slope ``first`` and ``last``."""
    # |v|(s) = c0 + c1 s + c2 s^2 over the share s of the step, from both ends and the slope at the first.
    c0, c1 = ca.fabs(v), direction * first
    c2 = direction * last - c0 - c1
    # No real root means that the parabola only touches zero; TINY keeps the slope of the root finite there.
    root = ca.sqrt(ca.fmax(c1 * c1 - 4 * c2 * c0, TINY))
    # s = 2 c0 / (-c1 + sqrt(c1^2 - 4 c2 c0)): the form without cancellation, which also holds for c2 = 0.
    return ca.fmin(ca.fmax(2 * c0 / ca.fmax(root - c1, TINY), 0), 1)
