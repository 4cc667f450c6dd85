"""Workers as jobs of a Slurm cluster (extra `cluster`)."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from pydantic import Field

from ssm_pipeline.engine.cluster import dask
from ssm_pipeline.records import StudyError
from ssm_pipeline.settings import Settings

if TYPE_CHECKING:  # an extra
    from distributed import Client


class SlurmSettings(Settings):
    """The settings in the file of `--cluster slurm.yaml`."""

    workers: int = Field(ge=1)  # cases at a time
    workers_per_job: int = Field(1, ge=1)  # cores of a job
    memory_gb: float = Field(4.0, gt=0)  # a worker
    walltime: str = "04:00:00"  # of a job; a case that it cuts off is given to another worker
    partition: str | None = None
    account: str | None = None
    interface: str | None = None  # network between the machines, as ib0
    prologue: tuple[str, ...] = ()  # shell lines before a worker starts, as module load
    directives: tuple[str, ...] = ()  # further #SBATCH ones, as --constraint=avx512


@contextmanager
def on_slurm(settings: SlurmSettings) -> Iterator[Client]:
    """Yield a client of a scheduler on this machine whose workers are Slurm jobs.

    The jobs end with the block. A job that ends earlier is submitted again.

    Raises:
        StudyError: If there is no Slurm, or it rejects a job.
    """
    distributed = dask()
    from dask_jobqueue.slurm import SLURMCluster

    if shutil.which("sbatch") is None:
        raise StudyError(
            "--cluster: the command sbatch was not found. Start the run on a machine that can "
            "submit Slurm jobs, or give the address of a Dask scheduler."
        )
    cluster = SLURMCluster(
        cores=settings.workers_per_job,
        processes=settings.workers_per_job,
        memory=f"{settings.memory_gb * settings.workers_per_job:g}GiB",
        walltime=settings.walltime,
        queue=settings.partition,
        account=settings.account,
        interface=settings.interface,
        job_script_prologue=[*settings.prologue],
        job_extra_directives=[*settings.directives],
        scheduler_options={"dashboard": False, "dashboard_address": ":0"},
    )
    with cluster, distributed.Client(cluster, set_as_default=False) as client:
        _refuse_rejected(cluster.job_script())
        cluster.adapt(minimum=settings.workers, maximum=settings.workers)
        yield client


def _refuse_rejected(script: str) -> None:
    """Raise StudyError for a job that Slurm rejects: Dask would retry without end."""
    done = subprocess.run(
        ["sbatch", "--test-only"], input=script, capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        raise StudyError(f"--cluster: Slurm rejects the job: {done.stderr.strip()}")
