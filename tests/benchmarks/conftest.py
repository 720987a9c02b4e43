"""How the benchmarks take their times."""

import time
from collections.abc import Callable, Sequence
from itertools import repeat

import pytest

MOST_ROUNDS = 10


def _fastest(
    *calls: Callable[[], object],
    enough: Callable[..., bool] = lambda *_seconds: True,
    times: Sequence[int] | None = None,
) -> tuple[tuple[float, object], ...]:
    """Return the least processor time of each call, in seconds, and what it returned then.

    Every round has each call (`times` of it, else once), so that none alone meets the moment when its neighbours
    have the caches. The least times fall to what the program needs with every round; on a busy machine that takes
    some: rounds go on until `enough` of the seconds so far, at most `MOST_ROUNDS`.
    """
    best: list[tuple[float, object]] = [(float("inf"), None)] * len(calls)
    for _ in range(MOST_ROUNDS):
        for i, (call, count) in enumerate(zip(calls, times or repeat(1), strict=False)):
            for _ in range(count):
                began = time.process_time()
                value = call()
                best[i] = min(best[i], (time.process_time() - began, value), key=lambda timed: timed[0])
        if enough(*(seconds for seconds, _ in best)):
            break
    return tuple(best)


@pytest.fixture
def fastest():
    """See `_fastest`."""
    return _fastest
