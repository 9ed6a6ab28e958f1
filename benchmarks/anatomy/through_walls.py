"""How often a steered wire cuts through the wall between two lumens, with walls as segmented and as imported.

    python benchmarks/anatomy/through_walls.py PATH... [--policy NAME] [--steep NAME] [--steep-from 13] [--episodes 3]
                                               [--targets NAME...] [--as-segmented]

Episodes of policies (shipped ones, or files) in imported anatomies, towards every supra-aortic target, or some: by
roadmap, actions drawn, or by images. --steep steers to targets set back by --steep-from mm or more. Along the wire's
axis, from place to place within the lumen, the distance through the lumen to an end of a branch changes no faster than
the way itself; where it changes by `JUMP` more, the wire went through a wall. Looked at every half a second. Prints a
row a target and one JSON object as the last line. --as-segmented imports without `thicken_between_lumens`, into a cache
of its own.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray

import enn
from cathsim.anatomy import Phantom
from cathsim.observations.xray import XrayEnvironment
from enn.policy import Policy
from enn.shipped import read_policy
from pipeline.anatomies.anatomy_file import AnatomyFile, load_anatomy
from pipeline.anatomies.known import GENERATED_TARGETS
from pipeline.anatomies.take_offs import STEEP_MM, set_back_mm
from pipeline.stages.unseen.task import UnseenTask
from pipeline.task import TASK, task_in_random_arches

JUMP = 6e-3  # m: a way about the edge of a carina is shorter
_FINE = 5e-4  # m between places on the wire's axis
_INSIDE = 1e-4  # m from the wall: what counts as in the lumen
_WALL = 4e-3  # m: the longest piece of the wire in a wall
_EVERY = 5  # steps between two looks
_SEED = 5_000_000_000


def largest_jump(phantom: Phantom, points: NDArray[np.float64], fields: Sequence[Any]) -> float:
    """How much further than along the wire it is through the lumen, m, at the worst place.

    Args:
        points: of the wire in the vessel, m. Shape (n, 3).
        fields: distances through the lumen, to several places.
    """
    if len(points) < 2:
        return 0.0
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
    pieces = [
        np.linspace(a, b, max(int(length / _FINE), 1), endpoint=False)
        for a, b, length in zip(points[:-1], points[1:], lengths, strict=True)
    ]
    fine = np.concatenate(pieces)
    inside = fine[phantom.grid.sample(fine) > _INSIDE]
    if len(inside) < 2:
        return 0.0
    apart = np.linalg.norm(np.diff(inside, axis=0), axis=1)
    near = apart < _WALL
    jumps = [np.abs(np.diff(field.sample(inside))) - apart for field in fields]
    return float(max(np.where(near, jump, 0.0).max() for jump in jumps))


def main() -> None:
    """Runs the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("anatomies", type=Path, nargs="+", metavar="PATH")
    parser.add_argument("--policy", default="generalist")
    parser.add_argument("--steep", default="generalist_simmons2", help=f"for targets set back by {STEEP_MM:g} mm")
    parser.add_argument("--steep-from", type=float, default=STEEP_MM, metavar="MM")
    parser.add_argument("--targets", nargs="+", choices=GENERATED_TARGETS, metavar="NAME")
    parser.add_argument("--episodes", type=int, default=3, help="towards each target")
    parser.add_argument("--max-steps", type=int, default=600)
    parser.add_argument("--as-segmented", action="store_true", help="without filling thin walls")
    given = parser.parse_args()
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as cache:
        if given.as_segmented:
            leave_walls(cache)
        try:
            policies = [
                read_policy(Path(name)) if name.endswith(".pt") else enn.load(name)
                for name in (given.policy, given.steep)
            ]
            for path in given.anatomies:
                rows += measured(AnatomyFile(str(path)), path.name, policies, given)
        except (OSError, ValueError) as error:
            sys.exit(str(error))
    print(json.dumps({"as_segmented": given.as_segmented, "rows": rows}))


def leave_walls(cache: str) -> None:
    """Anatomies are imported with walls as thin as they are segmented."""
    from cathsim.anatomy.mesh import surface_import
    from cathsim.anatomy.volume.lumen import labelled

    os.environ["CATHSIM_CACHE"] = cache
    for module in (surface_import, labelled):
        module.thicken_between_lumens = lambda grid: grid  # type: ignore[attr-defined]


def measured(place: AnatomyFile, name: str, policies: list[Any], given: argparse.Namespace) -> list[dict[str, Any]]:
    """Rows of an anatomy."""
    phantom, rows = load_anatomy(place), []
    targets = [target for target in phantom.targets if target in GENERATED_TARGETS]
    fields = [phantom.geodesic_field(target) for target in phantom.targets if target.endswith("_end")]
    for number, target in enumerate(targets):
        if target not in (given.targets or targets):
            continue
        policy = policies[set_back_mm(phantom, target) >= given.steep_from]
        catheter = policy.metadata.get(TASK, {}).get("catheter")
        rules = dataclasses.replace(
            task_in_random_arches(), max_steps=given.max_steps, start_rotation_deg=180.0, catheter=catheter
        )
        by_roadmap = isinstance(policy, Policy)
        keys = policy.keys if by_roadmap else ("goal_image",)
        bare = UnseenTask((target,), rules).test_environment(place, target, "default", keys)
        environment: Any = bare if by_roadmap else XrayEnvironment(bare, rules.image_size_px, **policy.imaging)
        reached, through, forces = 0, 0, []
        for episode in range(given.episodes):
            seed = _SEED + 100 * number + episode
            controller = policy.controller(deterministic=False, seed=seed) if by_roadmap else policy.controller()
            observation, info = environment.reset(seed=seed)
            jumped, ended, step = 0.0, False, 0
            while not ended:
                observation, _, success, truncated, info = environment.step(controller(observation, info))
                ended, step = success or truncated, step + 1
                forces.append(float(info["force"]))
                if step % _EVERY == 0:
                    points = bare.simulation.wire_points()
                    behind = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))]
                    jumped = max(jumped, largest_jump(phantom, points[behind < info["insertion"]], fields))
            reached, through = reached + bool(success), through + (jumped > JUMP)
        environment.close()
        rows.append(
            {
                "anatomy": name,
                "target": target,
                "episodes": given.episodes,
                "through_a_wall": through,
                "reached": reached,
                "force_max_n": round(max(forces), 2),
            }
        )
        print(
            f"{name:24} {target:5} through a wall {through} of {given.episodes}, reached {reached}, "
            f"at most {max(forces):.2f} N",
            flush=True,
        )
    return rows


if __name__ == "__main__":
    main()
