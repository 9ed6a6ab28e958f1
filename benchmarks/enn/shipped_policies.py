"""A shipped policy in anatomies that it has never seen: random arches, and files of one's own.

    python benchmarks/enn/shipped_policies.py [--policy generalist] [--arches 50] [--draw]
    python benchmarks/enn/shipped_policies.py --steep generalist_simmons2 --first 40400 --draw
    python benchmarks/enn/shipped_policies.py --steep generalist_simmons2 --setting random_steep --max-steps 600 --draw
    python benchmarks/enn/shipped_policies.py --steep generalist_jb2 --catheter jb2_4f --wire radifocus_angled_025
    python benchmarks/enn/shipped_policies.py --anatomies scan.stl labels.nii.gz --episodes 5 --max-steps 600 --draw
    python benchmarks/enn/shipped_policies.py --anatomies scan.stl --draw --among generalist generalist_jb2
    python benchmarks/enn/shipped_policies.py --policy navigator --attempts 3
    python benchmarks/enn/shipped_policies.py --policy navigator --steep navigator_simmons2 --steep-from 13

Prints a row for each anatomy and target (all random arches together), with Wilson's 95 % interval, how many came
within the success radius in a straight line, the branches in which the tips ended, and their depths behind the ostium
(least, median, most), then rows by how far the target's ostium is set back behind the top of the arch, and one JSON
object as its last line. --steep names the policy for targets set back by --steep-from mm or more, which the scan tells
beforehand; a policy of two devices steers its own, or those of --catheter and --wire.
With --among the first policy, or from --steep-from mm on the second, plays an episode in each of three copies of the
anatomy; if it fails in one of them, all of these policies, which see a roadmap, play in six copies, and the one that
arrives most often plays the episodes (`enn.device_trials`).
With --attempts a device that has not arrived after --max-steps is drawn back and tried again, with the actions drawn
anew where they are drawn at all; the first attempt is the episode without it. Successes are counted by attempts, too.
With --then what --steep has not reached in its last attempt is tried as often with another policy of its devices, and
with --exchange what has not arrived then is tried with the devices of the other policy of the two: each from the
sheath, with the next seed; the time that an exchange of devices takes is not counted.
With --most-force an attempt also ends where it presses harder, the last one for good.
Arch k begins with seed 5,000,000,000 + 10 k + the target's number, which no training has used.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import json
import os
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

import enn
from cathsim.fluoroscopy.scene import SCENES
from cathsim.metrics.episodes import wilson_interval
from cathsim.observations.xray import XrayEnvironment
from enn.imitation.images.policy import ImagePolicy
from enn.policy import Policy
from enn.retrying import RetryingController, steps_of_attempts
from enn.shipped import read_policy
from pipeline.anatomies.anatomy_file import AnatomyFile, load_anatomy
from pipeline.anatomies.devices import best_in_copies, catheter_better_mm, set_back_mm
from pipeline.anatomies.settings import GENERATED_TARGETS, TARGETS
from pipeline.clutter import clutter_of
from pipeline.stages.unseen.task import STEEP, TEST_PHANTOM, TRUNK, UnseenTask, arch_of_test
from pipeline.task import TASK, task_in_random_arches

if TYPE_CHECKING:
    from cathsim.anatomy import Phantom

FIRST_ARCH, FIRST_SEED = 40_100, 5_000_000_000
FIRST_TRIAL = 6_000_000_000  # seed of the trials with --among
SET_BACK = (0.0, 5.0, 10.0, 13.0, 16.0, 20.0)  # mm, between the rows by set-back


@dataclasses.dataclass(frozen=True)
class Outcome:
    """How an episode went."""

    success: bool
    straight: bool  # whether the tip came within the success radius, also outside the branch
    branch: str  # in which the tip ended
    depth_mm: float  # of it behind the branch's ostium
    steps: int
    forces: np.ndarray  # of each step, N
    attempts: int


def arguments() -> argparse.Namespace:
    """Understands the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--policy", default="generalist", help=f"a file, or among {', '.join(enn.models())}")
    parser.add_argument("--steep", metavar="POLICY", help="for targets that are set back far")
    parser.add_argument("--then", metavar="POLICY", help="for what --steep has not reached")
    parser.add_argument(
        "--steep-from", type=float, metavar="MM", help="how far that is; without: from where it is better"
    )
    parser.add_argument("--among", nargs="+", metavar="POLICY", help="tried in copies; the best one plays")
    parser.add_argument("--arches", type=int, default=50, help="random arches, one episode each and target")
    parser.add_argument("--first", type=int, default=FIRST_ARCH, help="seed of the first arch")
    parser.add_argument("--setting", choices=(TEST_PHANTOM, STEEP, TRUNK), default=TEST_PHANTOM, help="of those arches")
    parser.add_argument(
        "--anatomies", type=Path, nargs="+", default=[], metavar="PATH", help="instead of random arches"
    )
    parser.add_argument(
        "--targets", nargs="+", choices=GENERATED_TARGETS, metavar="NAME",
        help=f"without: {', '.join(TARGETS)} of random arches, in files also {', '.join(GENERATED_TARGETS[3:])}",
    )  # fmt: skip
    parser.add_argument("--episodes", type=int, default=5, help="in each file and towards each target")
    parser.add_argument("--max-steps", type=int, default=300, help="of an attempt")
    parser.add_argument("--attempts", type=int, default=1)
    parser.add_argument("--catheter", metavar="NAME", help="instead of that which a policy of two devices learnt with")
    parser.add_argument("--wire", default="default", metavar="NAME", help="in a catheter")
    parser.add_argument(
        "--exchange", action="store_true", help="then try the devices of the other policy, with --steep"
    )
    parser.add_argument("--most-force", type=float, metavar="N", help="of all contacts, with which an attempt ends")
    parser.add_argument("--ct", type=Path, metavar="FILE", help="of the one anatomy: what X-ray images show around it")
    parser.add_argument("--room", choices=SCENES, help="what X-ray images show around vessels that have no CT")
    parser.add_argument("--clutter", type=float, default=0.0, help="in X-ray images, 1: as networks learn from")
    parser.add_argument(
        "--field", type=float, metavar="MM", help="of X-ray images, instead of what the policy learnt in"
    )
    parser.add_argument("--draw", action="store_true", help="actions are drawn; otherwise the best ones")
    parser.add_argument("--quick", action="store_true", help="one arch")
    return parser.parse_args()


