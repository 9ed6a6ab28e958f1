"""The published reward and limits of ArchVariety."""

import pytest

from cathsim.arch_variety import ArchVarietyTask


def test_reward_is_the_published_one() -> None:
    task = ArchVarietyTask()
    assert (task.success_radius, task.max_steps) == (0.005, 450)
    assert task.step_reward(0.1, 0.004, 0.3, success=False) == pytest.approx(0.001 * 4 - 0.005)
    assert task.step_reward(0.004, 0.004, 0.3, success=True) == pytest.approx(1.0 + 0.001 * 4 - 0.005)
    assert ArchVarietyTask(force_penalty=2.0).step_reward(0.1, 0.0, 0.3, success=False) == pytest.approx(-0.605)
    assert task.reads_progress
