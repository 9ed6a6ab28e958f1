"""Entropy weight of the thesis's SAC: fixed at 1, or learnt from 1 on, beside the thesis's reward.

    python benchmarks/enn/entropy.py [--decisions 20000] [--seeds 3]

A point is steered within a square of 12 cm to a target in its middle, with the thesis's reward (minus the distance in
metres, 10 at the target), discount and learning rate, and two actions as the feeder has. Prints a row a training,
and one JSON object as its last line.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import time
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import gymnasium
import numpy as np

from enn.reinforcement.training import THESIS_SAC, Training

HALF_SIDE, STEP, REACH = 0.06, 0.004, 0.008  # m: half the square, an action of 1, the thesis's success radius
MAX_STEPS = 100
EPISODES = 30
WEIGHTS: tuple[str | float, ...] = (1.0, "auto_1.0")


class Square(gymnasium.Env[Any, Any]):
    """A point that is to reach the middle of a square, for the thesis's reward."""

    observation_space = gymnasium.spaces.Dict({"place": gymnasium.spaces.Box(-1, 1, (2,), np.float32)})
    action_space = gymnasium.spaces.Box(-1, 1, (2,), np.float32)

    def __init__(self) -> None:
        self.place, self.steps = np.zeros(2), 0

    def _observe(self) -> dict[str, np.ndarray]:
        return {"place": (self.place / HALF_SIDE).astype(np.float32)}

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        angle = self.np_random.uniform(0, 2 * np.pi)
        self.place, self.steps = 0.05 * np.array([np.cos(angle), np.sin(angle)]), 0
        return self._observe(), {"tip": np.append(self.place, 0.0)}

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.place = np.clip(self.place + STEP * np.asarray(action, float), -HALF_SIDE, HALF_SIDE)
        self.steps += 1
        distance = float(np.linalg.norm(self.place))
        success = distance < REACH
        info = {"tip": np.append(self.place, 0.0), "force": 0.0, "success": success}
        reward = 10.0 if success else -distance
        return self._observe(), reward, success, not success and self.steps >= MAX_STEPS, info


def measure(weight: str | float, seed: int, decisions: int) -> dict[str, Any]:
    """Trains once.

    Args:
        weight: of the entropy.
        seed: of the training.
        decisions: its budget.

    Returns:
        Success of deterministic and stochastic episodes, mean steps of the deterministic ones, and the last policy's
        standard deviations before the tanh.
    """
    settings = dataclasses.replace(
        THESIS_SAC,
        extractor="vectors",
        variant="desk",
        hidden=(64, 64),  # a small task
        batch_size=128,
        ent_coef=weight,
        decisions=decisions,
        buffer_size=decisions,
        evaluate_every=0,  # the last policy
    )
    began = time.process_time()
    policy = Training(settings, Square, seed=seed).run().policy
    spent = time.process_time() - began
    environment = Square()
    measured: dict[str, Any] = {"ent_coef": weight, "seed": seed, "cpu_s": round(spent, 1)}
    for mode, deterministic in (("deterministic", True), ("stochastic", False)):
        reached, steps = 0, []
        for episode in range(EPISODES):
            controller = policy.controller(deterministic, seed=episode)
            observation, info = environment.reset(seed=1_000 + episode)
            ended = terminated = False
            while not ended:
                observation, _, terminated, truncated, info = environment.step(controller(observation, info))
                ended = terminated or truncated
            reached += terminated
            steps.append(environment.steps)
        measured[f"{mode}_success_pct"] = round(100 * reached / EPISODES, 1)
        measured[f"{mode}_steps"] = round(float(np.mean(steps)), 1)
    return measured


def main() -> None:
    """Measures both weights."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--decisions", type=int, default=20_000)
    parser.add_argument("--seeds", type=int, default=3)
    given = parser.parse_args()
    rows = []
    for weight in WEIGHTS:
        for seed in range(given.seeds):
            rows.append(measure(weight, seed, given.decisions))
            print(", ".join(f"{name} {value}" for name, value in rows[-1].items()), flush=True)
    print(json.dumps({"decisions": given.decisions, "episodes": EPISODES, "trainings": rows}))


if __name__ == "__main__":
    main()
