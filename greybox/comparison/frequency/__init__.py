"""Frequency responses as records: read, estimated from periodic records, and fitted, alone or with records over time."""

from typing import TYPE_CHECKING

from greybox.base.faces import lazy_face

if TYPE_CHECKING:
    from greybox.comparison.frequency.best_linear_approximation import (
        BestLinearApproximation,
        estimate_best_linear_approximation,
        find_rows_of_period,
    )
    from greybox.comparison.frequency.fit_response import ResponsePlant, fit_frequency_response
    from greybox.comparison.frequency.response import FrequencyResponse, read_frequency_response

__getattr__, __all__, __dir__ = lazy_face(__name__)
