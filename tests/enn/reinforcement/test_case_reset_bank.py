"""The bank over cases: room of their own, more episodes where they fail, random state."""

from __future__ import annotations

import numpy as np
import pytest

from enn.reinforcement.case_reset_bank import LEAST_WEIGHT, CaseBank


def episode(case: int, count: int, value: float = 0.0) -> np.ndarray:
    return np.column_stack((np.full(count, value), np.arange(count), np.full(count, case)))


def test_a_rare_case_is_drawn_as_often_as_a_frequent_one() -> None:
    bank = CaseBank(3, share=1.0, capacity=20)
    bank.add_episode(episode(2, 4))
    for _ in range(30):
        bank.add_episode(episode(0, 10))
    assert len(bank) == 24  # the frequent one has not crowded the rare one out
    cases = np.array([bank.draw()[-1] for _ in range(2000)])  # type: ignore[index]
    assert set(cases) == {0.0, 2.0}
    assert 0.45 < (cases == 2).mean() < 0.55


def test_its_share_starts_from_the_bank() -> None:
    bank = CaseBank(1, share=0.25, seed=1)
    assert bank.draw() is None
    bank.add_episode(episode(0, 3))
    assert 0.2 < np.mean([bank.draw() is not None for _ in range(2000)]) < 0.3


def test_episodes_take_place_where_they_fail() -> None:
    bank = CaseBank(4, seed=2)
    for _ in range(20):
        for case in range(4):
            bank.judge(case, success=case != 1)
    chosen = np.bincount([bank.choose() for _ in range(4000)], minlength=4) / 4000
    assert chosen[1] == pytest.approx((1 + LEAST_WEIGHT) / (1 + 4 * LEAST_WEIGHT), abs=0.03)
    assert chosen[[0, 2, 3]] == pytest.approx(LEAST_WEIGHT / (1 + 4 * LEAST_WEIGHT), abs=0.03)


def test_goes_on_exactly_after_a_restore() -> None:
    bank, other = CaseBank(3, seed=1, capacity=5), CaseBank(3, seed=9, capacity=5)
    bank.add_episode(episode(1, 7))
    bank.judge(1, success=True)
    bank.choose()
    other.restore(bank.state())
    for one in (bank, other):
        one.add_episode(episode(2, 3, value=4.0))
        one.judge(0, success=True)
    for _ in range(50):
        assert bank.choose() == other.choose()
        first, second = bank.draw(), other.draw()
        assert (first is None) == (second is None)
        if first is not None:
            np.testing.assert_array_equal(first, second)


def test_an_episode_in_two_cases_is_one_sentence() -> None:
    with pytest.raises(ValueError, match="an episode stays in one case, got states of 2"):
        CaseBank(3).add_episode(np.concatenate((episode(0, 2), episode(1, 2))))
