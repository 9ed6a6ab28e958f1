"""A policy in ArchVariety: arches of six branching types that it has never seen, to random points.

    python benchmarks/enn/arch_variety.py --policy FILE [--steep FILE] [--arches 20] [--first 0] [--draw]
                                         [--attempt-steps 150] [--exchange-after 225]
    python benchmarks/enn/arch_variety.py --among FILE FILE FILE --draw

One episode in each of so many arches of the test seeds a type, of which nothing was trained on; episode k of a type
begins with seed k. With `--steep`, that
policy steers with its own devices where the ostium of the target's branch is set back by --steep-from mm or more, which
the scan tells beforehand. With `--attempt-steps` devices that have not arrived after so many steps are drawn back and
try again, within the same episode. With `--exchange-after` what has not arrived after so many steps is drawn out, which
takes as many steps as the feeders need for what is inserted, and the devices of the other policy are tried, from the
sheath, for what is left of the episode. With `--among` the first of two policies or more, or where the target is steep
the second, plays an episode in each of three copies of the arch, whose walls, place, motion and wire differ from it by
half of what a patient's may from a scan. If it fails in one of them, all of these policies play in six copies, and the
one that arrives most often steers the episode (`enn.device_trials`). Prints a row a type with Wilson's
95 % interval, which branches were missed, and one JSON object as its last line.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections import Counter
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

import enn
from cathsim.anatomy.generator.variety_arch import ARCH_TYPES
from cathsim.arch_variety import TEST_SEEDS, TEST_STEPS, ArchVarietyEnv, ArchVarietyTask
from cathsim.metrics.episodes import wilson_interval
from cathsim.observations.xray import XrayEnvironment
from cathsim.presets import PACES
from cathsim.rehearsal.environment import NavigateCopiesEnv, Perturbation
from enn.device_trials import TRIALS, TrialStatistics, best_devices, try_in_copies
from enn.policy import Policy
from enn.retrying import RetryingController
from enn.shipped import read_policy
from pipeline.anatomies.devices import CATHETER_BETTER_MM, SHARE, set_back_mm
from pipeline.task import TASK, task_in_random_arches

FIRST_TRIAL = 1_000_000  # seed of the trials with --among, beyond those of the episodes
VARIETY = "arch_variety"  # the wire and the pace of the task


@dataclass(frozen=True)
class Outcome:
    """How an episode went."""

    success: bool
    branch: str  # that its target lies in
    steep: bool  # whether that is set back by as much
    forces: np.ndarray  # of each step, N
    steered: int  # number of the policy that began it


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--policy", default="generalist", help=f"a file, or among {', '.join(enn.models())}")
    parser.add_argument("--steep", metavar="POLICY", help="for targets that are set back far")
    parser.add_argument("--steep-from", type=float, default=CATHETER_BETTER_MM, metavar="MM", help="how far that is")
    parser.add_argument(
        "--among", nargs="+", metavar="POLICY", help="tried in copies of each arch; the best one steers"
    )
    parser.add_argument("--types", default=",".join(ARCH_TYPES))
    parser.add_argument("--arches", type=int, default=20, help="a type, one episode each")
    parser.add_argument("--first", type=int, default=0, help="test seeds of a type that are left out")
    parser.add_argument("--max-steps", type=int, default=TEST_STEPS)
    parser.add_argument("--attempt-steps", type=int, help="of an attempt; without, there is one of --max-steps")
    parser.add_argument("--exchange-after", type=int, metavar="STEPS", help="with --steep")
    parser.add_argument("--draw", action="store_true", help="actions are drawn; otherwise the best ones")
    return parser.parse_args()


class Player:
    """A policy with an environment of the devices that it was trained with.

    Args:
        name: of a shipped policy, or its file.

    Raises:
        OSError, ValueError: no such policy, or one that cannot do what is asked.
    """

    def __init__(self, name: str, given: argparse.Namespace) -> None:
        self.policy: Any = read_policy(Path(name)) if name.endswith(".pt") else enn.load(name)
        self.steep_from = given.steep_from
        self.draw, self.attempt_steps = given.draw, given.attempt_steps or given.max_steps
        self.by_roadmap, side = isinstance(self.policy, Policy), task_in_random_arches().image_size_px
        if (self.draw or given.among) and not self.by_roadmap:
            option = "--draw: a policy that sees images always takes the best action"
            raise ValueError(option if self.draw else "--among: a policy that sees images has no scan to try it in")
        self.catheter = self.policy.metadata.get(TASK, {}).get("catheter")
        seeds = TEST_SEEDS[given.first : given.first + given.arches]
        self.bare = ArchVarietyEnv(
            given.types.split(","), seeds, max_steps=given.max_steps, image_size=side,
            observation=self.policy.keys if self.by_roadmap else ("goal_image",), catheter=self.catheter,
        )  # fmt: skip
        self.environment: Any = (
            self.bare if self.by_roadmap else XrayEnvironment(self.bare, side, **self.policy.imaging)
        )

    def begin(self, case: int, seed: int) -> tuple[Any, dict[str, Any]]:
        """Begins an episode."""
        observation, info = self.environment.reset(seed=seed, options={"case": self.bare.case_of(case)})
        return observation, info

    def controller(self, seed: int) -> RetryingController:
        """What steers an episode of a seed."""

        def attempt(seed: int) -> Any:
            drawn = {"deterministic": not self.draw, "seed": seed} if self.by_roadmap else {}
            return self.policy.controller(**drawn)

        return RetryingController(attempt, self.attempt_steps, seed=seed)

    def trial_statistics(self, seed: int, copies: int) -> TrialStatistics:
        """How the policy fares in copies of the present arch."""
        environment = NavigateCopiesEnv(
            self.bare.phantom, (self.bare.task.target,), copies=range(1, TRIALS + 1),
            perturbation=Perturbation().scaled(SHARE), wire=VARIETY, pace=VARIETY, catheter=self.catheter,
            observation=self.policy.keys, task=ArchVarietyTask(max_steps=self.bare.task.max_steps),
        )  # fmt: skip
        outcome = TrialStatistics.of(try_in_copies(self.policy, environment, seed, cases=range(copies)))
        environment.close()
        return outcome

    def steep(self) -> bool:
        """Whether the ostium of the present target's branch is set back far."""
        return set_back_mm(self.bare.phantom, self.bare.task.target) >= self.steep_from


