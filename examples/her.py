"""Hindsight experience replay on the goal-conditioned environment, with Stable-Baselines3: minutes on one core.

    python examples/her.py [--steps 20000] [--seed 0] [--without-her]

The sheath ends below the arch. A goal is any point of a branch; the policy sees the tip, the feeder and the goal.
"""

from __future__ import annotations

import argparse

import gymnasium
import numpy as np
import torch
from stable_baselines3 import SAC, HerReplayBuffer
from stable_baselines3.common.callbacks import BaseCallback, EveryNTimesteps

from cathsim import load_phantom
from cathsim.presets import Pace

HELD_OUT = range(10_000, 10_050)  # seeds of the goals of evaluation


def make_env() -> gymnasium.Env:
    """Make the environment: 50 decisions an episode, each of 5 mm and 45 degrees at most."""
    phantom = load_phantom("type_1")
    return gymnasium.make(
        "cathsim:cathsim/NavigateGoal-v0",
        phantom=phantom,
        entry=phantom.tree.root.point_at(0.2),  # m along the aorta
        observation=("tip", "feeder"),
        accuracy="fast",
        pace=Pace(interval=0.2, translation=0.005, rotation=np.radians(45)),
        max_steps=50,
        start_rotation=np.pi,
    )


class Spoken(BaseCallback):
    """Says how far the training is."""

    def _on_step(self) -> bool:
        print(f"{self.num_timesteps} steps made", flush=True)
        return True


def successes(model: SAC, env: gymnasium.Env) -> int:
    """Count the held-out goals that the policy reaches."""
    reached = 0
    for seed in HELD_OUT:
        observation, info = env.reset(seed=seed)
        ended = False
        while not ended:
            action = model.predict(observation, deterministic=True)[0]
            observation, _, terminated, truncated, info = env.step(action)
            ended = terminated or truncated
        reached += info["is_success"]
    return reached


def main(steps: int, seed: int, *, her: bool = True) -> tuple[int, int]:
    """Train; give the goals reached before and after."""
    torch.set_num_threads(1)
    env = make_env()
    model = SAC(
        "MultiInputPolicy",
        env,
        replay_buffer_class=HerReplayBuffer if her else None,
        learning_starts=500,
        train_freq=2,
        learning_rate=1e-3,
        gamma=0.95,
        policy_kwargs={"net_arch": [64, 64]},
        seed=seed,
    )
    before = successes(model, make_env())
    print(f"{before} of {len(HELD_OUT)} goals reached before the training", flush=True)
    model.learn(steps, callback=EveryNTimesteps(2_000, Spoken()))
    return before, successes(model, make_env())


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--without-her", action="store_true")
    given = parser.parse_args()
    first, last = main(given.steps, given.seed, her=not given.without_her)
    print(f"goals reached: {first} of {len(HELD_OUT)} before, {last} after {given.steps} steps")
