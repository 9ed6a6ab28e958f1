"""Equality of observations, whole and bit for bit."""

from typing import Any

import numpy as np


def same(one: Any, other: Any) -> bool:
    """Whether two observations or their parts are equal in structure, types and values."""
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    if isinstance(one, tuple):
        return len(one) == len(other) and all(same(a, b) for a, b in zip(one, other, strict=True))
    return np.asarray(one).dtype == np.asarray(other).dtype and np.array_equal(one, other)