def play(players: list[Player], case: int, seed: int, given: argparse.Namespace) -> Outcome:
    """Plays one episode: by the best player in trials, or the last where the target is steep, else by the first."""
    for player in players:
        player.begin(case, seed)
    goal, steep = players[0].bare.task.target, players[0].steep()
    branch = players[0].bare.phantom.target(goal).branch
    if given.among:
        tries = [partial(player.trial_statistics, FIRST_TRIAL + seed) for player in players]
        in_turn = [players[best_devices(tries, int(steep))]]
    else:
        in_turn = players[:1] if len(players) == 1 else players[::-1] if steep else players
    limits = [given.max_steps] if given.exchange_after is None else [given.exchange_after, given.max_steps]
    forces: list[float] = []
    success = False
    for player, limit in zip(in_turn, limits, strict=False):
        observation, info = player.begin(case, seed)
        assert player.bare.task.target == goal
        controller, ended = player.controller(seed), False
        while not ended and len(forces) < limit:
            observation, _, success, truncated, info = player.environment.step(controller(observation, info))
            forces.append(float(info["force"]))
            ended = bool(success or truncated)
        if success:
            break
        forces += [0.0] * round(np.ceil(info["insertion"] / PACES["arch_variety"].translation))
    begun_by = players.index(in_turn[0])
    return Outcome(bool(success), branch, steep, np.array(forces[: given.max_steps]), begun_by)


def row_of(name: str, outcomes: list[Outcome], seconds: float) -> dict[str, Any]:
    """Prints a row, and returns it."""
    won = [one for one in outcomes if one.success]
    low, high = wilson_interval(len(won), len(outcomes))
    row = {
        "type": name, "reached": len(won), "episodes": len(outcomes),
        "interval_pct": [round(100 * low), round(100 * high)],
        "steps": round(float(np.mean([len(one.forces) for one in won])), 1) if won else None,
        "force_mean_n": round(float(np.mean([one.forces.mean() for one in outcomes])), 3),
        "force_max_n": round(max(float(one.forces.max()) for one in outcomes), 2),
        "force_max_median_n": round(float(np.median([one.forces.max() for one in outcomes])), 2),
        "cpu_s": round(seconds / len(outcomes), 2),
        "missed": dict(Counter(one.branch for one in outcomes if not one.success)),
    }  # fmt: skip
    share = f"{100 * len(won) / len(outcomes):3.0f} % ({100 * low:.0f} to {100 * high:.0f})"
    forces = ", ".join(f"{row[key]:.2f}" for key in ("force_mean_n", "force_max_n", "force_max_median_n"))
    missed = ", ".join(f"{count} {branch}" for branch, count in row["missed"].items())
    print(f"{name:22} {len(won)} of {len(outcomes)}  {share}  {row['steps']} steps  {forces} N  {missed}", flush=True)
    return row


def main() -> None:
    given = arguments()
    if not (0 <= given.first < len(TEST_SEEDS) and given.arches > 0):
        sys.exit(f"--first and --arches: there are {len(TEST_SEEDS)} test seeds of a type")
    if given.among and (len(given.among) < 2 or given.steep or given.exchange_after is not None):
        sys.exit("--among: name two policies or more, and leave out --steep and --exchange-after")
    if given.exchange_after is not None and (given.steep is None or not 0 < given.exchange_after < given.max_steps):
        sys.exit("--exchange-after: name a policy of other devices with --steep, and steps below --max-steps")
    try:
        names = given.among or [name for name in (given.policy, given.steep) if name is not None]
        players = [Player(name, given) for name in names]
    except (OSError, ValueError) as error:
        sys.exit(str(error))
    rows, together, began = [], [], time.process_time()
    arches = len(TEST_SEEDS[given.first : given.first + given.arches])
    for index, kind in enumerate(given.types.split(",")):
        start = time.process_time()
        outcomes = [play(players, index * arches + number, given.first + number, given) for number in range(arches)]
        rows.append(row_of(kind, outcomes, time.process_time() - start))
        together += outcomes
    for name, steep in ((f"set back below {given.steep_from:g} mm", False), ("set back further", True)):
        if part := [one for one in together if one.steep == steep]:
            rows.append(row_of(name, part, 0.0))
    rows.append(row_of("all", together, time.process_time() - began))
    asked = {name: getattr(given, name) for name in ("policy", "steep", "exchange_after", "among")}
    steered = {name: sum(one.steered == number for one in together) for number, name in enumerate(names)}
    print(json.dumps(asked | {"drawn": given.draw, "steered": steered, "rows": rows}))


if __name__ == "__main__":
    main()
