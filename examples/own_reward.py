"""A reward and a target of your own: any function of the step, any point of the lumen.

python examples/own_reward.py
"""

from __future__ import annotations

import numpy as np
from stable_baselines3 import SAC

from cathsim import NavigateEnv, load_phantom
from cathsim.robot.pace import Pace


def gentle_progress(info: dict) -> float:
    """Pay for progress along the lumen (m), charge for contact force (N) and for turning."""
    return 100.0 * info["progress"] - 2.0 * info["force"] - 0.01 * abs(info["action"][1])


def main(decisions: int = 3000) -> float:
    """Train SAC towards a point in the left subclavian artery; give the distance that is left, m."""
    phantom = load_phantom("type_1")
    target = phantom.tree["lsa"].point_at(phantom.targets["lsa"].arc + 0.01)  # m, 10 mm beyond the named target
    env = NavigateEnv(
        phantom,
        target,
        reward=gentle_progress,
        observation=("tip", "feeder", "goal"),
        success_radius=0.005,
        pace=Pace(interval=0.2, translation=0.005, rotation=np.radians(45)),  # s, m, rad a decision
        max_steps=60,
    )
    model = SAC("MultiInputPolicy", env, learning_starts=min(500, decisions), gamma=0.95, seed=0).learn(decisions)
    observation, info = env.reset(seed=1)
    ended = False
    while not ended:
        observation, _, terminated, truncated, info = env.step(model.predict(observation, deterministic=True)[0])
        ended = terminated or truncated
    print(f"{1e3 * info['distance']:.1f} mm from {np.round(1e3 * target, 1)} mm")
    return info["distance"]


if __name__ == "__main__":
    main()
