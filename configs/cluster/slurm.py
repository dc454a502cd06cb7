"""Run `dlgmd batch` on a SLURM cluster, 80 videos at a time: ten jobs of eight videos each.

Everything on the command line goes to `dlgmd batch`.
"""

import subprocess
import sys

from dask_jobqueue import SLURMCluster

cluster = SLURMCluster(
    queue="normal",
    cores=8,  # videos at a time in a job
    processes=8,  # one process for each, so that a crash costs one video
    job_cpu=16,  # processors of a job, which its videos share
    memory="32GB",
    walltime="04:00:00",
    interface="ib0",  # the network between login node and jobs
    local_directory="/tmp",
    job_script_prologue=["source /shared/venv/bin/activate", "export TMPDIR=/tmp"],
    python="/shared/venv/bin/python",
)
cluster.scale(jobs=10)
command = ["dlgmd", "batch", *sys.argv[1:], "--scheduler", cluster.scheduler_address]
ended = subprocess.run(command)
cluster.close()
sys.exit(ended.returncode)
