"""The best curve or tone for what a fitted model lacks, of a search that tries no effect."""

import numpy as np

from greybox.discovery.answer import make_answer
from greybox.discovery.candidates import estimate_scales
from greybox.discovery.holdout import HoldoutScores, ValidationSet
from greybox.discovery.policy import DiscoveryPolicy
from greybox.discovery.problem import DiscoveryProblem
from greybox.discovery.search import EffectSearch
from greybox.discovery.surrogate import Surrogate, fit_stand_in
from greybox.discovery.table import FitTable


def find_stand_in(problem: DiscoveryProblem, test) -> Surrogate | None:
    """That of the plain model, judged on the record ``test``."""
    table, scales = FitTable(HoldoutScores(problem, ValidationSet((test,)))), estimate_scales(problem.baseline)
    search = EffectSearch(problem, table, (), scales, DiscoveryPolicy(), lambda _: None)
    with np.errstate(over="ignore"):  # as in a search: a curve may lead a run astray
        return fit_stand_in(make_answer(search, search.baseline))
