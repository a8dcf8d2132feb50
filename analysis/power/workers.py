"""Where chunks of work are done: on this machine's cores (joblib), or on a Dask cluster.

A chunk's result is a function of the chunk alone, so that it is the same wherever it is computed; results come back in
any order, each with its chunk's place.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from importlib import metadata
from typing import Any, TypeVar

from experiment.errors import PowerError

Chunk = TypeVar("Chunk")
Result = TypeVar("Result")

PATIENCE = "10s"
"""How long a scheduler may take to answer."""


def on_cores(work: Callable[[Chunk], Result], chunks: Sequence[Chunk], jobs: int = 0) -> Iterator[tuple[int, Result]]:
    """Results of `work` on this machine; `jobs` at a time, 0 for one a core.

    Raises:
        PowerError: the system ended a process that worked.
    """
    from joblib import Parallel, cpu_count, delayed

    jobs = min(jobs or cpu_count(), len(chunks))
    if jobs <= 1:
        yield from ((place, work(chunk)) for place, chunk in enumerate(chunks))
        return
    parallel = Parallel(n_jobs=jobs, return_as="generator_unordered")
    try:
        yield from parallel(delayed(_placed)(work, place, chunk) for place, chunk in enumerate(chunks))
    except BrokenProcessPool as error:
        raise PowerError(
            f"--jobs {jobs}: the system ended a process that worked, perhaps for want of memory; call again with fewer"
        ) from error


def on_cluster(work: Callable[[Chunk], Result], chunks: Sequence[Chunk], address: str) -> Iterator[tuple[int, Result]]:
    """Results of `work` on the Dask cluster whose scheduler has this address.

    Raises:
        PowerError: Dask is not installed, nothing answers there, no worker is there, a worker's software differs from
            ours, or a worker is lost.
    """
    try:
        from distributed import Client, as_completed
        from distributed.client import FutureCancelledError
        from distributed.comm.core import CommClosedError
        from distributed.scheduler import KilledWorker
    except ImportError:
        raise PowerError("--scheduler: got no Dask here; install palpate[cluster], then call again") from None
    try:
        client = Client(address, timeout=PATIENCE)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        raise PowerError(
            f"--scheduler {address}: got no answer ({error}); allowed: the address of a running Dask scheduler, such "
            "as tcp://10.0.0.1:8786; start one, or leave --scheduler out"
        ) from None
    with client:
        try:
            _same_software(address, client.run(_versions_of(tuple(software()))))
            futures = client.map(_placed, [work] * len(chunks), range(len(chunks)), chunks, pure=False)
            for future in as_completed(futures):  # type: ignore[no-untyped-call]
                yield future.result()
                future.release()
        except (KilledWorker, CommClosedError, FutureCancelledError) as error:
            reason = next(iter(str(error).splitlines()), type(error).__name__)
            raise PowerError(f"--scheduler {address}: the cluster was lost ({reason}); call again") from error


def software() -> dict[str, str]:
    """What numbers depend on, name -> version."""
    return {name: metadata.version(name) for name in ("palpate", "numpy", "scipy")}


def _versions_of(names: tuple[str, ...]) -> Callable[[], dict[str, str]]:
    """What finds the versions of packages on a worker; it travels whole, so that the worker needs none of them."""

    def versions() -> dict[str, str]:
        from importlib import metadata

        found = {}
        for name in names:
            try:
                found[name] = metadata.version(name)
            except metadata.PackageNotFoundError:
                found[name] = "none"
        return found

    return versions


def _placed(work: Callable[[Chunk], Result], place: int, chunk: Chunk) -> tuple[int, Result]:
    return place, work(chunk)


def _same_software(address: str, workers: dict[str, Any]) -> None:
    if not workers:
        raise PowerError(f"--scheduler {address}: got a cluster without workers; start one there, then call again")
    ours = software()
    for worker, theirs in workers.items():
        if theirs != ours:
            raise PowerError(
                f"--scheduler {address}: worker {worker} got {theirs}; allowed: {ours}, so that results are the same "
                "everywhere; install the same versions there"
            )
