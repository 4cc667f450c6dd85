"""`--cluster`: the workers that process the cases."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ssm_pipeline.engine.cluster import DaskCluster, connected
from ssm_pipeline.engine.per_case import Workers
from ssm_pipeline.engine.slurm import SlurmSettings, on_slurm
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.records import StudyError
from ssm_pipeline.study.yaml_settings import checked_as, read_yaml


@contextmanager
def cluster_at(
    where: str | None, terminal: Terminal, memory_gb: float | None = None
) -> Iterator[Workers | None]:
    """Yield the workers of a scheduler's address, or of the Slurm jobs that a YAML describes.

    For None, yields None: the run then uses processes on this machine.

    Raises:
        StudyError: If it is neither, the scheduler can't be reached, or the YAML is not valid.
    """
    if where is None:
        yield None
    elif "://" in where:
        with connected(where) as client:
            yield DaskCluster(client, memory_gb, say=terminal.detail)
    elif Path(where).suffix in (".yaml", ".yml"):
        path = Path(where)
        if not path.is_file():
            raise StudyError(f"--cluster {where}: there is no such file.")
        with on_slurm(checked_as(SlurmSettings, read_yaml(path), path)) as client:
            yield DaskCluster(client, memory_gb, wait_s=None, say=terminal.detail)
    else:
        raise StudyError(
            f"--cluster {where}: give the address of a Dask scheduler, such as tcp://host:8786, or "
            "the path of a YAML file with Slurm's settings."
        )
