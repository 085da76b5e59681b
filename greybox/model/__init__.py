"""The model language: named balances of named terms, effects as values, models as values."""

from typing import TYPE_CHECKING

from greybox.base.faces import lazy_face

if TYPE_CHECKING:
    from greybox.model.balance import Balance, Block
    from greybox.model.characteristic import Characteristic
    from greybox.model.effect import DryFriction, Effect
    from greybox.model.equations import equations_text
    from greybox.model.expressions.printer import docstring, literal
    from greybox.model.model import Model
    from greybox.model.signals import Input, Output, Parameter, State
    from greybox.model.system import System
    from greybox.model.validation import Rule

__getattr__, __all__, __dir__ = lazy_face(__name__)
