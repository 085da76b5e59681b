"""The ground: errors, arithmetic, values, findings, units, files, journals and parallel work. It knows nothing of models.

What most of the library needs is here; whole vocabularies (`greybox.base.document`, `greybox.base.figure`) and rarer names are in their
modules.
"""

from typing import TYPE_CHECKING

from greybox.base.faces import lazy_face

if TYPE_CHECKING:
    from greybox.base.errors import (
        DataError,
        ExitCode,
        FitError,
        GreyboxError,
        MissingNameError,
        ModelError,
        nearest,
        shorten,
    )
    from greybox.base.extensions import ExtensionKind, load_extensions, read_versions
    from greybox.base.files import write_file
    from greybox.base.json_file import StoredResult, read_json, write_json
    from greybox.base.json_shape import FileKind, Finite, Interval, Matrix, format_json, from_json_data, to_json_data
    from greybox.base.linear_algebra import decompose_columns, decompose_symmetric, pseudo_inverse
    from greybox.base.numerics import AT_BOUND, INTEGRATING_POLE, NUMBERS_AT_A_TIME, ROWS_AT_A_TIME, TIME_ROUNDING, TINY
    from greybox.base.texts import to_identifier, to_identifiers, to_line
    from greybox.base.units import convert, format_unit, is_unit, parse_unit, unit_converter
    from greybox.base.values import Check, Finding, Printable, Severity

__getattr__, __all__, __dir__ = lazy_face(__name__)
