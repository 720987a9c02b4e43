"""What was made of the last few things asked for: an undo, or a tab shown again, finds it and makes nothing anew."""

from collections import OrderedDict
from collections.abc import Callable, Iterator
from typing import Generic, TypeVar

__all__ = ["Recent"]

Made = TypeVar("Made")
MOST = 4  # a decision, the solution that follows it, and both of them taken back


class Recent(Generic[Made]):
    """Keeps what was made of the last things, each of which is told by its identity.

    Examples
    --------
    >>> recent, state = Recent(), object()
    >>> made = recent.of((state,), list)
    >>> recent.of((state,), list) is made, recent.of((object(),), list) is made
    (True, False)
    """

    def __init__(self) -> None:
        self._kept: OrderedDict[tuple[int, ...], tuple[tuple[object, ...], Made]] = OrderedDict()

    def __iter__(self) -> Iterator[Made]:
        """What is kept, the latest first."""
        return (made for _, made in reversed(self._kept.values()))

    def of(self, things: tuple[object, ...], make: Callable[[], Made]) -> Made:
        """Return what was made of these very objects, made now where it is not kept."""
        key = tuple(map(id, things))  # the things are kept, too: no other object takes over an identity
        kept = self._kept.get(key)
        made = make() if kept is None else kept[1]
        self._kept[key] = (things, made)
        self._kept.move_to_end(key)
        if len(self._kept) > MOST:
            self._kept.popitem(last=False)
        return made
