"""Seeded damage: to bytes, to plain values as JSON holds them, and to lines of text."""

import copy
import json
import random
from typing import Any

NASTY: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2**31, 2**63, 2**64, -(2**70), 10**400, 0.5, -0.0, 1e-300, 1e300, float("nan"),
    float("inf"), "", "x", "nan", "../../x", "\0", "\ud800", "x" * 5000, [], {}, [[]], [None], {"a": 1}, [0] * 1000,
)  # fmt: skip


def damaged(data: bytes, rng: random.Random) -> bytes:
    """Bytes with one to four kinds of damage."""
    changed = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        size = len(changed)
        at = rng.randrange(size) if size else 0
        length = min(rng.choice((1, 2, 8, 64, 1024)), size - at)
        kind = rng.randrange(8)
        if kind <= 1 and size:
            changed[at] ^= 1 << rng.randrange(8)
        elif kind == 2:
            del changed[at : at + length]
        elif kind == 3:
            changed[at:at] = rng.randbytes(length)
        elif kind == 4:
            changed[at : at + length] = bytes(length)
        elif kind == 5:
            changed[at : at + length] = b"\xff" * length
        elif kind == 6:
            del changed[at:]
        else:
            other = rng.randrange(size) if size else 0
            changed[at:at] = changed[other : other + length]
    return bytes(changed)


def places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Paths of everything in a plain value but the value itself."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    found: list[tuple[Any, ...]] = []
    for key, inner in items:
        found += [(*path, key), *places(inner, (*path, key))]
    return found


def deep(rng: random.Random) -> Any:
    """A list or an object in another, many times."""
    value: Any = 1
    for _ in range(rng.choice((50, 500, 900))):
        value = [value] if rng.random() < 0.5 else {"a": value}
    return value


def altered(value: Any, rng: random.Random) -> Any:
    """A plain value in which one to three things are exchanged, missing, moved or added."""
    for _ in range(rng.choice((1, 1, 2, 3))):
        paths = places(value)
        if not paths:
            return rng.choice(NASTY)
        path = rng.choice(paths)
        value = holder = copy.copy(value)
        for key in path[:-1]:  # what lies on the way is copied, the rest is shared: a copy of all has limits of depth
            holder[key] = copy.copy(holder[key])
            holder = holder[key]
        kind = rng.randrange(6)
        if kind <= 2:
            holder[path[-1]] = copy.deepcopy(rng.choice(NASTY))
        elif kind == 3:
            del holder[path[-1]]
        elif kind == 4:
            holder[path[-1]] = deep(rng)
        elif isinstance(holder, dict):
            holder[rng.choice(("more", "", "name", "x" * 300))] = holder[path[-1]]
        else:
            holder.append(copy.deepcopy(rng.choice(NASTY)))
    return value


def text_of(value: Any, rng: random.Random) -> str:
    """JSON of an altered value; sometimes with what JSON should not hold."""
    try:
        text = json.dumps(value)
    except RecursionError:  # what this encoder cannot write may still be read
        text = "[" * 2000 + "]" * 2000
    return text if rng.random() < 0.9 else text[: rng.randrange(len(text) + 1)]


def rewritten(text: str, rng: random.Random) -> str:
    """A text in which numbers and words are exchanged, or lines are missing."""
    lines = text.splitlines(keepends=True)
    for _ in range(rng.choice((1, 2, 4))):
        if not lines:
            break
        at = rng.randrange(len(lines))
        kind = rng.randrange(5)
        if kind == 0:
            del lines[at]
        elif kind == 1:
            lines.insert(at, lines[rng.randrange(len(lines))])
        else:
            words = lines[at].split(" ")
            nasty = rng.choice(NASTY)
            words[rng.randrange(len(words))] = nasty if isinstance(nasty, str) else repr(nasty)
            lines[at] = " ".join(words)
    return "".join(lines)
