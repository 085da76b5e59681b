"""What stands beside the core and is found through entry points: file formats, exports, FMUs, design, changes, the app.

The names here are those that an extension of your own is made of.
"""

from typing import TYPE_CHECKING

from greybox.base.faces import lazy_face

if TYPE_CHECKING:
    from greybox.base.document import Document
    from greybox.base.values import Printable
    from greybox.data.array_table import ArrayInfo, ArrayTable
    from greybox.data.channels import Channel, ChannelTable
    from greybox.data.file_kinds import FileFormat
    from greybox.data.time_base import Samples
    from greybox.extensions.export.target import ExportTarget
    from greybox.shell.plants import PlantKind
    from greybox.shell.study import Answer, Command, Excludes, Idle, Needs, Option, Study
    from greybox.shell.study_values import Choice, Count, File, Names, Number, Numbers, Quantity, Switch, Word
    from greybox.simulation.plant import PlantRunError, as_model

__getattr__, __all__, __dir__ = lazy_face(__name__)