def load(name: str) -> Policy | ImagePolicy:
    """A shipped policy, or one from a file of one's own."""
    return read_policy(Path(name)) if name.endswith(".pt") else enn.load(name)


def cells(given: argparse.Namespace) -> Iterator[tuple[str, str, list[tuple[int | AnatomyFile, int]]]]:
    """Name of the anatomy, target, and anatomy and seed of each episode."""
    if given.anatomies:
        for path in given.anatomies:
            place = AnatomyFile.of(str(path), ct=None if given.ct is None else str(given.ct))
            there = [target for target in load_anatomy(place).targets if target in GENERATED_TARGETS]
            for number, target in enumerate(there):
                if target in (given.targets or GENERATED_TARGETS):
                    first = FIRST_SEED + 100 * number
                    yield path.name, target, [(place, first + episode) for episode in range(given.episodes)]
        return
    for number, target in enumerate(GENERATED_TARGETS):
        if target in (given.targets or TARGETS):
            arches = range(given.first, given.first + (1 if given.quick else given.arches))
            yield given.setting, target, [(arch, FIRST_SEED + 10 * arch + number) for arch in arches]


def task_of(policy: Any, given: argparse.Namespace) -> UnseenTask:
    """The task of the tests, with the devices that a policy was trained with."""
    catheter = policy.metadata.get(TASK, {}).get("catheter")
    devices = {} if catheter is None else {"catheter": given.catheter or catheter, "wire": given.wire}
    max_steps = steps_of_attempts(given.max_steps, given.attempts)
    rules = dataclasses.replace(task_in_random_arches(), max_steps=max_steps, start_rotation_deg=180.0, **devices)
    return UnseenTask(GENERATED_TARGETS, rules, arches=given.setting)


