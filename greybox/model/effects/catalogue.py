"""The catalogue: physical effects that a model may lack, as values.

``model + effect("coulomb_friction")`` is a new model. The effects are grouped by domain, one file each. They speak in
roles (``x.velocity``, ``p.resistance``) and sites (``force``, ``input``, ``valve``, ``sensor``), so one entry serves every
model that has them. Amplitudes are zero in the catalogue (or at their neutral value): an effect just added changes nothing
until a fit, or ``model.start(Fc=1.5)``, says otherwise. The exceptions have no amplitude: ``choked_flow`` replaces the linear
law, ``linear_input`` and ``band_limited_input`` say how the input moves between samples, ``reversed_input`` and
``reversed_reading`` that a wire is the wrong way round, ``late_row`` and ``early_row`` when an input acted.
"""

from __future__ import annotations

from functools import cache

from greybox.base import ModelError, nearest
from greybox.base.extensions import ExtensionKind, load_extensions, reserve
from greybox.model.effect import Effect
from greybox.model.effects import elasticity, electrical, flow, friction, placement, rotation, signal_path
from greybox.model.effects.scales import Scales, tailor_to_record
from greybox.model.model import Model

# Every effect that comes with the library, one value each, grouped by domain. Look one up with `effect`.
CATALOGUE: tuple[Effect, ...] = (
    *friction.FRICTION,
    *friction.DAMPING,
    *elasticity.ELASTICITY,
    *elasticity.CONTACT,
    *electrical.ELECTRICAL,
    *flow.FLOW,
    *flow.LEVEL,
    *rotation.LOAD,
    *rotation.ROTATION,
    *electrical.THERMAL,
    *signal_path.SIGNAL_PATH,
    *signal_path.BETWEEN_SAMPLES,
)
reserve(ExtensionKind.EFFECTS, (entry.name for entry in CATALOGUE))


@cache
def all_effects() -> tuple[Effect, ...]:
    """The shipped effects, and those of extensions after them."""
    further = load_extensions(ExtensionKind.EFFECTS).values()
    return (*CATALOGUE, *(e for value in further for e in ((value,) if isinstance(value, Effect) else value)))


def effect(name: str) -> Effect:
    """An effect of the catalogue.

    Parameters
    ----------
    name
        Its name, as ``docs/catalogue.md`` lists it; with ``_at_`` and the name of a site for that one.

    Returns
    -------
    Effect
        The effect, absent until its amplitude is fitted or set.

    Raises
    ------
    ModelError
        For an unknown name; the message lists the nearest ones.

    Examples
    --------
    >>> effect("coulomb_friction").equation
    '-Fc sign(v)'
    """
    entries = {entry.name: entry for entry in all_effects()}
    base, at, site = name.partition(placement.AT)
    if name not in entries and at and base in entries:
        return placement.place_effect(entries[base], site)
    if name not in entries:
        raise ModelError(f"the catalogue has no effect {name!r}; {nearest(name, list(entries))}")
    return entries[name]


def applicable_effects(model: Model, scales: Scales | None = None) -> list[Effect]:
    """The effects of the catalogue that a model may hide.

    An effect fits if the model has a site for it, every role that its equation and units speak of and every term that it replaces, and
    does not contain it already. A model without the balance of a velocity takes no friction, one without a displacement no spring. Where a
    model has several sites (bodies, inputs, outputs), each takes an effect of its own: ``coulomb_friction`` at the first,
    ``coulomb_friction_at_load`` at another.

    Parameters
    ----------
    model
        A model; its ``candidates`` name the effects to consider, none named means all at every site.
    scales
        Those of a record: each effect is then made ready for it with `tailor_to_record`.

    Returns
    -------
    list of Effect
        In the order of the catalogue.

    Raises
    ------
    ModelError
        For an unknown name among the candidates.
    UnitError
        If an effect fits but its term has not the unit of its balance: a mistake in the catalogue.
    """
    wanted = {effect(name).name for name in model.candidates}
    # A model says what the plant may lack; what a record has wrong is no part of the plant.
    if wanted:
        wanted |= {p.name for p in placement.find_placements(model, signal_path.MISREAD)}
    entries = tuple(
        e for e in all_effects() if not wanted or any(name.partition(placement.AT)[0] == e.name for name in wanted)
    )
    placed = [p.effect for p in placement.find_placements(model, entries) if p.effect is not None]
    fitting = [entry for entry in placed if not wanted or entry.name in wanted]
    names = {entry.name for entry in (*fitting, *model.effects)}
    fitting = [e for e in fitting if e.name in wanted or not (e.stands_for and names.issuperset(e.stands_for))]
    return [tailor_to_record(entry, scales) for entry in fitting] if scales else fitting
