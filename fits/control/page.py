"""Writes the page on the controller studies: `python -m fits.control.page [--output docs/studies]`, tables and a figure for each rig."""

from __future__ import annotations

from pathlib import Path

from fits.control import micro_actuator, pneumatic
from fits.control.study import BLACK, COMPENSATED, FAMILY, GENTLER, PLAIN, Study
from fits.control.tables import ORDER, print_tables, rows_of
from fits.papers.paper_page import MODELS, docs_folder, legend, markdown, picture, save

PAGE = "control.md"
COLOURS = dict(zip(ORDER, MODELS, strict=True))
TITLE = f"""# What the constants are for: controllers

A controller that knows the friction which `greybox discover` has named settles twice as fast on the actuator, and stops the hunting of
the cylinder.

Two records of a rig with dry friction give a fit of the plain model, one with the named effect, and the best black box. One rule makes a
controller of each from the position alone (`fits/control/design.py`: linear-quadratic with an integral, and a Kalman observer). The
compensated one adds a force against the friction, in the direction of the wanted motion, and an observer that sticks where the body
sticks. Each runs on the rig (`fits/studies/rig_twins.py`; **generated, not measured**) and on {FAMILY} rigs drawn from what the records
leave open (`export.sample_family`). A dash: it never stays within the band, or there is no margin. Margins and the least distance of the
Nyquist curve from -1 are those of the linear loop on the linear rig. Written by `python -m fits.control.page`, which asserts the verdicts.
"""

GENTLER_WORDS = (
    f"With the voltage counted {' and '.join(f'{f:g}' for f in GENTLER)} times in the LQ weights the compensated design is the first to"
    " settle, too."
)


def section(title: str, name: str, words: str, results: Study, folder: Path) -> str:
    """One rig's part of the page; its figure is written beside it."""
    draw(results, folder, name)
    moves, (unit, size) = results.setting.moves, results.setting.shown
    targets = ", ".join(f"{t / size:g}" for t in moves.targets)
    return "\n\n".join(
        [
            f"## {title}",
            words,
            f"What `discover` says: {results.discovery.story}",
            f"Targets {targets} {unit}, {moves.hold:g} s each and {moves.rise:g} s on the way;"
            f" within {moves.band / size:g} {unit} is there.",
            markdown(["", *ORDER], rows_of(results)),
            GENTLER_WORDS,
            f"![{title}: positions and errors of each design](figures/{name}.png)",
        ]
    )


def draw(results: Study, folder: Path, name: str) -> None:
    """Positions, errors about the target, and the errors of the compensated design and its rival over the family."""
    unit, size = results.setting.shown
    figure, (above, middle, below) = picture(3, height=2.6)
    run = results.runs[BLACK]
    above.plot(run.time, run.target / size, color="black", lw=0.8, ls=":", label="target")
    for design in ORDER:
        run = results.runs[design]
        above.plot(run.time, run.position / size, color=COLOURS[design], lw=1.1, label=design)
        middle.plot(run.time, (run.position - run.target) / size, color=COLOURS[design], lw=1.1)
    for design in (PLAIN, COMPENSATED):
        error = (results.spread[design].positions - run.target) / size
        below.fill_between(
            run.time, error.min(axis=0), error.max(axis=0), color=COLOURS[design], alpha=0.4, lw=0, label=design
        )
    band = results.setting.moves.band / size
    for axis in (middle, below):
        axis.axhspan(-band, band, color="black", alpha=0.08, lw=0)
        axis.set_ylim(-6 * band, 6 * band)
    legend(above, "", f"position [{unit}]", "on the rig", columns=2)
    legend(middle, "", f"error [{unit}]", "what is missing to the target; grey: within it is there")
    legend(below, "time [s]", f"error [{unit}]", f"the same on {FAMILY} rigs that the records leave open", columns=2)
    save(figure, folder, name)


def main() -> None:
    """Both studies, their verdicts, and the page."""
    folder, parts = docs_folder("control.page"), []
    for title, module in (("Micro-motion actuator", micro_actuator), ("Pneumatic cylinder", pneumatic)):
        results = module.study(module.SETTING)
        print_tables(results)
        module.verdict(results)
        parts.append(section(title, f"control_{module.__name__.rpartition('.')[2]}", module.WORDS, results, folder))
    (folder / PAGE).write_text("\n\n".join([TITLE.rstrip(), *parts]) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
