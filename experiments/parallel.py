"""The same function on many arguments, in worker processes, answers in order."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

T = TypeVar("T")


def in_parallel(
    function: Callable[..., T], arguments: Sequence[tuple[Any, ...]], jobs: int | None
) -> Iterator[T]:
    """Call a function on each tuple of arguments.

    Args:
        function: importable by workers.
        arguments: one tuple per call.
        jobs: processes; None for one per core. One call or one job runs in this process.

    Yields:
        The answers, in the order of the arguments.
    """
    if jobs == 1 or len(arguments) == 1:
        for one in arguments:
            yield function(*one)
        return
    from joblib import cpu_count
    from loky import get_reusable_executor

    workers = min(jobs or cpu_count(), len(arguments))
    executor = get_reusable_executor(max_workers=workers, env={"OMP_NUM_THREADS": "1"})
    futures = [executor.submit(function, *one) for one in arguments]
    for future in futures:
        yield future.result()
