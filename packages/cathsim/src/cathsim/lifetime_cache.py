"""Results that are kept as long as the object they were made from, or as long as somebody uses them."""

from __future__ import annotations

import functools
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Concatenate, Generic, ParamSpec, TypeVar
from weakref import WeakKeyDictionary, WeakValueDictionary

Owner = TypeVar("Owner")
Further = ParamSpec("Further")
Result = TypeVar("Result")


def kept_with_owner(
    make: Callable[Concatenate[Owner, Further], Result],
) -> Callable[Concatenate[Owner, Further], Result]:
    """Makes a function remember its results for as long as its first argument is in use; safe between threads.

    Args:
        make: its first argument is compared by identity, the others must be hashable; the result must not refer to the
            first argument, which would then never be freed.

    Returns:
        The function; calls with the same arguments share one result.
    """
    by_owner: WeakKeyDictionary[Owner, dict[object, Result]] = WeakKeyDictionary()
    lock = threading.RLock()

    @functools.wraps(make)
    def look_up(owner: Owner, *args: Further.args, **kwargs: Further.kwargs) -> Result:
        key = (args, tuple(sorted(kwargs.items())))
        with lock:
            results = by_owner.setdefault(owner, {})
            if key not in results:
                results[key] = make(owner, *args, **kwargs)
            return results[key]

    return look_up


class KeptWhileUsed(Generic[Result]):
    """Results that are kept as long as somebody uses them, the last few for longer; not safe between threads.

    Args:
        latest: how many are kept although nobody uses them.
    """

    def __init__(self, latest: int) -> None:
        self._number = latest
        self._in_use: WeakValueDictionary[Hashable, Result] = WeakValueDictionary()
        self._latest: OrderedDict[Hashable, Result] = OrderedDict()

    def take(self, key: Hashable, make: Callable[[], Result]) -> Result:
        """The result of a key, made where it is not kept."""
        result = self._in_use.get(key)
        if result is None:
            result = make()
            self._in_use[key] = result
        self._latest[key] = result
        self._latest.move_to_end(key)
        while len(self._latest) > self._number:
            self._latest.popitem(last=False)
        return result