def play(
    task: UnseenTask, policy: Any, place: int | AnatomyFile, target: str, seed: int, given: argparse.Namespace
) -> Outcome:
    """Plays one episode."""
    environment: Any

    def attempt(seed: int) -> Any:
        drawn = {"deterministic": not given.draw, "seed": seed} if by_roadmap else {}
        return policy.controller(**drawn)

    by_roadmap = isinstance(policy, Policy)
    if by_roadmap:
        environment = task.test_environment(place, target, task.task.wire, policy.keys)
    else:
        side = task.task.image_size_px
        bare = task.test_environment(place, target, task.task.wire, ("goal_image",))
        imaging = policy.imaging | ({"field": 1e-3 * given.field} if given.field else {})
        room = place.room() if isinstance(place, AnatomyFile) else None
        room = room or (SCENES[given.room] if given.room else None)
        environment = XrayEnvironment(bare, side, clutter=clutter_of(given.clutter), room=room, **imaging)
    controller = RetryingController(attempt, given.max_steps, given.attempts, seed, most_force=given.most_force)
    observation, info = environment.reset(seed=seed)
    forces: list[float] = []
    ended = success = straight = False
    while not ended:
        observation, _, success, truncated, info = environment.step(controller(observation, info))
        forces.append(float(info["force"]))
        straight |= info["distance"] <= task.task.success_radius
        ended = success or truncated
    environment.close()
    place = bool(success), straight, info["branch"], 1e3 * info["depth"]
    return Outcome(*place, len(forces), np.array(forces), controller.attempts)


def play_with(
    devices: Sequence[tuple[UnseenTask, Any]],
    place: int | AnatomyFile,
    target: str,
    seed: int,
    given: argparse.Namespace,
) -> Outcome:
    """Plays one episode; where it fails, others with the next task and policy each, as if it went on."""
    outcome = play(*devices[0], place, target, seed, given)
    for number, (task, policy) in enumerate(devices[1:], 1):
        if not outcome.success:
            further = play(task, policy, place, target, seed + number, given)
            outcome = Outcome(
                further.success,
                outcome.straight or further.straight,
                further.branch,
                further.depth_mm,
                outcome.steps + further.steps,
                np.concatenate((outcome.forces, further.forces)),
                number * given.attempts + further.attempts,
            )
    return outcome


def phantom_of(place: int | AnatomyFile, setting: str) -> Phantom:
    """The anatomy of an episode."""
    return load_anatomy("{}_{}".format(*arch_of_test(place, setting)) if isinstance(place, int) else place)


def ostium_set_back(place: int | AnatomyFile, target: str, setting: str) -> float:
    """How far the target's ostium is set back, mm."""
    return set_back_mm(phantom_of(place, setting), target)


def steep_from(given: argparse.Namespace, target: str) -> float:
    """The set-back, mm, from which on the second policy steers to a target, which has its branch's name."""
    second = given.among[1] if given.among else given.steep or given.policy
    return catheter_better_mm(second, target) if given.steep_from is None else float(given.steep_from)


def best_in_trials(
    devices: Sequence[tuple[UnseenTask, Any]], place: int | AnatomyFile, target: str, given: argparse.Namespace
) -> int:
    """Number of the task and policy that fare best in copies of the anatomy."""
    phantom = phantom_of(place, given.setting)
    usual = int(set_back_mm(phantom, target) >= steep_from(given, target))
    rules = [dataclasses.replace(task.task, max_steps=given.max_steps) for task, _ in devices]
    return best_in_copies([policy for _, policy in devices], rules, phantom, target, usual=usual, seed=FIRST_TRIAL)


def rows_by_set_back(measured: Sequence[tuple[float, bool]]) -> list[dict[str, Any]]:
    """Success of all episodes together, by the set-back of their targets (mm, success)."""
    rows = []
    for lowest, highest in itertools.pairwise((-np.inf, *SET_BACK, np.inf)):
        won = [success for back, success in measured if lowest <= back < highest]
        if won:
            low, high = wilson_interval(sum(won), len(won))
            name = f"set back {lowest:g} to {highest:g} mm"
            interval = [round(100 * low), round(100 * high)]
            rows.append({"row": name, "reached": sum(won), "episodes": len(won), "interval_pct": interval})
            print(f"{name:30} {sum(won)} of {len(won)}  ({100 * low:.0f} to {100 * high:.0f})")
    return rows


