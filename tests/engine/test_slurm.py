"""`--cluster slurm.yaml`, with a stand-in for Slurm: its jobs are processes here."""

from __future__ import annotations

from pathlib import Path

import pytest
from dask_bench import PATHS
from toy_bench import GOOD, Bench
from toy_study import write_masks

pytest.importorskip("dask_jobqueue")

from ssm_pipeline.commands.cluster import cluster_at
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.records import StudyError

SBATCH = """#!/bin/sh
if [ "$1" = --test-only ]; then exec grep -q '^#SBATCH -J' -; fi
cp "$1" {folder}/job-$$.sh
setsid sh {folder}/job-$$.sh > {folder}/job.log 2>&1 &
echo $! >> {folder}/jobs
echo "Submitted batch job $!"
"""
SCANCEL = """#!/bin/sh
echo "$@" >> {folder}/cancelled
for job in "$@"; do kill -9 -- "-$job"; done
"""


@pytest.fixture
def slurm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder in which the jobs that were submitted and cancelled are seen."""
    folder = tmp_path / "slurm"
    folder.mkdir()
    for name, script in (("sbatch", SBATCH), ("scancel", SCANCEL)):
        path = folder / name
        path.write_text(script.format(folder=folder))
        path.chmod(0o755)
    monkeypatch.setenv("PATH", str(folder), prepend=":")
    monkeypatch.setenv("PYTHONPATH", PATHS)
    return folder


def write_yaml(folder: Path, text: str) -> str:
    path = folder / "slurm.yaml"
    path.write_text(text)
    return str(path)


def test_workers_are_slurm_jobs_that_end_with_the_run(slurm: Path, tmp_path: Path) -> None:
    write_masks(tmp_path / "masks", GOOD)
    bench = Bench(tmp_path)
    path = write_yaml(
        tmp_path,
        "workers: 2\nworkers_per_job: 2\nmemory_gb: 1.5\nwalltime: '00:20:00'\n"
        "partition: short\naccount: bones\ninterface: lo\n"
        "prologue: [echo ready]\ndirectives: [--constraint=avx2]\n",
    )
    with cluster_at(path, Terminal()) as workers:
        bench.run(cluster=workers)
    assert bench.sum == "20"
    (script,) = (job.read_text() for job in slurm.glob("job-*.sh"))
    for line in ("-p short", "-A bones", "--mem=3G", "-t 00:20:00", "--constraint=avx2"):
        assert f"#SBATCH {line}" in script, script
    assert "echo ready" in script
    assert "--nthreads 1 " in script
    assert "--nworkers 2 " in script
    assert (slurm / "cancelled").read_text().split() == (slurm / "jobs").read_text().split()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("workers: 2\nmemory: 4\n", "there is no setting memory. Did you mean memory_gb?"),
        ("workers: none\n", "workers: Input should be a valid integer"),
        ("partition: short\n", "workers: Field required"),
        ("workers: [\n", "can't be read as YAML"),
        ("", "holds no settings"),
    ],
)
def test_a_file_that_is_no_such_yaml_is_refused(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(StudyError) as error:
        cluster_at(write_yaml(tmp_path, text), Terminal()).__enter__()
    assert said in str(error.value)


def test_a_job_that_slurm_refuses_ends_the_run_before_it_begins(
    slurm: Path, tmp_path: Path
) -> None:
    (slurm / "sbatch").write_text("#!/bin/sh\necho Invalid account >&2\nexit 1\n")
    with pytest.raises(StudyError, match=r"(?s)Slurm rejects the job: .*Invalid account"):
        cluster_at(write_yaml(tmp_path, "workers: 1\ninterface: lo\n"), Terminal()).__enter__()


def test_a_missing_file_and_a_missing_sbatch_are_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(StudyError, match="there is no such file"):
        cluster_at(str(tmp_path / "slurm.yaml"), Terminal()).__enter__()
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(StudyError, match="the command sbatch was not found"):
        cluster_at(write_yaml(tmp_path, "workers: 1\n"), Terminal()).__enter__()
