"""Plants whose optimal experiments are known."""

from greybox.model.balance import Balance
from greybox.model.model import Model
from greybox.model.signals import Input, Output, Parameter, State


def first_order(gain=2.0, lag=0.5):
    """``lag y' = gain u - y``."""
    return Model(
        "first_order",
        [State("y", "1")],
        [Input("u", "1")],
        [Output("y", "1")],
        [Parameter("gain", "1", gain, (1e-3, 1e3)), Parameter("lag", "s", lag, (1e-3, 1e3))],
        lambda x, u, p: [Balance("lag", "1", p.lag, "y", drive=p.gain * u.u, decay=-x.y)],
    )


def box_lucas(first=0.7, second=0.2):
    """Two reactions in a row, ``A -> B -> C`` (Box and Lucas 1959): what is measured is B; ``u`` does nothing."""
    return Model(
        "box_lucas",
        [State("A", "1", 1.0), State("B", "1")],
        [Input("u", "1")],
        [Output("B", "1")],
        [Parameter("k1", "1/s", first, (1e-3, 1e3)), Parameter("k2", "1/s", second, (1e-3, 1e3))],
        lambda x, u, p: [
            Balance("first", "1/s", 1, "A", reacting=-p.k1 * x.A, feed=0 * p.k1 * u.u),
            Balance("second", "1/s", 1, "B", formed=p.k1 * x.A, reacting=-p.k2 * x.B),
        ],
    )


def rooney_biegler(asymptote=15.0, rate=0.5):
    """``y = asymptote (1 - exp(-rate t))`` (Rooney and Biegler 2001); ``u`` does nothing."""
    return Model(
        "rooney_biegler",
        [State("y", "1")],
        [Input("u", "1")],
        [Output("y", "1")],
        [Parameter("asymptote", "1", asymptote, (1e-3, 1e3)), Parameter("rate", "1/s", rate, (1e-3, 1e3))],
        lambda x, u, p: [Balance("growth", "1/s", 1, "y", growing=p.rate * (p.asymptote - x.y), feed=0 * p.rate * u.u)],
    )
