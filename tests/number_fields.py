"""Number fields of settings, found by their annotations, and what each is tried with."""

from __future__ import annotations

import dataclasses
import types
import typing
from collections.abc import Callable, Iterator
from typing import Any

import pytest

BAD = {"NaN": float("nan"), "infinity": float("inf"), "-1": -1, "0": 0, "1e300": 1e300, "text": "five"}


def number_fields(settings: Any) -> Iterator[tuple[str, Callable[[Any], Any]]]:
    """Yields each field with a number in it, and how a value is put there: in a tuple, as its first."""
    hints = typing.get_type_hints(type(settings), include_extras=True)
    for field in dataclasses.fields(settings):
        place = _number(hints[field.name])
        if place is not None:
            yield field.name, _putter(getattr(settings, field.name), place)


def accepted(settings: Any) -> set[str]:
    """The bad values that each field takes all the same, as ``field=0``; for every other one a ValueError names it."""
    taken = set()
    for name, put in number_fields(settings):
        for word, value in BAD.items():
            try:
                dataclasses.replace(settings, **{name: put(value)})
            except ValueError as error:
                if name not in str(error) or "\n" in str(error):
                    raise AssertionError(f"{word} in {name} is not refused with a sentence that names it") from error
            else:
                taken.add(f"{name}={word}")
    return taken


def _number(hint: Any) -> int | None:
    """How many tuples deep a number is in an annotation; None: there is none."""
    if hint in (int, float):
        return 0
    origin = typing.get_origin(hint)
    if origin is typing.Annotated:
        return _number(typing.get_args(hint)[0])
    if origin in (tuple, list):
        inner = _number(typing.get_args(hint)[0])
        return None if inner is None else inner + 1
    if origin in (types.UnionType, typing.Union):
        found = [depth for part in typing.get_args(hint) if (depth := _number(part)) is not None]
        return found[0] if found else None
    return None


def _putter(current: Any, depth: int) -> Callable[[Any], Any]:
    if depth == 0:
        return lambda value: value
    rest = tuple(current or ())
    inner = _putter(rest[0] if rest else (), depth - 1)
    return lambda value: (inner(value), *rest[1:])


def parametrised(everything: dict[Any, str]) -> pytest.MarkDecorator:
    """A test for each settings object, with the bad values that are legal there.

    Args:
        everything: settings to the legal ones, as "field=0 other=-1".
    """
    cases = [pytest.param(one, set(legal.split()), id=type(one).__name__) for one, legal in everything.items()]
    return pytest.mark.parametrize(("settings", "legal"), cases)
