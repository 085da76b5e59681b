"""The catalogue: physical effects that a model may lack, as values.

``model + effect("coulomb_friction")`` is a new model. The effects are grouped by domain, one file each. They speak in
roles (``x.velocity``, ``p.resistance``) and sites (``force``, ``input``, ``valve``, ``sensor``), so one entry serves every
model that has them. Amplitudes are zero in the catalogue (or at their neutral value): an effect just added changes nothing
until a fit, or ``model.start(Fc=1.5)``, says otherwise. The exceptions have no amplitude: ``choked_flow`` replaces the linear
law, ``linear_input`` and ``band_limited_input`` say how the input moves between samples.
"""

from typing import TYPE_CHECKING

from greybox.base.faces import lazy_face

if TYPE_CHECKING:
    from greybox.model.effect import formula_effect
    from greybox.model.effects.catalogue import (
        CATALOGUE,
        EffectListing,
        Placement,
        all_effects,
        applicable_effects,
        effect,
        find_placements,
        place_effect,
    )
    from greybox.model.effects.elasticity import CONTACT, ELASTICITY
    from greybox.model.effects.electrical import ELECTRICAL
    from greybox.model.effects.flow import FLOW, LEVEL
    from greybox.model.effects.friction import DAMPING, FRICTION
    from greybox.model.effects.roles import ROLES, SignalRole
    from greybox.model.effects.rotation import LOAD, ROTATION
    from greybox.model.effects.scales import Scales, bound_delays, measure_scales, tailor_to_record
    from greybox.model.effects.signal_path import BETWEEN_SAMPLES, SIGNAL_PATH
    from greybox.model.effects.thermal import HEAT_SOURCES, THERMAL

__getattr__, __all__, __dir__ = lazy_face(__name__)
