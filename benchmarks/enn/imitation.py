"""Benchmark of learning from expert episodes: cost of behaviour cloning and of force prediction, and what they reach.

  python benchmarks/enn/imitation.py [--quick] [--expert policy.pt] [--phantom type_1] [--target lcca] [--episodes 100]

Without an expert only costs are measured, on episodes of a script. Prints a table and, as its last line, one JSON
object; times are CPU seconds of one thread:
    record_ms               a step of an episode with images, kept in memory
    clone_{thesis,desk}_ms  behaviour cloning, a sample and epoch
    force_{thesis,desk}_ms  force prediction from the image, a sample and epoch
    act_ms                  an action of the student for one observation
    clone_s, success_pct    with an expert: the desk variant's fit, and its success on held-out starts
"""

from __future__ import annotations

import argparse
import json
import os
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import torch

from cathsim import NavigateEnv
from enn.force.prediction import fit_force, force_preset
from enn.force.samples import force_samples
from enn.imitation.behaviour_cloning import clone, cloning_preset
from enn.imitation.cloned_policy import ClonedPolicy
from enn.imitation.dagger import record
from enn.policy import Policy
from enn.trajectory import Trajectory
from pipeline.seeds import expert_seeds, held_out_seeds


def environment(arguments: argparse.Namespace, keys: tuple[str, ...]) -> NavigateEnv:
    """The task with any rotation at the start."""
    return NavigateEnv(arguments.phantom, arguments.target, observation=keys, start_rotation=np.pi)


def scripted(count: int, arguments: argparse.Namespace) -> list[Trajectory]:
    """Episodes of a script that goes forwards and turns at random."""
    generator = np.random.default_rng(0)

    def steer(observation: Any, info: Any) -> np.ndarray:
        return np.array([1.0, generator.uniform(-1, 1)], np.float32)

    short = NavigateEnv(arguments.phantom, arguments.target, observation=("image",), max_steps=40)
    return [record(short, steer, seed=seed, keys=("image",)) for seed in range(count)]


def costs(arguments: argparse.Namespace) -> dict[str, float]:
    """What a step, a sample and an action cost."""
    began = time.process_time()
    episodes = scripted(10 if arguments.quick else 40, arguments)
    steps = sum(map(len, episodes))
    measured = {"record_ms": 1e3 * (time.process_time() - began) / steps}
    samples = force_samples(episodes)
    for variant in ("thesis", "desk"):
        preset = cloning_preset(variant)
        student, report = clone(episodes, replace(preset, fit=replace(preset.fit, epochs=2, validation_share=0.0)))
        measured[f"clone_{variant}_ms"] = 1e3 * report.cpu_s / (2 * report.samples)
        force = force_preset(variant)
        _, report = fit_force(samples, replace(force, fit=replace(force.fit, epochs=2)))
        measured[f"force_{variant}_ms"] = 1e3 * report.cpu_s / (2 * report.samples)
    seen = {"image": episodes[0].observations["image"][0]}
    began = time.process_time()
    for _ in range(100):
        student.act(seen)
    measured["act_ms"] = 1e3 * (time.process_time() - began) / 100
    return measured


def imitation(arguments: argparse.Namespace) -> dict[str, float]:
    """Clones an expert and tries the student."""
    expert = Policy.load(arguments.expert)
    keys = tuple(dict.fromkeys((*expert.keys, "image")))
    env = environment(arguments, keys)
    steers = expert.controller()
    episodes = [record(env, steers, seed=seed, keys=keys) for seed in expert_seeds(0, arguments.episodes)]
    features = [expert.features({key: one.observations[key] for key in expert.keys}) for one in episodes]
    began = time.process_time()
    student, _ = clone(episodes, expert_features=features)
    spent = time.process_time() - began
    return {"clone_s": spent, "success_pct": 100 * success(student, arguments, 10 if arguments.quick else 30)}


def success(student: ClonedPolicy, arguments: argparse.Namespace, count: int) -> float:
    """Share of held-out starts from which the target is reached."""
    env = environment(arguments, student.keys)
    steers = student.controller()
    return float(np.mean([record(env, steers, seed=seed, keys=()).terminated for seed in held_out_seeds(0, count)]))


def main() -> None:
    """Measures, prints a table and a line of JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="under 50 s")
    parser.add_argument("--expert", type=Path, help="a policy of enn.policy")
    parser.add_argument("--phantom", default="type_1")
    parser.add_argument("--target", default="lcca")
    parser.add_argument("--episodes", type=int, default=100)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    figures = costs(arguments)
    if arguments.expert is not None:
        figures |= imitation(arguments)
    for name, value in figures.items():
        print(f"{name:<18} {value:10.3f}")
    print(json.dumps({name: round(value, 4) for name, value in figures.items()}))


if __name__ == "__main__":
    main()
