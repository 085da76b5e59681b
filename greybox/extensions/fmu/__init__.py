"""Plants that come as an FMU: read, simulated beside a record, fitted, and searched for missing effects like a model."""

from typing import TYPE_CHECKING

from greybox.base.faces import lazy_face

if TYPE_CHECKING:
    from greybox.extensions.fmu.description import FmuVariable
    from greybox.extensions.fmu.effects import (
        FmuDiscovery,
        FmuWithEffects,
        PreparedFmu,
        compare_fmu,
        discover_fmu,
        fit_fmu_effects,
        prepare_fmu,
    )
    from greybox.extensions.fmu.plant import FmuPlant, read_fmu
    from greybox.extensions.fmu.simulator import FmuRunError, FmuSimulator

__getattr__, __all__ = lazy_face(__name__)