def main() -> None:
    """Runs the command line."""
    given = arguments()
    try:
        names = given.among or [given.policy, given.steep or given.policy] + ([given.then] if given.then else [])
        policies = [load(name) for name in names]
        if given.draw and not all(isinstance(policy, Policy) for policy in policies):
            raise ValueError("--draw: a policy that sees images always takes the best action")
        if given.among and (len(names) < 2 or given.steep or not all(isinstance(one, Policy) for one in policies)):
            raise ValueError("--among: name two policies or more that see a roadmap, and leave out --steep")
        if (given.exchange or given.then) and not given.steep:
            raise ValueError("--exchange and --then: name a policy of other devices with --steep")
        if given.clutter and any(isinstance(policy, Policy) for policy in policies):
            raise ValueError("--clutter: a policy by roadmap sees no images")
        if given.room is not None and any(isinstance(policy, Policy) for policy in policies):
            raise ValueError("--room: a policy by roadmap sees no images")
        if given.ct is not None and (
            len(given.anatomies or ()) != 1 or any(isinstance(policy, Policy) for policy in policies)
        ):
            raise ValueError("--ct belongs to one of --anatomies and to policies by images")
        tasks = [task_of(policy, given) for policy in policies]
        devices = list(zip(tasks, policies, strict=True))
        in_turn = [[devices[0]] + devices[1:2] * given.exchange, devices[1:] + devices[:1] * given.exchange]
        if given.among:
            in_turn = [[each] for each in devices]
        best = cache(lambda place, target: best_in_trials(devices, place, target, given))
        rows, measured, tries = [], [], given.attempts * max(len(each) for each in in_turn)
        for name, target, episodes in cells(given):
            backs = [ostium_set_back(place, target, given.setting) for place, _ in episodes]
            chosen = [
                best(place, target) if given.among else int(back >= steep_from(given, target))
                for back, (place, _) in zip(backs, episodes, strict=True)
            ]
            outcomes = [
                play_with(in_turn[k], place, target, seed, given)
                for k, (place, seed) in zip(chosen, episodes, strict=True)
            ]
            measured += [(back, one.success) for back, one in zip(backs, outcomes, strict=True)]
            won = sum(one.success for one in outcomes)
            low, high = wilson_interval(won, len(outcomes))
            row = {
                "anatomy": name, "target": target, "reached": won, "episodes": len(outcomes),
                "interval_pct": [round(100 * low), round(100 * high)],
                "within_attempts": [
                    sum(one.success and one.attempts <= most + 1 for one in outcomes) for most in range(tries)
                ],
                "straight": sum(one.straight for one in outcomes),
                "branches": dict(Counter(one.branch for one in outcomes)),
                "depth_mm": np.percentile([one.depth_mm for one in outcomes], (0, 50, 100)).round(1).tolist(),
                "steps": round(float(np.mean([one.steps for one in outcomes])), 1),
                "force_mean_n": round(float(np.mean([one.forces.mean() for one in outcomes])), 3),
                "force_p95_n": round(float(np.mean([np.percentile(one.forces, 95) for one in outcomes])), 3),
                "force_max_n": round(max(float(one.forces.max()) for one in outcomes), 2),
                "played_by": {names[k]: chosen.count(k) for k in sorted(set(chosen))},
            }  # fmt: skip
            rows.append(row)
            share = f"{100 * won / len(outcomes):3.0f} % ({100 * low:.0f} to {100 * high:.0f})"
            places = ", ".join(f"{branch} {count}" for branch, count in row["branches"].items())
            depth = f"straight {row['straight']}; {places}; {' / '.join(f'{mm:.0f}' for mm in row['depth_mm'])} mm deep"
            force = ", ".join(f"{row[key]:.2f}" for key in ("force_mean_n", "force_p95_n", "force_max_n"))
            tried = f"  within attempts {row['within_attempts']}" if tries > 1 else ""
            tried += f"  {', '.join(f'{name} {count}' for name, count in row['played_by'].items())}" * bool(given.among)
            print(
                f"{name:24} {target:5} {won} of {len(outcomes)}  {share}  {depth}  {row['steps']:.0f} steps  "
                f"{force} N{tried}",
                flush=True,
            )
    except (OSError, ValueError) as error:
        sys.exit(str(error))
    found = {
        "policy": given.policy, "steep": given.steep, "among": given.among, "then": given.then,
        "steep_from_mm": given.steep_from, "drawn": given.draw, "rows": rows, "set_back": rows_by_set_back(measured),
    }  # fmt: skip
    print(json.dumps(found))


if __name__ == "__main__":
    main()
