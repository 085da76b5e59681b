"""Where in a model an effect may act: at its first site under its own name, elsewhere as ``<name>_at_<site>``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from greybox.base import Printable
from greybox.base.errors import MissingNameError, ModelError, UnitError
from greybox.model.effect import Effect
from greybox.model.effects.scales import Scales
from greybox.model.model import Model
from greybox.model.signals import Parameter
from greybox.model.sites import FIRST_INPUT, ROLE_OF_WORD, PlaceKind, find_sites

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
    """

    model: str
    entries: tuple[Effect, ...]
    placements: tuple[Placement, ...] = ()


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
    places = find_sites(entry.site, model.sites, model.inputs)
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
