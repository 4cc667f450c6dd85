"""`--cluster`: where the work on each case is done, if not in processes here."""

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
    """The workers of the scheduler at an address, or of the Slurm jobs that a YAML describes.

    None: none, for a run in processes here.

    Raises:
        StudyError: For neither of these, for a scheduler that can't be reached, and for a file that
            is no such YAML.
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
            f"--cluster {where}: give a Dask scheduler's address, as tcp://host:8786, or the path "
            "of a YAML with Slurm's settings."
        )
