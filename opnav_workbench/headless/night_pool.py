"""Where the pictures of a night are processed: on this machine, or on a Dask cluster that stands already."""

import importlib
import threading
from collections.abc import Generator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from typing import Any, Protocol

from opnav_workbench.errors import SessionError
from opnav_workbench.headless.night_worker import Job, Verdict, process_picture

__all__ = ["ClusterPool", "LocalPool", "Pool"]

CONNECT_S = 10


class Pool(Protocol):
    """Processes pictures, several at a time."""

    def run(self, jobs: Sequence[Job]) -> Generator[Verdict, None, None]:
        """Yield the verdicts as they come; closing the iterator stops what is running."""
        ...


class LocalPool:
    """Processes of this machine.

    Parameters
    ----------
    count : int
        Pictures at a time.
    """

    def __init__(self, count: int) -> None:
        if count < 1:
            raise SessionError(f"{count} jobs at a time; give at least 1.")
        self._count = count

    def run(self, jobs: Sequence[Job]) -> Generator[Verdict, None, None]:
        """Yield the verdicts as they come; closing the iterator stops what is running."""
        stop = threading.Event()
        with ThreadPoolExecutor(self._count) as threads:
            futures = [threads.submit(process_picture, job.to_dict(), stop) for job in jobs]
            try:
                for future in as_completed(futures):
                    yield Verdict(**future.result())
            finally:
                stop.set()
                for future in futures:
                    future.cancel()


class ClusterPool:
    """Workers of a Dask cluster, which must see the same folders; a worker that dies is replaced by another.

    Parameters
    ----------
    address : str
        Of the scheduler.

    Raises
    ------
    SessionError
        Dask is not installed, or the scheduler does not answer.
    """

    def __init__(self, address: str) -> None:
        try:
            distributed: Any = importlib.import_module("distributed")  # an optional part
        except ImportError as error:
            raise SessionError('a cluster needs Dask: pip install "opnav_workbench[cluster]".') from error
        try:
            self._client = distributed.Client(address, timeout=CONNECT_S)
        except (OSError, ValueError, TimeoutError) as error:
            raise SessionError(
                f"no Dask scheduler answers at {address} ({error}); start one with: dask scheduler."
            ) from error
        self._as_completed = distributed.as_completed

    def run(self, jobs: Sequence[Job]) -> Generator[Verdict, None, None]:
        """Yield the verdicts as they come; closing the iterator drops what has not begun."""
        futures = {
            self._client.submit(process_picture, job.to_dict(), pure=False, retries=job.retries): job
            for job in jobs
        }
        try:
            for future in self._as_completed(list(futures)):
                error = future.exception()
                if error is None:
                    yield Verdict(**future.result())
                else:
                    name = futures[future].name
                    yield Verdict(
                        name,
                        "",
                        "machine",
                        f"its worker was lost ({type(error).__name__}: {error})",
                        0.0,
                        0.0,
                    )
        finally:
            self._client.cancel(list(futures))
            self._client.close()
