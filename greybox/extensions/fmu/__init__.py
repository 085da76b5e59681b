"""Plants that come as an FMU: read and simulated beside a record; every verb takes them as plants."""

from typing import TYPE_CHECKING

from greybox.base.faces import lazy_face

if TYPE_CHECKING:
    from greybox.extensions.fmu.description import FmuVariable
    from greybox.extensions.fmu.plant import FmuPlant, read_fmu
    from greybox.extensions.fmu.simulator import FmuRunError, FmuSimulator

__getattr__, __all__, __dir__ = lazy_face(__name__)
