"""A reward and a target of your own: any function of the step, any point of the lumen. A minute on one core.

python examples/own_reward.py
"""

from __future__ import annotations

import numpy as np
import torch
from stable_baselines3 import SAC

from cathsim import NavigateEnv, load_phantom
from cathsim.presets import Pace

SUCCESS_RADIUS = 0.008  # m


def gentle_progress(info: dict) -> float:
    """Pay for progress along the lumen (m), charge for contact force (N) and for turning."""
    return 100.0 * info["progress"] - 2.0 * info["force"] - 0.01 * abs(info["action"][1])


def make_env() -> NavigateEnv:
    """Make the environment: 50 decisions an episode, from below the arch to a point of the brachiocephalic artery."""
    phantom = load_phantom("type_1")
    return NavigateEnv(
        phantom,
        phantom.tree["bca"].point_at(phantom.targets["bca"].arc - 0.01),  # m, 10 mm before the named target
        entry=phantom.tree.root.point_at(0.2),  # m along the aorta
        reward=gentle_progress,
        observation=("tip", "feeder", "goal"),
        success_radius=SUCCESS_RADIUS,
        accuracy="fast",
        pace=Pace(interval=0.2, translation=0.005, rotation=np.radians(45)),  # s, m, rad a decision
        max_steps=50,
    )


def final_distance(model: SAC, env: NavigateEnv) -> float:
    """Steer an episode by the policy's best actions; give the distance that is left, m."""
    observation, info = env.reset(seed=1)
    ended = False
    while not ended:
        observation, _, terminated, truncated, info = env.step(model.predict(observation, deterministic=True)[0])
        ended = terminated or truncated
    return info["distance"]


def main(decisions: int = 3000) -> float:
    """Train SAC; give the distance that is left, m."""
    torch.set_num_threads(1)
    model = SAC(
        "MultiInputPolicy",
        make_env(),
        learning_starts=500,
        learning_rate=1e-3,
        gamma=0.95,
        policy_kwargs={"net_arch": [64, 64]},
        seed=0,
    )
    for done in range(0, decisions, 500):
        model.learn(min(500, decisions - done), reset_num_timesteps=False)
        left = final_distance(model, make_env())
        print(f"after {model.num_timesteps} decisions the tip ends {1e3 * left:.1f} mm from the target", flush=True)
        if left <= SUCCESS_RADIUS:
            print("the target is reached")
            break
    return left


if __name__ == "__main__":
    main()
