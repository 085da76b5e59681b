"""Many independent jobs here, in processes of this machine or on a cluster."""

from greybox.parallel.cluster import open_cluster
from greybox.parallel.interrupts import note_interrupts
from greybox.parallel.jobs import (
    JobProgressCallback,
    JobResult,
    JobResultCallback,
    open_workers,
    run_jobs,
)
from greybox.parallel.local_pool import count_cores, open_local_pool
from greybox.parallel.policy import ClusterPolicy, RetryPolicy

__all__ = [
    "ClusterPolicy",
    "JobProgressCallback",
    "JobResult",
    "JobResultCallback",
    "RetryPolicy",
    "count_cores",
    "note_interrupts",
    "open_cluster",
    "open_local_pool",
    "open_workers",
    "run_jobs",
]
