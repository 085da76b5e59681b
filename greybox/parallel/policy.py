"""When a job, a worker or a cluster is given up."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class RetryPolicy:
    """What happens to a job whose worker dies, and how often jobs are looked at."""

    tries: int = 2
    """A job whose worker died is tried once more, and then alone: only a job that kills its own worker is given up."""
    wake_seconds: float = 0.5
    """Seconds between looks at the jobs, so that Ctrl-C is heard."""
    grace_seconds: float = 2.0
    """Seconds in which a worker that is told to end may do so by itself, before it is killed."""


@dataclass(frozen=True)
class ClusterPolicy:
    """When a cluster is taken for lost: whoever waits must hear it within a minute."""

    connect_seconds: float = 20.0
    """Seconds in which a scheduler must answer the first call."""
    silence_seconds: float = 20.0
    """Seconds without an answer of the scheduler after which it is lost. A scheduler that is busy answers within a few."""
    empty_seconds: float = 40.0
    """Seconds without any worker: a worker that is started anew takes three to ten, and thirty on a machine with far more to do than
    it can."""
    call_seconds: float = 5.0
    """Seconds that one call of the scheduler may take."""
    look_seconds: float = 1.0
    """Seconds between two calls: a worker that lives for a shorter time is not counted."""
    listen_seconds: float = 4.0
    """Seconds between two looks at the heartbeats of the workers."""
    frozen_seconds: float = 25.0
    """Seconds without a heartbeat after which a worker is done without; one beats twice a second in a small cluster, and on a machine
    with far more to do than it can every ten."""
    frozen_seconds_per_worker: float = 0.03
    """The same for each worker of a large cluster: a thousand of them beat every six seconds only."""
    least_losses: int = 6
    """Workers that may die one after another while no job is finished: one bad job kills four before Dask gives it up."""
    losses_per_worker: int = 3
    """The same for each worker of a large cluster, which may lose many at once when a machine goes."""
    fruitless_seconds: float = 40.0
    """Seconds without a finished job after which a cluster that has lost more workers than it ever had at a time is given up: where
    workers begin slowly and die, their number alone would take minutes to tell."""
    local_failures: int = 1
    """Workers of a local cluster that may die of a job before it is tried alone: each takes seconds to replace."""
    close_seconds: float = 5.0
    """Seconds that closing may take."""


RETRY_POLICY = RetryPolicy()
CLUSTER_POLICY = ClusterPolicy()
