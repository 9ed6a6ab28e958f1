"""Robustness of surfaces: what people's meshes have, put into surfaces whose vessels are known.

    python benchmarks/anatomy/surface_faults.py [--arches N] [--first SEED] [--faults stairs,pieces] [--seed N]

Surfaces of N arches of `random_scan` or another --setting (seeds from --first on, marching cubes of 0.8 mm, mm) get one
fault each and are imported from an STL in a process of its own, without any cache and without a word of what they are:

    as_drawn      none
    stairs        the faces of voxels of 0.8 x 0.8 x 1.5 mm, not smoothed
    opened        cut flat and open at every end
    extended      open, with a straight tube of three radii at every end
    walled        a wall of 0.15 of the aorta's radius, 2 mm at most, open at every end
    pieces        every vessel a closed surface of its own; they overlap
    segments      every vessel the smoothed surface of its own voxels; they touch
    islands       20 balls of 1 to 4 mm of radius beside the vessels
    calcified     12 hollow balls of at most 3 mm of radius within the vessels
    no_descending cut off 25 mm below the last take-off
    no_ascending  cut off 12 mm before the first take-off
    short         cut off 20 mm above the arch
    stumps        every branch cut off 15 mm beyond its ostium
    abdominal     the aorta about 15 radii longer, with two renal, one celiac and two iliac arteries
    coronaries    two arteries of 1.8 mm of radius at the root
    sinuses       the three sinuses of the root
    ventricle     a ball of 1.8 times the root's radius below it
    aneurysm      a ball of 1.7 times the aorta's radius on the descending aorta
    arms          the subclavian arteries about 20 radii longer, out to the side and down
    vertebrals    an artery of 1.8 mm of radius from each subclavian artery upward
    rough         vertices moved by 0.3 mm (standard deviation)
    holed         ten round holes of 2 to 5 mm of radius
    doubled       every face twice
    mixed         half of the faces the other way round
    shrunk        Laplacian smoothing in 30 steps
    bridged       a bar of 3 mm between neighbouring branches, halfway
    vein          a tube of 12 mm of width across the branches, 1.5 mm from them, closed
    far           in metres, 1.5 m from the origin

A row is right if the lumen has no problem, the vessels of which at least 12 mm are left are found by their names
(others may be found besides, without the name of an artery of the arch; those that a trunk parts into are needed where
all of them are left), every target lies within 3 mm of the vessel's true centreline or, where the vessel was made
longer, in the middle of its lumen, and no wall is within half of the aorta's radius or a quarter of another vessel's
(1 % of places may be). It is "said" if it is wrong and a note says that names are unsure, sides are exchanged or
something is missing, or if it is refused. Last line: one JSON object {"rows": {case: {...}}, "right", "tried"}.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray

from benchmarks.anatomy.drawn_arch import Drawn, draw
from benchmarks.anatomy.drawn_faults import FAULTS
from benchmarks.anatomy.fault_cases import (
    BLOCKED,
    CORNERS,
    LEAST_RADIUS,
    NEAR,
    arches,
    chosen_faults,
    run_cases,
)
from cathsim.anatomy import MeshRefusedError, import_anatomy, load_phantom
from cathsim.anatomy.generator.recipe import RANDOM, SCAN
from cathsim.anatomy.lumen_report import check_lumen
from cathsim.anatomy.vessel_tree import nearest_on_branch

LEFT = 12e-3  # m: a vessel of which less is left need not be found
ARTERIES = {"bca", "rsa", "rcca", "lcca", "lsa", "carotid_trunk", "subclavian_trunk"}
UNSURE = ("names are unsure", "mirror", "not found", "left out")

Array = NDArray[np.float64]


def judge(path: Path, drawn: Drawn) -> dict[str, Any]:
    """Imports a surface and compares what is found with the truth."""
    with tempfile.TemporaryDirectory() as folder:
        try:
            found = import_anatomy(path, cache_dir=Path(folder))
        except (MeshRefusedError, ValueError) as error:
            reason = error.reason if isinstance(error, MeshRefusedError) else str(error)
            return {"right": False, "said": True, "problems": [f"refused: {reason}"], "notes": []}
    report = found.imported
    assert report is not None
    turn = np.array(report.rotation)

    def to_found(points: Array) -> Array:
        placed: Array = report.scale * ((points + drawn.shift) / drawn.unit) @ turn.T + np.array(report.offset)
        return placed

    def to_truth(points: Array) -> Array:
        placed: Array = ((points - np.array(report.offset)) @ turn) / report.scale * drawn.unit - drawn.shift
        return placed

    problems = list(check_lumen(found, required_radius=LEAST_RADIUS).problems)
    if not np.isclose(report.scale, drawn.unit):
        problems.append(f"scale {report.scale:g}")
    left = {}
    for branch in drawn.tree:
        at = np.linspace(0, branch.length, 200)
        left[branch.name] = float((drawn.inside(branch.point_at(at)) > 0).mean() * branch.length)
    needed = {name for name, length in left.items() if length >= min(LEFT, 0.5 * drawn.tree[name].length)} - {"sac"}
    for trunk in list(needed):
        daughters = {b.name for b in drawn.tree if b.parent == trunk and trunk != drawn.tree.root.name}
        if not daughters <= needed:
            needed -= daughters
    problems += [f"missing: {name}" for name in sorted(needed - set(found.tree.names))]
    problems += [f"added: {name}" for name in sorted((set(found.tree.names) & ARTERIES) - set(left))]
    for name, target in found.targets.items():
        if name in drawn.tree:
            branch, place = drawn.tree[name], to_truth(np.asarray(target.position)[None])
            _, arc, away = nearest_on_branch(branch, place)
            beyond = arc[0] > branch.length - 1e-6  # where the vessel was made longer, in the middle of its lumen
            if away[0] > NEAR and not (beyond and drawn.inside(place)[0] > 0.5 * branch.radius[-1]):
                problems.append(f"target {name}: {1e3 * away[0]:.1f} mm from the vessel's centreline")
    for branch in drawn.tree:
        if branch.name not in found.tree:
            continue
        _, arc, _ = nearest_on_branch(branch, to_truth(found.tree[branch.name].points))
        at = np.linspace(max(0.1 * branch.length, arc.min()), min(0.9 * branch.length, arc.max() - 5e-3), 100)
        share = 0.5 if branch.parent is None else 0.25
        places = (branch.point_at(at)[:, None] + share * branch.radius_at(at)[:, None, None] * CORNERS).reshape(-1, 3)
        places = places[drawn.inside(places) > 1e-3]
        if len(places) and (blocked := float((found.grid.sample(to_found(places)) <= 0).mean())) > BLOCKED:
            problems.append(f"{branch.name}: {100 * blocked:.1f} % of its inside is wall")
    notes = list(report.notes)
    said = any(word in note for note in notes for word in UNSURE)
    return {"right": not problems, "said": said, "problems": problems, "notes": notes}


def run_case(seed: int, fault: str, random_seed: int, keep: Path | None, setting: str) -> dict[str, Any]:
    """One arch with one fault, in this process."""
    drawn = Drawn(load_phantom(setting, seed=seed), np.random.default_rng(random_seed))
    FAULTS[fault](drawn)
    mesh = draw(drawn)
    with tempfile.TemporaryDirectory() as folder:
        path = (keep or Path(folder)) / f"{fault}_{seed}.stl"
        path.parent.mkdir(parents=True, exist_ok=True)
        mesh.export(path)
        return judge(path, drawn)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--arches", type=int, default=3)
    parser.add_argument("--first", type=int, default=3000, help="seed of the first arch")
    parser.add_argument("--setting", default=SCAN, choices=RANDOM, help="of the arches")
    parser.add_argument("--faults", default=",".join(FAULTS), help="some of them, with commas between")
    parser.add_argument("--seed", type=int, default=0, help="of what is random in a fault")
    parser.add_argument("--one", help=argparse.SUPPRESS)
    parser.add_argument("--keep", type=Path, help="a folder that keeps the surfaces")
    options = parser.parse_args()
    faults = chosen_faults(parser, options, FAULTS)
    if options.one:
        print(json.dumps(run_case(int(options.one), faults[0], options.seed, options.keep, options.setting)))
        return
    kept = ["--keep", str(options.keep)] if options.keep else []
    further = ["--seed", str(options.seed), "--setting", options.setting, *kept]
    run_cases(__file__, faults, arches(options), further)


if __name__ == "__main__":
    main()
