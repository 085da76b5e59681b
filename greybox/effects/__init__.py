"""The catalogue: physical effects that a model may lack, as values.

``model + effect("coulomb_friction")`` is a new model. The effects are grouped by domain, one file each. They speak in
roles (``x.velocity``, ``x.displacement``) and sites (``force``, ``input``, ``sensor``), so one entry serves every model
that has them. Amplitudes are zero in the catalogue: an effect just added changes nothing until a fit, or
``model.start(Fc=1.5)``, says otherwise.
"""

from __future__ import annotations

from greybox.effects.elasticity import ELASTICITY
from greybox.effects.friction import FRICTION
from greybox.effects.load import LOAD
from greybox.effects.signal_path import SIGNAL_PATH
from greybox.errors import ModelError, UnitError, nearest
from greybox.model import Effect, Model

CATALOGUE: tuple[Effect, ...] = (*FRICTION, *ELASTICITY, *LOAD, *SIGNAL_PATH)

__all__ = ["CATALOGUE", "applicable", "effect"]


def effect(name: str) -> Effect:
    """The effect of the catalogue with this name, as in ``model + effect("coulomb_friction")``.

    Raises ModelError for an unknown name, listing the nearest ones.
    """
    for entry in CATALOGUE:
        if entry.name == name:
            return entry
    raise ModelError(f"the catalogue has no effect {name!r}; {nearest(name, [entry.name for entry in CATALOGUE])}")


def applicable(model: Model) -> list[Effect]:
    """The effects of the catalogue that ``model`` has a place for, in catalogue order.

    An effect applies if the model has its site and every role that its equation and units speak of, and does not
    contain it already. A model without a balance ``force`` takes no friction, one without a ``displacement`` no spring.

    Raises UnitError if an effect fits but its term has not the unit of its balance: a mistake in the catalogue.
    """
    return [entry for entry in CATALOGUE if _fits(model, entry)]


def _fits(model: Model, entry: Effect) -> bool:
    try:
        # Writing the equations out asks for every site, role and unit, so the model itself answers.
        (model + entry).system  # noqa: B018
    except UnitError:
        raise
    except ModelError:
        return False
    return True
