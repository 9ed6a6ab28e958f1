"""The task of an episode of ArchVariety: its reward, ending and limits.

Source: Karstensen et al. 2024, "Learning-Based Autonomous Navigation, Benchmark Environments and Simulation Framework
for Endovascular Interventions", arXiv 2410.01956, and the settings published with it (github.com/lkarstensen,
repositories stEVE_bench and stEVE_training).
"""

from __future__ import annotations

from typing import Annotated

from annotated_types import Interval

from cathsim.navigation import NEAR, NavigationTask
from cathsim.validation import Count, Unit, settings

AT_TARGET, STEP_COST = 1.0, 0.005
PER_METRE = 1.0  # of progress along the lumen; published as 0.001 a millimetre
TRAINING_STEPS, TEST_STEPS = 150, 450  # 20 s and 60 s


@settings
class ArchVarietyTask(NavigationTask):
    """The tip within 5 mm of the target; the published reward.

    The reward of a step is 1 at the target, plus 1 per metre of progress along the lumen, less 0.005, and less what
    `force_penalty` and `path_penalty` take, which are 0 by default.
    """

    success_radius: Annotated[float, Interval(gt=0, le=NEAR), Unit("m")] = 0.005
    max_steps: Count = TEST_STEPS

    def step_reward(
        self, distance: float, progress: float, force: float, moved: float = 0.0, *, success: bool
    ) -> float:
        """Reward of one step; arguments as of `NavigationTask.step_reward`."""
        reward = (AT_TARGET if success else 0.0) + PER_METRE * progress - STEP_COST
        return self.penalised(reward, force, moved)
