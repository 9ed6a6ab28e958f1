"""The reset bank: draws, capacity, random state."""

from __future__ import annotations

import numpy as np
import pytest

from enn.reinforcement.reset_bank import ResetBank


def test_draws_its_share_from_what_was_added() -> None:
    bank = ResetBank(share=0.25, seed=3)
    assert bank.draw() is None
    states = np.arange(20.0).reshape(10, 2)
    bank.add_episode(states)
    draws = [bank.draw() for _ in range(4000)]
    given = [draw for draw in draws if draw is not None]
    assert 0.22 < len(given) / len(draws) < 0.28
    assert {tuple(draw) for draw in given} == {tuple(row) for row in states}


def test_share_zero_gives_nothing_and_one_always_something() -> None:
    for share, expected in ((0.0, 0), (1.0, 50)):
        bank = ResetBank(share=share)
        bank.add_episode(np.ones((3, 4)))
        assert sum(bank.draw() is not None for _ in range(50)) == expected


def test_oldest_states_make_room() -> None:
    bank = ResetBank(share=1.0, capacity=4)
    for number in range(3):
        bank.add_episode(np.full((3, 1), float(number)))
    assert len(bank) == 4
    assert {float(bank.draw()[0]) for _ in range(100)} == {1.0, 2.0}  # type: ignore[index]


def test_an_episode_longer_than_the_bank_leaves_its_end() -> None:
    bank = ResetBank(share=1.0, capacity=3)
    bank.add_episode(np.arange(10.0)[:, None])
    assert {float(bank.draw()[0]) for _ in range(100)} == {7.0, 8.0, 9.0}  # type: ignore[index]


def test_what_is_drawn_can_be_written_into() -> None:
    bank = ResetBank(share=1.0)
    bank.add_episode(np.zeros((1, 2)))
    bank.draw()[:] = 5.0  # type: ignore[index]
    np.testing.assert_array_equal(bank.draw(), [0.0, 0.0])


def test_goes_on_exactly_after_a_restore() -> None:
    bank, other = ResetBank(capacity=5, seed=1), ResetBank(capacity=5, seed=9)
    bank.add_episode(np.arange(14.0).reshape(7, 2))
    bank.draw()
    other.restore(bank.state())
    for one in (bank, other):
        one.add_episode(np.full((2, 2), -1.0))
    for _ in range(50):
        first, second = bank.draw(), other.draw()
        assert (first is None) == (second is None)
        if first is not None:
            np.testing.assert_array_equal(first, second)


def test_refusals_say_why() -> None:
    with pytest.raises(ValueError, match=r"between 0 and 1, got 1\.5"):
        ResetBank(share=1.5)
    with pytest.raises(ValueError, match="capacity must be at least 1"):
        ResetBank(capacity=0)
    bank = ResetBank()
    bank.add_episode(np.zeros((2, 3)))
    with pytest.raises(ValueError, match=r"keeps states of 3 values, got 4.*another wire"):
        bank.add_episode(np.zeros((2, 4)))
    with pytest.raises(ValueError, match="shape \\(T, n\\)"):
        bank.add_episode(np.zeros(3))
    with pytest.raises(ValueError, match="finite"):
        bank.add_episode(np.full((1, 3), np.nan))
    with pytest.raises(ValueError, match="holds 2 states, more than the capacity of 1"):
        ResetBank(capacity=1).restore(bank.state())
