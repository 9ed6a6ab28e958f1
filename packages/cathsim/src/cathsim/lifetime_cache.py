"""Results that are kept exactly as long as the object they were made from."""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable
from typing import Concatenate, ParamSpec, TypeVar
from weakref import WeakKeyDictionary

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
    kept: WeakKeyDictionary[Owner, dict[object, Result]] = WeakKeyDictionary()
    lock = threading.RLock()

    @functools.wraps(make)
    def look_up(owner: Owner, *args: Further.args, **kwargs: Further.kwargs) -> Result:
        key = (args, tuple(sorted(kwargs.items())))
        with lock:
            results = kept.setdefault(owner, {})
            if key not in results:
                results[key] = make(owner, *args, **kwargs)
            return results[key]

    return look_up
