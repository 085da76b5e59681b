"""The catalogue: physical effects that a model may lack, as values.

``model + effect("coulomb_friction")`` is a new model. The effects are grouped by domain, one file each. They speak in
roles (``x.velocity``, ``p.resistance``) and sites (``force``, ``input``, ``valve``, ``sensor``), so one entry serves every
model that has them. Amplitudes are zero in the catalogue (or at their neutral value): an effect just added changes nothing
until a fit, or ``model.start(Fc=1.5)``, says otherwise. The exceptions have no amplitude: ``choked_flow`` replaces the linear
law, ``linear_input`` and ``band_limited_input`` say how the input moves between samples.
"""

from __future__ import annotations

from greybox.effects.damping import DAMPING
from greybox.effects.elasticity import ELASTICITY
from greybox.effects.electrical import ELECTRICAL
from greybox.effects.flow import FLOW
from greybox.effects.friction import FRICTION
from greybox.effects.intersample import BETWEEN_SAMPLES
from greybox.effects.level import LEVEL
from greybox.effects.load import LOAD
from greybox.effects.scales import Scales, measure_scales, tailor_to_record
from greybox.effects.signal_path import SIGNAL_PATH
from greybox.errors import ModelError, UnitError, nearest
from greybox.model import Effect, Model

CATALOGUE: tuple[Effect, ...] = (
    *FRICTION,
    *DAMPING,
    *ELASTICITY,
    *ELECTRICAL,
    *FLOW,
    *LEVEL,
    *LOAD,
    *SIGNAL_PATH,
    *BETWEEN_SAMPLES,
)
"""Every effect that comes with the library, one value each, grouped by domain. Look one up with `effect`."""

__all__ = [
    "BETWEEN_SAMPLES",
    "CATALOGUE",
    "DAMPING",
    "ELASTICITY",
    "ELECTRICAL",
    "FLOW",
    "FRICTION",
    "LEVEL",
    "LOAD",
    "SIGNAL_PATH",
    "Scales",
    "applicable_effects",
    "effect",
    "measure_scales",
    "tailor_to_record",
]


def effect(name: str) -> Effect:
    """An effect of the catalogue.

    Parameters
    ----------
    name
        Its name, as ``docs/catalogue.md`` lists it.

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
    for entry in CATALOGUE:
        if entry.name == name:
            return entry
    raise ModelError(f"the catalogue has no effect {name!r}; {nearest(name, [entry.name for entry in CATALOGUE])}")


def applicable_effects(model: Model, scales: Scales | None = None) -> list[Effect]:
    """The effects of the catalogue that a model may hide.

    An effect fits if the model has its site, every role that its equation and units speak of and every term that it replaces, and
    does not contain it already. A model without a balance ``force`` takes no friction, one without a ``displacement`` no spring.

    Parameters
    ----------
    model
        A model; its ``candidates`` name the effects to consider, none named means all.
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
    wanted = [effect(name).name for name in model.candidates] or [entry.name for entry in CATALOGUE]
    fitting = [entry for entry in CATALOGUE if entry.name in wanted and _fits(model, entry)]
    return [tailor_to_record(entry, scales) for entry in fitting] if scales else fitting


def _fits(model: Model, entry: Effect) -> bool:
    try:
        model + entry  # writing the equations out asks for every site, role, term and unit
    except UnitError:
        raise
    except ModelError:
        return False
    return True
