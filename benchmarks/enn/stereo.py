"""What two views show in space, beside what the simulator knows: tip, wire and path to the target in ArchVariety.

    python benchmarks/enn/stereo.py [--policy navigator_arch_variety] [--teacher arch_variety] [--arches 5] [--quick]

In so many arches of the test seeds a type the teacher steers by its roadmap while the networks of an image policy find
devices and lumen in noisy images of its two views. Errors are those of `enn.imitation.images.stereo_view` at every
decision from the first on at which both views show 12 pixels of the wire. Wrong paths are those that leave, by more
than 15 mm, the arteries that lead to the target. Prints one JSON object as its last line.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

import enn
from cathsim.anatomy.generator.variety.branching_types import ARCH_TYPES
from cathsim.arch_variety.environment import TEST_SEEDS, ArchVarietyEnv
from cathsim.guidewire import TIP_SITE
from cathsim.observations.framing import arch_centre, field_projections
from cathsim.observations.roadmap import WIRE_ARCS
from cathsim.observations.xray import XrayEnvironment
from enn.imitation.images.egocentric import SEEN
from enn.imitation.images.policy import ImagePolicy
from enn.imitation.images.stereo_geometry import StereoGeometry
from enn.imitation.images.stereo_view import PARTS, StereoView
from enn.imitation.images.visual_hull import SeenVoxels
from enn.policy import Policy
from pipeline.task import task_in_random_arches

ASTRAY_MM = 15.0


def arguments() -> argparse.Namespace:
    """Understands the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--policy", default="navigator_arch_variety", help="a shipped image policy of two views")
    parser.add_argument("--teacher", default="arch_variety", help="a shipped policy by roadmap, which steers")
    parser.add_argument("--arches", type=int, default=5, help="a type, one episode each")
    parser.add_argument("--max-steps", type=int, default=120, help="of an episode")
    parser.add_argument("--quick", action="store_true", help="one arch of a type")
    return parser.parse_args()


def astray_mm(phantom: Any, branch: str, path: np.ndarray) -> float:
    """By how much a path (n, 3) m leaves the arteries that lead to a branch, mm."""
    leading, name = [], branch
    parents = {one.name: one.parent for one in phantom.tree.branches}
    while name:
        leading += [one.points for one in phantom.tree.branches if one.name == name]
        name = parents[name]
    axes = np.concatenate(leading)
    return 1e3 * max(float(np.linalg.norm(axes - point, axis=1).min()) for point in path)


def main() -> None:
    """Runs the command line."""
    given = arguments()
    try:
        policy, teacher = enn.load(given.policy), enn.load(given.teacher)
    except (OSError, ValueError) as error:
        sys.exit(str(error))
    if not isinstance(policy, ImagePolicy) or not isinstance(teacher, Policy):
        sys.exit("--policy sees images, --teacher a roadmap")
    perception, field, side = policy.perception, policy.perception.field, task_in_random_arches().image_size_px
    if field is None or len(policy.cameras) != 2:
        sys.exit(f"--policy {given.policy}: expected a policy of two views of a fixed field")
    voxels = SeenVoxels(StereoGeometry(field_projections(policy.cameras, field), field))
    arches = 1 if given.quick else given.arches
    bare = ArchVarietyEnv(
        list(ARCH_TYPES), TEST_SEEDS[:arches], max_steps=given.max_steps, image_size=side,
        observation=("goal_image", *teacher.keys), catheter=None,
    )  # fmt: skip
    environment = XrayEnvironment(bare, side, **policy.imaging)
    errors: dict[str, list[Any]] = {name: [] for name in ("tip", "wire", "heading", "roll", "target", "astray")}
    starts, looks = [], []
    for case in range(arches * len(ARCH_TYPES)):
        observation, info = environment.reset(seed=case, options={"case": bare.case_of(case)})
        controller, views = teacher.controller(seed=case), perception.begin(observation).cameras
        began = time.process_time()
        lumens, dots = [view.lumen for view in views], [view.target + 0.5 / side for view in views]
        stereo = StereoView(voxels, lumens, dots)
        starts.append(time.process_time() - began)
        centre, goal = arch_centre(bare.phantom, field), bare.phantom.target(bare.task.target)
        errors["target"].append(1e3 * np.linalg.norm(stereo.hull.target + centre - goal.position))
        step, ended, seen = 0, False, False
        while not ended:
            if step % policy.action_repeat == 0:
                masks = perception.mask(observation)
                axes = [view.wire(observation["image"][k : k + 1], masks[k : k + 1]) for k, view in enumerate(views)]
                if not seen and min(len(axis) for axis in axes) >= SEEN:
                    seen = True
                    path = stereo.hull.way(stereo.wire(axes)[0][0])[0] + centre
                    errors["astray"].append(astray_mm(bare.phantom, goal.branch, path))
                if seen:
                    began = time.process_time()
                    look = stereo.look(axes)
                    looks.append(time.process_time() - began)
                    points = stereo.wire(axes)[0] + centre
                    errors["tip"].append(1e3 * np.linalg.norm(points[0] - info["tip"]))
                    true = bare.simulation.inserted_points()
                    errors["wire"].append(1e3 * along(points, true))
                    axes_of_tip = bare.simulation.data.site_xmat[bare.simulation.model.site(TIP_SITE).id].reshape(3, 3)
                    heading, bend = look[PARTS["heading"]], look[PARTS["bend"]]
                    errors["heading"].append(between_deg(heading, axes_of_tip[:, 2]))
                    errors["roll"].append(between_deg(bend, -axes_of_tip[:, 1]))
            observation, _, success, truncated, info = environment.step(controller(observation, info))
            ended, step = success or truncated, step + 1
    report: dict[str, Any] = {"policy": given.policy, "arches": arches * len(ARCH_TYPES), "looks": len(looks)}
    for name, unit in (("tip", "mm"), ("target", "mm")):
        report[name] = summary(np.array(errors[name]), unit)
    report["heading"] = summary(np.array(errors["heading"]), "deg")
    report["bend"] = summary(np.array(errors["roll"]), "deg")
    wire = np.stack(errors["wire"])
    report["wire"] = {f"{1e3 * arc:.0f}": summary(wire[:, k], "mm") for k, arc in enumerate(WIRE_ARCS)}
    report["wrong_paths"] = int(np.sum(np.array(errors["astray"]) > ASTRAY_MM))
    report["cpu_ms"] = {
        "start": round(1e3 * float(np.mean(starts[1:])), 1),
        "look": round(1e3 * float(np.mean(looks)), 2),
    }
    for name, row in report.items():
        print(f"{name:12} {row}")
    print(json.dumps(report))


def along(points: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Distances (7,) m of points at the same arcs behind the tips of two curves (n, 3) and (m, 3) m."""
    places = []
    for curve in (points, true):
        arc = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))))
        places.append(np.stack([np.interp(WIRE_ARCS, arc, curve[:, k]) for k in range(3)], axis=1))
    return np.linalg.norm(places[0] - places[1], axis=1)


def between_deg(found: np.ndarray, known: np.ndarray) -> float:
    """Angle between two unit vectors (3,), degrees."""
    return float(np.rad2deg(np.arccos(np.clip(found @ known, -1, 1))))


def summary(values: np.ndarray, unit: str) -> dict[str, float]:
    """Median and 90th percentile."""
    return {
        f"median_{unit}": round(float(np.median(values)), 2),
        f"p90_{unit}": round(float(np.quantile(values, 0.9)), 2),
    }


if __name__ == "__main__":
    main()
