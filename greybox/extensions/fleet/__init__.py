"""Fleets: one model fitted to each of many records, as a test bench or machines in the field write them."""

from typing import TYPE_CHECKING

from greybox.base.faces import lazy_face

if TYPE_CHECKING:
    from greybox.extensions.fleet.batch import fit_each
    from greybox.extensions.fleet.records import RecordCollection, RecordReference, find_records
    from greybox.extensions.fleet.result import ConstantDistribution, FleetResult, RecordEstimate, load_fleet

__getattr__, __all__, __dir__ = lazy_face(__name__)
