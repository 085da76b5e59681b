"""Options that go together, what a file holds of them, and what they do to one another: rows of the tables of commands."""

from __future__ import annotations

from typing import Any

from greybox.shell.study import Excludes, Idle, Needs, Option, Relation, Study

# How records are read.
READING = (
    *(Study.columns, Study.headers, Study.sampling_time, Study.read_limit, Study.first_time, Study.last_time),
    *(Study.hold, Study.interpolation, Study.before, Study.split_holes, Study.free_decay),
)
# The same where a result or the model says how the inputs move and what stayed the same.
READING_LIKE = (
    *(Study.columns, Study.headers, Study.read_limit, Study.first_time, Study.last_time),
    *(Study.interpolation, Study.before),
)
# What such a command is told of how records are split, and of those that nothing drives.
SPLITTING = (Study.split_holes, Study.free_decay)
# What every command takes that looks at a model with records.
ESTIMATING = (
    *(Study.model, Study.estimation, Study.fixed, Study.start, Study.free, Study.conditions, Study.noise),
    *(Study.at_rest, *(option for option in READING if option is not Study.free_decay)),
)
# What a fit takes.
INTEGRATING = (Study.effects, Study.ties, Study.free_decay, Study.settled, Study.method, Study.substeps)
FITTING = (
    *(*ESTIMATING, *INTEGRATING, Study.priors, Study.per_experiment, Study.schedules, Study.process_noise),
    *(Study.common_noise, Study.quiet, Study.validation, Study.skip, Study.beginning, Study.loss),
    *(Study.transcription, Study.arc_length, Study.starts, Study.seed, Study.predict),
)
# What a file holds that is an argument of the command that follows: a model, the result of a fit or a search ...
IN_MODEL = (
    *(Study.fixed, Study.start, Study.free, Study.priors, Study.ties, Study.effects, Study.schedules),
    *(Study.process_noise, Study.has, Study.lacks),
)
IN_RESULT = (*IN_MODEL, *(option for option in FITTING if option not in (*READING, Study.model)))
# ... and a record that was written: how its inputs move between its rows it does not say.
IN_RECORD = (Study.start, Study.noise, Study.seed, *(o for o in READING if o not in (Study.hold, Study.interpolation)))
SHOWING = (Study.json, Study.details, Study.no_report)
SHARING = (Study.workers, Study.cluster)

LAYOUT = Excludes(Study.headers, Study.columns, "names for all columns, or headers for some")
ROWS = "it leaves out rows of validation records"
VALIDATING = tuple(Needs(option, (Study.validation,), ROWS) for option in (Study.beginning, Study.skip))
SUBSTEPS = Idle((Study.substeps,), "with --method exact, which has no substeps", lambda s: s.method == "exact")
STARTING = (
    Needs(Study.seed, (Study.starts,), "there are no random starts"),
    Needs(Study.time_limit, (Study.starts,), "there is one start"),
)
QUIET = Excludes(Study.silent, Study.json, "nothing is printed, or the result as JSON")
# What the options of a fit do to one another.
FITTING_RULES: tuple[Relation, ...] = (QUIET, LAYOUT, SUBSTEPS, *VALIDATING, *STARTING)


def model_of(result: str) -> Option[str]:
    """The model that a ``result`` does not find by itself."""
    text = f"The model of {result}, or its file, if it is not found by its name."
    return Study.model.but(usage="--model MODEL", help=text, required=False)


def sharing(*options: Option[Any], why: str = "there is one computation") -> tuple[Needs, ...]:
    """Workers share the work of ``options`` alone."""
    return tuple(Needs(option, options, why) for option in (Study.cluster, Study.workers))
