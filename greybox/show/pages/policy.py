"""How much pages show, and from where on they say otherwise."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ReportPolicy:
    """Limits of the pages that `greybox.report` writes."""

    good_misfit: float = 1.2
    """Up to so many times the noise a fit is said to explain its records: noise is known to about a tenth."""

    leading_findings: int = 3
    """Findings of a fit that stand with its verdict."""

    open_records: int = 1
    """Records whose figures stand open at first; those of the others open on request."""

    records_of_fit: int = 20
    """Records of a fit whose curves are drawn; the tables have all."""

    records_of_check: int = 10
    """The same of a check."""

    records_of_discovery: int = 8
    """The same of a discovery, on its validation records."""

    records_of_comparison: int = 8
    """The same of a comparison."""

    listing: int = 60_000
    """Letters of a file that an export's page shows."""

    largest_page: int = 6_000_000
    """Bytes of a page: what an e-mail still carries."""

    compression: int = 1
    """Of Plotly's script: higher levels save 200 kB and cost a quarter of a second on every page."""

    digits: int = 6
    """Significant digits of a number in a figure."""


REPORT = ReportPolicy()
