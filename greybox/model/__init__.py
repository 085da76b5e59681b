"""The model language: named balances of named terms, effects as values, models as values."""

from greybox.model.balance import Balance
from greybox.model.characteristic import Characteristic
from greybox.model.effect import DryFriction, Effect
from greybox.model.model import Model
from greybox.model.system import System
from greybox.model.validation import Rule

__all__ = ["Balance", "Characteristic", "DryFriction", "Effect", "Model", "Rule", "System"]
