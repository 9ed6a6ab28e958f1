"""Benchmark of reinforcement learning: decisions a second, where the time goes, and the replay buffer's memory.

    python benchmarks/enn/training.py [--quick]

Prints tables, and one JSON object as its last line. Times are CPU milliseconds of one core, since other work may run
beside.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import gymnasium
import numpy as np
import torch
from stable_baselines3 import SAC
from stable_baselines3.common.buffers import DictReplayBuffer

from enn.reinforcement.replay import ReplayBuffer, nbytes_needed
from enn.reinforcement.soft_actor_critic import SacLearner
from enn.reinforcement.start_state_buffer import StartStateBuffer
from enn.reinforcement.training.settings import DESK_SAC
from enn.reinforcement.training.training import Training
from enn.reinforcement.vector_envs import SampledEnvs

FEATURES = 64


class Features(gymnasium.Env[Any, Any]):
    """Costs nothing: 64 random features, as an encoder would give them."""

    observation_space = gymnasium.spaces.Dict(
        {"features": gymnasium.spaces.Box(-np.inf, np.inf, (FEATURES,), np.float32)}
    )
    action_space = gymnasium.spaces.Box(-1, 1, (2,), np.float32)

    def _observe(self) -> dict[str, np.ndarray]:
        return {"features": self.np_random.standard_normal(FEATURES, np.float32)}

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        return self._observe(), {}

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        return self._observe(), 0.1, False, self.np_random.random() < 0.01, {}


def navigate(observation: tuple[str, ...] = ("feeder", "shape")) -> gymnasium.Env[Any, Any]:
    """The task that policies are trained on."""
    return gymnasium.make(
        "cathsim:cathsim/Navigate-v0",
        observation=observation,
        reward="geodesic",
        success_radius=0.008,
        start_jitter=0.001,
        start_rotation=np.pi,
        disable_env_checker=True,
    )


def cpu_ms(work: Callable[[], Any], repetitions: int) -> float:
    """Mean CPU time of a call, ms."""
    work()
    began = time.process_time()
    for _ in range(repetitions):
        work()
    return 1000 * (time.process_time() - began) / repetitions


def updates(quick: bool) -> dict[str, float]:
    """One update of batch 128 with two layers of 128, ours and the library's; and what surrounds it."""
    envs = SampledEnvs([Features] * 8, seed=0)
    settings = dataclasses.replace(DESK_SAC, action_repeat=1)
    learner = SacLearner(settings, envs, 0)
    observations = envs.reset()

    def decide(explore: bool = True) -> None:
        nonlocal observations
        actions = learner.act(observations, explore=explore)
        after, rewards, dones, infos = envs.step(actions)
        learner.observe(observations, rewards, dones, after, infos, explore=explore)
        observations = after

    for _ in range(200):
        decide()
    library = SAC(
        "MultiInputPolicy",
        envs,
        batch_size=128,
        ent_coef="auto_0.05",
        learning_starts=0,
        policy_kwargs={"net_arch": [128, 128]},
        device="cpu",
    )
    library.learn(8)
    assert library.replay_buffer is not None
    for _ in range(200):
        library.replay_buffer.add(
            observations, observations, np.zeros((8, 2)), np.zeros(8), np.zeros(8), [{} for _ in range(8)]
        )
    rounds, times = (3 if quick else 10), {"library": [], "ours": []}  # type: ignore[var-annotated]
    for _ in range(rounds):  # in turns, so that other work on the machine meets both
        times["library"].append(cpu_ms(lambda: library.train(20, 128), 1) / 20)
        times["ours"].append(cpu_ms(lambda: learner.model.train(20, 128), 1) / 20)
    return {
        "update_library_ms": float(np.median(times["library"])),
        "update_ms": float(np.median(times["ours"])),
        "sampling_overhead_ms": cpu_ms(lambda: decide(False), 200) / 8,
        "batch_draw_ms": cpu_ms(lambda: learner.replay.sample(128), 200),
    }


def simulation(quick: bool) -> dict[str, float]:
    """A step of the simulator inside the sampler, random actions, with the cost of recording for the buffer."""
    result = {}
    for name, buffer in (("step_ms", None), ("step_with_buffer_ms", StartStateBuffer(0.5))):
        envs = SampledEnvs([navigate] * 4, seed=0, start_state_buffer=buffer)
        envs.reset()
        generator = np.random.default_rng(0)
        forwards = np.array([0.7, 0.0])
        count = 100 if quick else 400
        result[name] = cpu_ms(lambda: envs.step(forwards + 0.3 * generator.uniform(-1, 1, (4, 2))), count) / 4  # noqa: B023
        envs.close()
    return result


