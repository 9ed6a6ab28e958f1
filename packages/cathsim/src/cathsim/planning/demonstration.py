"""Demonstrations of the sampling expert in an environment over many anatomies, as the arrays that a learner reads."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from cathsim.many_anatomies import NavigateManyEnv
from cathsim.planning.plan_trials import TWO_DEVICES, ExpertSettings
from cathsim.planning.sampling import SamplingExpert

ROLLOUTS = 1200  # of the expert with a wire alone, after which a demonstration counts as failed
GENTLE_FORCE, GENTLE_COST = 0.4, 0.02  # N, m/N: of `ExpertSettings`


def demonstrate(
    environment: NavigateManyEnv,
    case: int,
    keys: Sequence[str],
    *,
    hold: int,
    seed: int,
    rollouts: float = ROLLOUTS,
    steps: float = math.inf,
    gentle: bool = False,
    tick: Callable[[], None] = lambda: None,
) -> dict[str, np.ndarray]:
    """One episode of the sampling expert.

    Args:
        hold: steps for which an action is held.
        seed: of the start and of the expert.
        rollouts: of the expert, after which the episode ends.
        steps: control steps of all roll-outs and manoeuvres, after which it ends.
        gentle: presses with at most 0.4 N where it can, and takes longer ways for it: what learns from it presses less.
        tick: called after every step.

    Returns:
        The arrays of a trajectory: observations by their names, actions, rewards, forces, tips, states, terminated.
    """
    observation, _ = environment.reset(seed=seed, options={"case": case})
    usual = TWO_DEVICES if environment.action_space.shape == (4,) else ExpertSettings()
    settings = dataclasses.replace(usual, horizon=5 * hold, hold=hold, execute=hold)
    if gentle:
        settings = dataclasses.replace(settings, most_force=GENTLE_FORCE, force_cost=GENTLE_COST)
    expert = SamplingExpert(environment.current, seed=seed, threads=1, settings=settings)
    rows: dict[str, list[Any]] = {
        **{key: [observation[key]] for key in keys},
        "tips": [environment.simulation.tip.copy()],
        "states": [environment.start_state()],
        "actions": [],
        "rewards": [],
        "forces": [],
    }
    terminated = truncated = False
    while not (terminated or truncated) and expert.rollouts < rollouts and expert.steps < steps:
        action = expert.action()
        observation, reward, terminated, truncated, info = environment.step(action)
        for key in keys:
            rows[key].append(observation[key])
        rows["tips"].append(environment.simulation.tip.copy())
        rows["states"].append(environment.start_state())
        rows["actions"].append(action)
        rows["rewards"].append(reward)
        rows["forces"].append(info["force"])
        tick()
    expert.close()
    return {**{name: np.array(values) for name, values in rows.items()}, "terminated": np.array(terminated)}
