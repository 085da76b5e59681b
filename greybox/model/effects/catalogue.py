"""The catalogue: physical effects that a model may lack, as values.

``model + effect("coulomb_friction")`` is a new model. The effects are grouped by domain, one file each. They speak in
roles (``x.velocity``, ``p.resistance``) and sites (``force``, ``input``, ``valve``, ``sensor``), so one entry serves every
model that has them. Amplitudes are zero in the catalogue (or at their neutral value): an effect just added changes nothing
until a fit, or ``model.start(Fc=1.5)``, says otherwise. The exceptions have no amplitude: ``choked_flow`` replaces the linear
law, ``linear_input`` and ``band_limited_input`` say how the input moves between samples, ``reversed_input`` and
``reversed_reading`` that a wire is the wrong way round, ``late_row`` and ``early_row`` when an input acted.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

from greybox.base import Printable, nearest
from greybox.base.errors import MissingNameError, ModelError, UnitError
from greybox.base.extensions import ExtensionKind, load_extensions, reserve
from greybox.model.effect import Effect
from greybox.model.effects import elasticity, electrical, flow, friction, rotation, signal_path, thermal
from greybox.model.effects.scales import Scales, tailor_to_record
from greybox.model.model import Model
from greybox.model.signals import Parameter
from greybox.model.sites import FIRST_INPUT, ROLE_OF_WORD, PlaceKind, find_sites

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
    *thermal.THERMAL,
    *signal_path.SIGNAL_PATH,
    *thermal.HEAT_SOURCES,
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
    base, at, site = name.partition(AT)
    if name not in entries and at and base in entries:
        return place_effect(entries[base], site)
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
        wanted |= {p.name for p in find_placements(model, signal_path.MISREAD)}
    entries = tuple(e for e in all_effects() if not wanted or any(name.partition(AT)[0] == e.name for name in wanted))
    placed = [p.effect for p in find_placements(model, entries) if p.effect is not None]
    fitting = [entry for entry in placed if not wanted or entry.name in wanted]
    names = {entry.name for entry in (*fitting, *model.effects)}
    fitting = [e for e in fitting if e.name in wanted or not (e.stands_for and names.issuperset(e.stands_for))]
    return [tailor_to_record(entry, scales) for entry in fitting] if scales else fitting


# Where in a model an effect may act: at its first site under its own name, elsewhere as ``<name>_at_<site>``.


AT = "_at_"


@dataclass(frozen=True)
class Placement:
    """An effect of the catalogue and one place for it, or why there is none.

    Parameters
    ----------
    name
        Of the effect there.
    site
        Balance, input or output; empty where the model has no such site.
    effect
        The effect as it acts there; None where it cannot.
    reason
        Why it cannot.
    missing
        What the model lacks for it, as far as that is a site, a signal or a parameter: its kind and its name or role.
    parameters
        Its parameters with the names and units that they have in the model.
    """

    name: str
    site: str
    effect: Effect | None = None
    reason: str = ""
    parameters: tuple[Parameter, ...] = ()
    missing: tuple[str, str] | None = None


@dataclass(frozen=True)
class _AtSite:
    """A function of scales that sees those of one site; ``scales`` is its last argument."""

    function: Callable[..., Any]
    site: str

    def __call__(self, *arguments: Any) -> Any:
        *others, scales = arguments
        return self.function(*others, scales.at(self.site) if isinstance(scales, Scales) else scales)


@dataclass(frozen=True)
class EffectListing(Printable):
    """Effects and their places in a model, or in any model; ``str`` lists them.

    Parameters
    ----------
    model
        Title of the model; empty for the catalogue alone.
    entries
        The effects.
    placements
        Their places in the model, and why some have none.
    candidates
        Names of those that the model lists for a search; empty where it lists none, and all are tried.
    """

    model: str
    entries: tuple[Effect, ...]
    placements: tuple[Placement, ...] = ()
    candidates: tuple[str, ...] = ()


def place_effect(entry: Effect, site: str) -> Effect:
    """An effect of the catalogue at another site than its first, as ``<name>_at_<site>``.

    Parameters
    ----------
    entry
        The effect.
    site
        Name or label of a balance, an input or an output.

    Returns
    -------
    Effect
        The same with another name and site; its parents act there too.
    """
    return replace(
        _measured_at(entry, site),
        name=f"{entry.name}{AT}{site}",
        site=site,
        parents=tuple(f"{parent}{AT}{site}" for parent in entry.parents),
        approaches=tuple(f"{simpler}{AT}{site}" for simpler in entry.approaches),
        stands_for=tuple(f"{name}{AT}{site}" for name in entry.stands_for),
    )


def find_placements(model: Model, entries: tuple[Effect, ...]) -> list[Placement]:
    """Every place that a model has for these effects, and for each effect without one the reason.

    An effect that changes parameters, terms or states of the plant acts at one place only.

    Parameters
    ----------
    model
        A model; an effect that it contains already has no place.
    entries
        Effects of the catalogue.

    Returns
    -------
    list of Placement
        In the order of the entries, the first site of each first.

    Raises
    ------
    UnitError
        If an effect fits but its term has not the unit of its balance: a mistake in the catalogue.
    """
    return [placement for entry in entries for placement in _placements_of(model, entry)]


def _placements_of(model: Model, entry: Effect) -> list[Placement]:
    places = find_sites(entry.site, model.sites)
    if not places:
        return [_try(model, entry, "")]
    one_place = entry.on_parameter or entry.on_term or entry.on_state or entry.on_storage
    first = entry
    other_input = (
        entry.site != FIRST_INPUT and places[0].kind is PlaceKind.INPUT and places[0].name != model.inputs[0].name
    )
    if other_input or entry.site in ROLE_OF_WORD:
        first = _measured_at(entry, places[0].name)
    placements = [_try(model, first, places[0].name)]
    for place in () if one_place else places[1:]:
        attempt = _try(model, place_effect(entry, place.label), place.name)
        if attempt.effect is not None:
            placements.append(attempt)
    return placements


def _try(model: Model, entry: Effect, site: str) -> Placement:
    if entry.name in {e.name for e in model.effects}:
        return Placement(entry.name, site, None, "the model contains it already")
    try:
        changed = model + entry  # writing the equations out asks for every site, role, term and unit
    except UnitError:
        raise
    except MissingNameError as error:
        return Placement(entry.name, site, None, str(error), missing=(error.kind, error.name))
    except ModelError as error:
        return Placement(entry.name, site, None, str(error))
    return Placement(entry.name, site, entry, "", changed.bound_effects[-1].parameters)


def _measured_at(entry: Effect, site: str) -> Effect:
    hooks = {name: getattr(entry, name) for name in ("probe", "grid", "limits", "from_parent")}
    measured: dict[str, Any] = {name: _AtSite(function, site) for name, function in hooks.items() if function}
    return replace(entry, **measured)
