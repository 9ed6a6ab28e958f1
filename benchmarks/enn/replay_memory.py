"""Memory of the thesis's replay buffers on the simulator's own observations, and what drawing from them costs.

    python benchmarks/enn/replay_memory.py [--transitions 800] [--phantom type_1]

Fills a buffer with episodes of random forward pushing for every set of observations that `budget=thesis` trains on, and
prints what a transition takes there, what that comes to for a million, CPU milliseconds of a batch of 256, and CPU
microseconds that a transition's storing and a transition's share of a checkpoint cost. Its last line is a JSON object.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import gymnasium
import numpy as np

from enn.networks.features import modality_keys
from enn.reinforcement.replay import ReplayBuffer, nbytes_needed

BATCH, DRAWS, MILLION = 256, 20, 1_000_000
# What the stages baselines and enn see: names of observations, side of the images, actions, steps of an episode.
CELLS: dict[str, tuple[tuple[str, ...], int, str, int]] = {
    **{f"baselines {name}": ((name,), 128, "tip_motors", 2000) for name in ("internal", "image", "sequential")},
    **{f"enn {name}": (modality_keys(name), 80, "feeder", 300) for name in ("I", "V", "V+M", "I+V", "I+V+M")},
}


def measure(cell: str, transitions: int, phantom: str) -> dict[str, Any]:
    """Fills a buffer and draws from it.

    Args:
        cell: of `CELLS`.
        transitions: to fill it with.
        phantom: name of the anatomy.

    Returns:
        Bytes a transition, foretold and taken; times.
    """
    keys, side, actions, steps = CELLS[cell]
    env: Any = gymnasium.make(
        "cathsim:cathsim/Navigate-v0", phantom=phantom, target="lcca", observation=keys, image_size=side,
        wire="thesis", actions=actions, max_steps=steps, contact_info=False, disable_env_checker=True,
    )  # fmt: skip
    assert isinstance(env.observation_space, gymnasium.spaces.Dict)
    foretold = nbytes_needed(env.observation_space, MILLION, env.action_space) / MILLION
    buffer = ReplayBuffer(transitions, env.observation_space, env.action_space)
    generator, storing, push = np.random.default_rng(0), 0.0, np.zeros(env.action_space.shape, np.float32)
    seen, _ = env.reset(seed=0)
    for number in range(transitions):
        if number % 20 == 0:
            push = generator.uniform(-0.5, 1.0, env.action_space.shape).astype(np.float32)
        action = np.clip(push + 0.3 * generator.standard_normal(push.shape), -1, 1).astype(np.float32)
        after, reward, terminated, truncated, _ = env.step(action)
        done = bool(terminated or truncated)
        began = time.process_time()
        buffer.add(
            {key: seen[key][None] for key in seen}, {key: after[key][None] for key in after}, action[None],
            np.array([reward]), np.array([done]), [{}],
        )  # fmt: skip
        storing += time.process_time() - began
        seen = env.reset()[0] if done else after
    env.close()
    taken = buffer.nbytes / transitions
    began = time.process_time()
    for _ in range(DRAWS):
        buffer.sample(BATCH)
    drawing = (time.process_time() - began) / DRAWS
    began = time.process_time()
    saved = sum(array.nbytes for _, _, array in buffer.chunks())
    packing = (time.process_time() - began) / transitions
    return {
        "cell": cell,
        "foretold_bytes": round(foretold),
        "taken_bytes": round(taken),
        "million_gb": round(taken * MILLION / 1e9, 2),
        "batch_ms": round(1e3 * drawing, 1),
        "store_us": round(1e6 * storing / transitions, 1),
        "checkpoint_us": round(1e6 * packing, 2),
        "checkpoint_bytes": round(saved / transitions),
    }


def main() -> None:
    """Measures every cell."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--transitions", type=int, default=800)
    parser.add_argument("--phantom", default="type_1")
    given = parser.parse_args()
    rows = []
    for cell in CELLS:
        rows.append(measure(cell, given.transitions, given.phantom))
        print(", ".join(f"{name} {value}" for name, value in rows[-1].items()), flush=True)
    print(json.dumps({"phantom": given.phantom, "transitions": given.transitions, "cells": rows}))


if __name__ == "__main__":
    main()
