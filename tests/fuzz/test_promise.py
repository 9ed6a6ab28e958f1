"""A reader that breaks its promise is found, with the seed that shows it."""

from __future__ import annotations

import random
import time
from collections.abc import Callable

import pytest

from tests.fuzz.promise import BrokenPromiseError, fuzz, refused, verdicts


def raises(rng: random.Random) -> str:
    raise KeyError("nothing of that name")


def hangs(rng: random.Random) -> str:
    time.sleep(60)
    return "accepted"


def refuses_in_two_lines(rng: random.Random) -> str:
    return refused(ValueError("two\nlines"))


def fills_memory(rng: random.Random) -> str:
    return "accepted" if bytearray(b"1" * 200_000_000) else "refused"


@pytest.mark.parametrize(
    ("reader", "error"),
    [(raises, "nothing of that name"), (hangs, "no end"), (refuses_in_two_lines, "no sentence"), (fills_memory, "MB")],
)
def test_a_broken_promise_is_found(reader: Callable[[random.Random], str], error: str) -> None:
    case = fuzz(7, seconds=0.2, megabytes=100)(reader)
    with pytest.raises((KeyError, BrokenPromiseError), match=error) as found:
        case()
    assert any("rng=Random(7)" in note or "rng=<random.Random" in note for note in found.value.__notes__)


def test_verdicts_are_counted() -> None:
    def splits(rng: random.Random) -> str:
        return rng.choice(("equal", "accepted"))

    fuzz()(splits)()
    assert verdicts["splits"]["equal"] + verdicts["splits"]["accepted"] >= 5
