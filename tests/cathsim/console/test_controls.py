"""The operator's axes; and the scores of the questionnaire."""

import numpy as np
import pytest

from cathsim.console.controls import SILENCE, ControlPanel, Controls
from cathsim.console.questionnaire import CRITERIA, mean_scores


class Clock:
    """A clock that stands still until it is moved."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def panel(clock: Clock) -> ControlPanel:
    return ControlPanel(clock)


def test_a_held_key_counts_at_every_step_and_a_tap_between_two_steps_once(panel: ControlPanel) -> None:
    panel.set(Controls(1.0, -0.5, 1))
    assert [panel.take().advance for _ in range(3)] == [1.0] * 3
    panel.set(Controls(0.0, 0.0, 2))
    assert panel.take() == Controls(sequence=2)
    assert not panel.touched
    panel.set(Controls(1.0, 0.0, 3))
    panel.set(Controls(0.0, 0.0, 4))
    assert panel.touched
    assert panel.take() == Controls(1.0, 0.0, 4)
    assert panel.take() == Controls(sequence=4)


def test_a_tap_of_one_device_counts_while_the_other_is_steered(panel: ControlPanel) -> None:
    panel.set(Controls(1.0, 0.0, 1, -0.5, 0.0))
    panel.set(Controls(1.0, 0.0, 2))
    assert panel.take() == Controls(1.0, 0.0, 2, -0.5, 0.0)
    assert panel.take() == Controls(1.0, 0.0, 2)
    panel.set(Controls(0.0, 0.0, 3, 0.0, 1.0))
    panel.take()
    panel.set(Controls(0.0, 0.25, 4, 0.0, 1.0))
    panel.set(Controls(0.0, 0.0, 5, 0.0, 1.0))
    assert panel.take() == Controls(0.0, 0.25, 5, 0.0, 1.0)
    panel.set(Controls(sequence=6, catheter_rotate=1.0))
    panel.release()
    assert panel.take() == Controls(sequence=6)


def test_silence_lets_go(panel: ControlPanel, clock: Clock) -> None:
    panel.set(Controls(1.0, 0.0, 1))
    clock.now += 0.9 * SILENCE
    assert panel.take().pressed
    clock.now += 0.2 * SILENCE
    assert not panel.take().pressed
    panel.set(Controls(1.0, 0.0, 1))
    assert panel.take().pressed


def test_axes_are_clipped_and_must_be_numbers() -> None:
    assert Controls(3.0, -7.0) == Controls(1.0, -1.0)
    for wrong in (float("nan"), float("inf"), "1", None, True):
        with pytest.raises(ValueError, match="advance must be a number from -1 to 1"):
            Controls(wrong)  # type: ignore[arg-type]
    assert Controls(catheter_advance=-2.0).catheter == (-1.0, 0.0)
    with pytest.raises(ValueError, match="catheter_rotate must be a number from -1 to 1, got nan"):
        Controls(catheter_rotate=float("nan"))
    with pytest.raises(ValueError, match="sequence must be a whole number"):
        Controls(1.0, 0.0, 1.5)  # type: ignore[arg-type]


def test_scores_are_means_over_participants_and_nothing_without_answers() -> None:
    low, high = ({criterion.key: score for criterion in CRITERIA} for score in (2, 4))
    answers = [
        {**low, "participant": "P1"}, {**high, "participant": "P1"},
        {**low, "participant": ""}, {**low, "participant": ""},
    ]  # fmt: skip
    table = mean_scores(answers)
    assert len(table) == 7
    assert table["motion_accuracy"]["n"] == 3, "P1 counts once, with the last answers"
    assert table["motion_accuracy"]["score"] == pytest.approx([8 / 3, np.std([4, 2, 2])])
    assert mean_scores([]) == {}