def training(quick: bool) -> dict[str, float]:
    """A whole training on the simulator without evaluation, for repeat 1 and 3, with checkpoints."""
    result = {}
    for repeat in (1, 3):
        settings = dataclasses.replace(
            DESK_SAC, action_repeat=repeat, decisions=1000 if quick else 3000, evaluate_every=0, checkpoint_seconds=5.0
        )
        with tempfile.TemporaryDirectory() as folder:
            timings = Training(settings, navigate, Path(folder), seed=0).run().timings
        wall = timings["wall_s"]
        result |= {
            f"decision_ms_repeat_{repeat}": 1000 * timings["cpu_s"] / timings["decisions"],
            f"decisions_per_s_repeat_{repeat}": timings["decisions"] / wall,
            f"share_simulation_repeat_{repeat}": timings["simulation_s"] / wall,
            f"share_update_repeat_{repeat}": timings["update_s"] / wall,
        }
    return result


def memory(quick: bool) -> dict[str, float]:
    """Bytes of image, mask and 336 joint values, and how fast they are drawn and saved."""
    box = gymnasium.spaces.Box
    space = gymnasium.spaces.Dict(
        {
            "image": box(0, 255, (1, 80, 80), np.uint8),
            "joints": box(-np.inf, np.inf, (336,), np.float32),
            "mask": box(0, 255, (1, 80, 80), np.uint8),
        }
    )
    actions = box(-1, 1, (2,), np.float32)
    size = 4000 if quick else 20_000
    mine, theirs = ReplayBuffer(size, space, actions, n_envs=8), DictReplayBuffer(size, space, actions, n_envs=8)
    there = sum(array.nbytes for side in (theirs.observations, theirs.next_observations) for array in side.values())
    generator = np.random.default_rng(0)
    moment = {
        "image": generator.integers(0, 256, (8, 1, 80, 80), np.uint8),
        "joints": generator.standard_normal((8, 336)).astype(np.float32),
        "mask": generator.integers(0, 2, (8, 1, 80, 80), np.uint8) * np.uint8(255),
    }
    infos = [{} for _ in range(8)]  # type: ignore[var-annotated]

    def add(buffer: Any) -> None:
        buffer.add(moment, moment, np.zeros((8, 2)), np.zeros(8), np.zeros(8, bool), infos)

    for _ in range(size // 8):
        add(mine)
        add(theirs)
    from enn.reinforcement.checkpoint import CheckpointFolder

    with tempfile.TemporaryDirectory() as folder:
        checkpoint = CheckpointFolder(Path(folder), {})
        began = time.perf_counter()
        checkpoint.write(mine.state(), mine.chunks())
        first = time.perf_counter() - began
        for _ in range(50):
            add(mine)
        began = time.perf_counter()
        checkpoint.write(mine.state(), mine.chunks())
        again = time.perf_counter() - began
    return {
        "replay_gb_per_million": nbytes_needed(space, 1_000_000) / 1e9,
        "replay_half_gb_per_million": nbytes_needed(space, 1_000_000, half=True) / 1e9,
        "replay_library_gb_per_million": there / size * 1e6 / 1e9,
        "image_add_ms": cpu_ms(lambda: add(mine), 200) / 8,
        "image_add_library_ms": cpu_ms(lambda: add(theirs), 200) / 8,
        "image_draw_256_ms": cpu_ms(lambda: mine.sample(256), 30),
        "image_draw_256_library_ms": cpu_ms(lambda: theirs.sample(256), 30),
        "checkpoint_s_per_gb": first / (mine.nbytes / 1e9),
        "checkpoint_again_s": again,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])  # type: ignore[union-attr]
    parser.add_argument("--quick", action="store_true", help="under 50 s")
    quick = parser.parse_args().quick
    torch.set_num_threads(1)
    figures: dict[str, float] = {}
    for title, part in (
        ("an update of SAC (batch 128, two layers of 128, 64 features)", updates),
        ("the simulator, sampled", simulation),
        ("a training on the simulator, one update a decision, 8 environments", training),
        ("replay memory: image and mask of 80 px, 336 joint values", memory),
    ):
        found = part(quick)
        print(f"\n{title}")
        for name, value in found.items():
            print(f"  {name:32s} {value:10.3f}")
        figures |= found
    print(json.dumps({name: round(value, 4) for name, value in figures.items()}))


if __name__ == "__main__":
    main()
