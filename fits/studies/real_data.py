"""Which effects do the plain models lack on three measured records? The page `real_data.md`, all of it.

Data: the benchmarks' records, not part of this project; give the folder with theirs in it:
``python -m fits.studies.real_data FOLDER`` with ``silverbox``, ``emps`` and ``cascaded_tanks`` below FOLDER.
"""

from __future__ import annotations

import sys

from fits import cascaded_tanks_discovery, emps_discovery, silverbox_discovery
from fits.studies.real_page import arguments, write

STUDIES = {"silverbox": silverbox_discovery, "emps": emps_discovery, "cascaded_tanks": cascaded_tanks_discovery}

if __name__ == "__main__":
    files = [f"{name}/{file}" for name, module in STUDIES.items() for file in module.FILES]
    records, docs = arguments("studies.real_data", *files)
    for number, (name, module) in enumerate(STUDIES.items(), start=1):
        done = module.study(records / name, lambda line: sys.stdout.write(f"{line}\n"))
        write(docs, f"{number} {name.replace('_', ' ')}", module.section(done))
        module.verdict(done)
