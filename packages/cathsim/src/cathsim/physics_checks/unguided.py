"""Runs of an environment without an operator: its speed, and the contact forces of a wire that is only pushed."""

from __future__ import annotations

import time
from collections.abc import Mapping

import numpy as np

from cathsim.environment import NavigateEnv

_FORWARD_STEPS = 120  # about the length of a successful episode


def pushed_forces(phantom: str, steps: int, *, seed: int) -> np.ndarray:
    """Contact forces of the wire when it is fed at full speed with random rotation.

    Returns:
        (steps,) N, largest resultant of each step.
    """
    environment = NavigateEnv(phantom, observation="tip")
    generator = np.random.default_rng(seed)
    forces = []
    environment.reset(seed=seed)
    for step in range(steps):
        _, _, terminated, truncated, info = environment.step(np.array([1.0, generator.uniform(-1.0, 1.0)]))
        forces.append(info["force"])
        if terminated or truncated or (step + 1) % _FORWARD_STEPS == 0:
            environment.reset()
    return np.array(forces)


def steps_per_second(environment: NavigateEnv, steps: int, *, seed: int) -> float:
    """Steps a second of processor time: half with random actions, half forwards with random rotation; resets count.

    Args:
        environment: of one device or two, with the actions of the feeders; two go forwards together.
    """
    generator = np.random.default_rng(seed)
    spent, done = 0.0, 0
    for forward in (False, True):
        actions = generator.uniform(-1.0, 1.0, (max(steps // 2, 1), *environment.feeders.shape))
        if forward:
            actions[:, ::2] = 1.0
        environment.reset(seed=seed)
        start, count = time.process_time(), 0
        for action in actions:
            _, _, terminated, truncated, _ = environment.step(action)
            count += 1
            if terminated or truncated or (forward and count >= _FORWARD_STEPS):
                environment.reset()
                count = 0
        spent += time.process_time() - start
        done += len(actions)
    return done / max(spent, 1e-9)


def median_speeds(
    phantom: str, observations: Mapping[str, str | tuple[str, ...]], steps: int, *, rounds: int, seed: int
) -> dict[str, float]:
    """Measures the environment with several observations in turns, so that a busy spell slows all of them.

    Args:
        observations: a name to what the environment is asked for.

    Returns:
        The name to the median of `steps_per_second` over the rounds.
    """
    environments = {name: NavigateEnv(phantom, observation=observation) for name, observation in observations.items()}
    rates: dict[str, list[float]] = {name: [] for name in environments}
    for index in range(rounds):
        for name, environment in environments.items():
            rates[name].append(steps_per_second(environment, steps, seed=seed + index))
    return {name: float(np.median(values)) for name, values in rates.items()}
