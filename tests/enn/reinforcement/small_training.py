"""A training of the toy environment that takes about a second, and demonstrations of it."""

import dataclasses
from typing import Any

import numpy as np

from enn.reinforcement.training import DESK_SAC
from enn.trajectory import Trajectory

SMALL = dataclasses.replace(
    DESK_SAC,
    action_repeat=1,
    decisions=900,
    hidden=(32, 32),
    critic_layer_norm=False,
    final_learning_rate=1.0,
    batch_size=32,
    learning_starts=200,
    gradient_steps=0.5,
    evaluate_every=300,
    stop_after=2,
    evaluation_episodes=5,
    curve_every=100,
    buffer_size=2000,
)


def demonstrated(point_env: Any) -> list[Trajectory]:
    """Three episodes straight to the target."""
    env, trajectories = point_env(), []
    for seed in range(3):
        observation, info = env.reset(seed=seed)
        seen, tips, states, actions, rewards = [observation], [info["tip"]], [env.start_state()], [], []
        terminated = False
        while not terminated:
            action = np.clip(-observation["place"] / 0.15, -1, 1)
            observation, reward, terminated, _, info = env.step(action)
            for items, item in ((seen, observation), (tips, info["tip"]), (states, env.start_state())):
                items.append(item)
            actions.append(action)
            rewards.append(reward)
        places = {"place": np.stack([one["place"] for one in seen])}
        trajectories.append(
            Trajectory(
                places,
                np.stack(actions),
                np.array(rewards),
                True,
                np.zeros(len(actions)),
                np.stack(tips),
                np.stack(states),
            )
        )
    return trajectories
