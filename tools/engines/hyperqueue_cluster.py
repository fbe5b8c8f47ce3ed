#!/usr/bin/env python3
"""Runs a task array on a HyperQueue cluster of this machine, for tests.

usage: tools/engines/hyperqueue_cluster.py SCRIPT TASKS

Needs the package `hyperqueue` from PyPI. It starts a server and a worker of two cores, submits `sh SCRIPT` as tasks 1 to TASKS,
waits for them, prints the failed ones and stops both. The exit code is 1 if a task failed. The package has no `hq` program; tasks get
the same environment as those of `hq submit --array`.
"""

import contextlib
import sys
import tempfile

from hyperqueue import Job
from hyperqueue.cluster import LocalCluster, WorkerConfig


def main() -> int:
    script, tasks = sys.argv[1], int(sys.argv[2])
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(sys.stderr):
        with LocalCluster(folder, WorkerConfig(cores=2)) as cluster:
            client = cluster.client()
            # No task's failure ends the others.
            job = Job(default_workdir=folder, max_fails=None)
            # The package numbers tasks from 0, `hq submit --array=1-N` from 1.
            job.program(["true"])
            for _ in range(tasks):
                job.program(["sh", script])
            submitted = client.submit(job)
            client.wait_for_jobs([submitted], raise_on_error=False)
            failed = client.get_failed_tasks(submitted)
    for task, failure in sorted(failed.items()):
        print(f"task {task}: {failure.error}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
