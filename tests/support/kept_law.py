"""A law in the answer of a discovery, as `effects keep` reads it."""

LAW = {
    "name": "law",
    "site": "force",
    "equation": "-4.1e5*max(0, x - 0.121)",
    "formula": "k*max(0, x - c)",
    "parameters": {"k": {"value": -4.1e5, "unit": "N/m"}, "c": {"value": 0.121, "unit": "m"}},
    "grade": "established",
    "range": {"x": [-0.1, 0.13]},
}
