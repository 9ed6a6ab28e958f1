"""Scores of the questionnaire: means over participants, each of whom counts once."""

from __future__ import annotations

import numpy as np
import pytest

from cathsim.console.questionnaire import CRITERIA, mean_scores


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
