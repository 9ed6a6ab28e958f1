"""Start-state buffers: draws, capacity, also of each case, more episodes where they fail, random state."""

from collections.abc import Callable

import numpy as np
import pytest

from enn.reinforcement.start_state_buffer import CaseStartStateBuffer, StartStateBuffer


def test_draws_its_share_from_what_was_added() -> None:
    buffer = StartStateBuffer(share=0.25, seed=3)
    assert buffer.draw() is None
    states = np.arange(20.0).reshape(10, 2)
    buffer.add_episode(states)
    draws = [buffer.draw() for _ in range(4000)]
    given = [draw for draw in draws if draw is not None]
    assert 0.22 < len(given) / len(draws) < 0.28
    assert {tuple(draw) for draw in given} == {tuple(row) for row in states}


def episode(case: int, count: int, value: float = 0.0) -> np.ndarray:
    return np.column_stack((np.full(count, value), np.arange(count), np.full(count, case)))


def test_a_rare_case_is_drawn_as_often_as_a_frequent_one() -> None:
    buffer = CaseStartStateBuffer(3, share=1.0, capacity=20)
    buffer.add_episode(episode(2, 4))
    for _ in range(30):
        buffer.add_episode(episode(0, 10))
    assert len(buffer) == 24  # the frequent one has not crowded the rare one out
    cases = np.array([buffer.draw()[-1] for _ in range(2000)])  # type: ignore[index]
    assert set(cases) == {0.0, 2.0}
    assert 0.45 < (cases == 2).mean() < 0.55


def test_states_of_cases_are_drawn_by_the_seed_and_apart_from_each_other() -> None:
    def drawn(seed: int) -> dict[int, list[float]]:
        buffer = CaseStartStateBuffer(2, share=1.0, capacity=50, seed=seed)
        for case in (0, 1):
            buffer.add_episode(episode(case, 50))
        found: dict[int, list[float]] = {0: [], 1: []}
        for _ in range(60):
            state = buffer.draw()
            assert state is not None
            found[int(state[-1])].append(float(state[1]))
        return {case: places[:20] for case, places in found.items()}

    first, second = drawn(0), drawn(1)
    assert first == drawn(0)
    assert first[0] != second[0]
    assert first[0] != first[1]


def test_goes_on_exactly_after_a_restore() -> None:
    buffer, other = CaseStartStateBuffer(3, seed=1, capacity=5), CaseStartStateBuffer(3, seed=9, capacity=5)
    buffer.add_episode(episode(1, 7))
    buffer.record_outcome(1, success=True)
    buffer.choose_case()
    other.restore(buffer.state())
    for one in (buffer, other):
        one.add_episode(episode(2, 3, value=4.0))
        one.record_outcome(0, success=True)
    for _ in range(50):
        assert buffer.choose_case() == other.choose_case()
        first, second = buffer.draw(), other.draw()
        assert (first is None) == (second is None)
        if first is not None:
            np.testing.assert_array_equal(first, second)


def filled() -> StartStateBuffer:
    buffer = StartStateBuffer()
    buffer.add_episode(np.zeros((2, 3)))
    return buffer


REFUSED: list[tuple[Callable[[], object], str]] = [
    (lambda: StartStateBuffer(share=1.5), r"between 0 and 1, got 1\.5"),
    (lambda: StartStateBuffer(capacity=0), "capacity must be at least 1"),
    (lambda: filled().add_episode(np.zeros((2, 4))), r"keeps states of 3 values, got 4.*another wire"),
    (lambda: filled().add_episode(np.zeros(3)), r"shape \(T, n\)"),
    (lambda: filled().add_episode(np.full((1, 3), np.nan)), "finite"),
    (lambda: StartStateBuffer(capacity=1).restore(filled().state()), "holds 2 states, more than the capacity of 1"),
]


@pytest.mark.parametrize(("call", "said"), REFUSED, ids=[said for _, said in REFUSED])
def test_refusals_say_why(call: Callable[[], object], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        call()
