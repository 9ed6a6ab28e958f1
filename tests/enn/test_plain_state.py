"""Plain state: what comes back from a file is what went in, kind by kind; what is no data is refused by its place."""

from __future__ import annotations

import collections
import random
from typing import Any

import numpy as np
import pytest
import torch

from enn.model_file import decoded, encoded
from enn.reinforcement.checkpoint import plain, restored


def _same(one: Any, other: Any) -> None:
    assert type(one) is type(other) or isinstance(one, dict)
    if isinstance(one, dict):
        assert list(one) == list(other)
        for name in one:
            _same(one[name], other[name])
    elif isinstance(one, list | tuple):
        for a, b in zip(one, other, strict=True):
            _same(a, b)
    elif isinstance(one, np.ndarray | np.generic):
        assert (one.dtype, one.shape, one.flags.f_contiguous) == (other.dtype, other.shape, other.flags.f_contiguous)
        np.testing.assert_array_equal(one, other)
    elif isinstance(one, torch.Tensor):
        assert one.dtype == other.dtype
        assert torch.equal(one, other)
    else:
        assert one == other or one != one


@pytest.mark.parametrize(
    "state",
    [
        {"python": random.getstate(), "numpy": np.random.get_state(), "torch": torch.get_rng_state()},  # noqa: NPY002
        {"generator": np.random.default_rng(0).bit_generator.state, "old": np.random.MT19937(1).state},
        {"bytes": [b"", b"\x00\xff\x80a"], "numbers": (1, -(2**200), 0.1, float("nan"), float("inf"), True, None, "a")},
        [np.arange(6).reshape(2, 3).T, np.zeros((0, 3)), np.array(3.5), np.array([True]), np.ones(3, np.float16)],
        [np.array([1, 2], np.uint64), np.array([3], np.uint32), np.array([1 + 2j])],
        [np.float32(0.1), np.float64(0.2), np.bool_(True), np.int8(3)],
        {0: {"step": torch.tensor(1.0)}, "groups": [{"lr": 0.1, "params": [0, 1]}], "empty": [{}, [], ()]},
    ],
    ids=["random", "generators", "singles", "arrays", "types", "scalars", "optimiser"],
)
def test_what_comes_back_is_what_went_in(state: Any) -> None:
    _same(state, restored(decoded(encoded(plain(state)))))


def test_an_array_that_comes_back_can_be_written_to() -> None:
    array = np.arange(3)
    array.flags.writeable = False
    back = restored(decoded(encoded(plain({"a": array}))))["a"]
    back[0] = 7
    assert array[0] == 0


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (collections.deque(), "envs/0 is a deque, which a checkpoint cannot hold"),
        (np.array(["a"]), "envs/0 is an array of type <U1"),
        (np.array([object()]), "envs/0 is an array of type object"),
        (np.array([1], ">f4"), "envs/0 is an array of type >f4"),
        ({(1, 2): 3}, "envs/0 is a dictionary with a tuple as a key"),
        (random.Random(0), "envs/0 is a Random"),
    ],
)
def test_what_is_no_data_is_refused_by_its_place(value: Any, message: str) -> None:
    with pytest.raises(TypeError, match=message):
        plain({"envs": [value]})
