"""The decision numbers of a discovery that somebody turns; every other one is a constant above the function that it steers.

`DiscoveryPolicy` groups the policies of the stages. It is an argument of `discover`, is stored in the result and written to
``discovery.json``. Costs are sums of squared whitened residuals, so that a difference in cost is a likelihood ratio.
"""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class SelectionPolicy:
    """When something is missing, when an effect is accepted, and when it may be named.

    Parameters
    ----------
    criterion_gain
        An effect must lower Schwarz's criterion by more than this. Twenty is odds of about 20000 to 1, which leaves room for noise
        whose level is not known exactly.
    holdout_share
        Share of the gap on validation records that a model must explain before its effect is named.
    """

    criterion_gain: float = 20.0
    holdout_share: float = 0.9


@dataclass(frozen=True)
class DiscoveryPolicy:
    """The decision numbers of all stages of a discovery.

    Parameters
    ----------
    selection
        When an effect is accepted and named.

    Examples
    --------
    >>> from dataclasses import replace
    >>> policy = replace(DiscoveryPolicy(), selection=SelectionPolicy(criterion_gain=40.0))
    >>> policy.selection.criterion_gain
    40.0
    """

    selection: SelectionPolicy = field(default_factory=SelectionPolicy)
