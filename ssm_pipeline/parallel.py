"""Work spread over processes of this machine."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, Literal

ResultsAs = Literal["generator", "generator_unordered"]


def in_processes(tasks: Iterable[Any], jobs: int, ordered: bool = True) -> Iterator[Any]:
    """The results of tasks (`joblib.delayed`) as they come, `jobs` at a time.

    One thread in each process: threads that share many small queries wait for each other, and sums
    keep their order, so that results don't depend on `jobs`.

    Args:
        ordered: As the tasks are; else whichever is ready first.

    >>> import joblib
    >>> list(in_processes([joblib.delayed(abs)(number) for number in (-1, 2)], jobs=1))
    [1, 2]
    """
    import joblib

    results_as: ResultsAs = "generator" if ordered else "generator_unordered"
    with joblib.parallel_config(backend="loky", inner_max_num_threads=1):
        parallel = joblib.Parallel(n_jobs=jobs, batch_size=1, return_as=results_as)
    yield from parallel(tasks)
