"""Benchmark of updates beside the simulation: its environments in a thread of the same process, or in one of their own.

    python benchmarks/enn/envs_apart.py [--quick]

A rehearsal's environments and updates, from the shipped policy of a JB2, in copies of a random arch. Both kinds take
turns; prints the wall time of a decision of all environments with its updates, ms, as one JSON object.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import statistics
import time
from dataclasses import replace
from functools import partial
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import gymnasium
import torch

import enn
from cathsim import load_guidewire
from enn.reinforcement.envs_apart import EnvsApart
from enn.reinforcement.rehearsal import REHEARSAL, starting_from
from enn.reinforcement.sampling import SampledEnvs
from enn.reinforcement.soft_actor_critic import SacLearner

POLICY, SEED = "generalist_jb2", 0
KINDS: dict[str, Any] = {"thread": partial(SampledEnvs, threads=2), "process": partial(EnvsApart, threads=1)}
COPIES: dict[str, Any] = {
    "phantom": "random",
    "phantom_seed": 44_003,
    "targets": ("lcca",),
    "copies": tuple(range(1, 17)),
    "max_steps": 400,
    "catheter": "jb2_4f",
    "observation": ("roadmap", "history"),
    "reward": "geodesic",
    "observe_every": 3,
}


def environment() -> gymnasium.Env[Any, Any]:
    """Copies of the arch."""
    wire = load_guidewire("radifocus_angled_025").scaled(0.48)
    return gymnasium.make("cathsim:cathsim/NavigateCopies-v0", wire=wire, disable_env_checker=True, **COPIES)


class Turns:
    """A learner and its environments of one kind."""

    def __init__(self, kind: str) -> None:
        policy = enn.load(POLICY)
        settings = starting_from(replace(REHEARSAL, action_repeat=policy.action_repeat), policy)
        factories = [environment] * settings.n_envs
        self.envs = KINDS[kind](factories, seed=SEED, action_repeat=policy.action_repeat)
        self.learner = SacLearner(settings, self.envs, SEED)
        self.learner.start_from(policy.module.state_dict(), policy.metadata)
        self.observations, self.began = self.envs.reset(), False

    def play(self, rounds: int) -> float:
        """Wall time of a decision of all environments with its updates, ms."""
        began = time.perf_counter()
        for _ in range(rounds):
            self.envs.step_async(self.learner.act(self.observations, explore=False))
            self.learner.update(explore=not self.began)
            after, rewards, dones, infos = self.envs.step_wait()
            self.learner.observe(self.observations, rewards, dones, after, infos, explore=False)
            self.observations, self.began = after, True
        return 1000 * (time.perf_counter() - began) / rounds


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="fewer decisions, less than a minute")
    quick = parser.parse_args().quick
    turns, rounds = (2, 20) if quick else (5, 100)
    torch.set_num_threads(1)
    measured: dict[str, list[float]] = {kind: [] for kind in KINDS}
    with contextlib.ExitStack() as stack:
        players = {kind: Turns(kind) for kind in KINDS}
        for player in players.values():
            stack.callback(player.envs.close)
            player.play(rounds)  # simulations are built on the way
        for _ in range(turns):
            for kind, player in players.items():
                measured[kind].append(player.play(rounds))
    ratios = [one / other for one, other in zip(measured["process"], measured["thread"], strict=True)]
    figures: dict[str, Any] = {f"{kind}_ms": round(statistics.median(times), 1) for kind, times in measured.items()}
    figures |= {"ratio": round(statistics.median(ratios), 2), "ratios": [round(ratio, 2) for ratio in ratios]}
    print(json.dumps(figures))


if __name__ == "__main__":
    main()
