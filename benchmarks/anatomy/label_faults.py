"""Robustness of label volumes: faults that segmentations have, put into labels whose vessels are known.

    python benchmarks/anatomy/label_faults.py [PATH] [--arches N] [--first SEED] [--faults gap,specks] [--seed N]

Labels of N arches of `random_scan` or another --setting (seeds from --first on, voxels of 0.8 x 0.8 x 1.5 mm), or those
of the NIfTI file PATH, are written with one fault each and imported in a process of its own, without any cache:

    as_drawn       none
    ostium_gap     4 mm of every branch missing at its take-off
    gap            4 mm missing halfway along every branch
    specks         60 specks of one to eight voxels, of random labels, anywhere
    ragged         a fifth of the voxels at the wall flipped
    eroded         one layer of voxels less
    thick          one layer of voxels more
    swapped        a third of every branch, from its take-off on, labelled as the aorta
    tip_swapped    the last fifth of every branch labelled as its neighbour
    short          cut off 20 mm above the arch
    one_label      all vessels under one label without a name
    vein           a tube of 12 mm of a label that is no artery across the branches
    leak           a ball of 10 mm of radius at the wall of the aorta, labelled as the aorta
    bridge         a bar of two voxels between neighbouring branches
    holes          twelve hollow balls of at most 4 mm of radius within the vessels, 1.5 mm from the wall at least
    left_handed    axes stored from right to left, values as floating-point numbers
    copied         every second voxel along each axis, copied to voxels of 1.1 mm (the nearest one's label)

A row is right if the lumen has no problem, all vessels are found by their names and no others, each leaves the vessel
that it was drawn to leave (not asked where labels are swapped), every target lies within 3 mm of the vessel's true
centreline, no vessel ends 8 mm and a tenth of its length before its labels do, and there is no wall within half of the
aorta's radius or a quarter of another vessel's. Last line: one JSON object {"rows": {case: {...}}, "right", "tried"}.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

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
from cathsim.anatomy.vessel_tree import Branch, VesselTree, nearest_on_branch
from cathsim.anatomy.volume.rasterising import rasterise, save_nifti

SPACING = (0.8e-3, 0.8e-3, 1.5e-3)  # m
VEIN = 250  # a label without a name
COPIED = 1.1e-3  # m between voxels to which coarser ones are copied
EARLY = (8e-3, 0.1)  # m and share of a vessel's length by which it may end before its labels
FEW = 300  # voxels (of 1 mm^3 about): a vessel of which less is left need not be found

Array = NDArray[np.float64]
Labels = NDArray[np.uint8]


@dataclass
class Drawn:
    """Labels with what is known of them."""

    labels: Labels
    affine: Array
    numbers: dict[str, int]
    tree: VesselTree  # of the phantom's frame
    offset: Array  # m, the phantom's frame from the patient's (left, posterior, superior)

    @property
    def spacing(self) -> Array:
        """(3,) m between voxels."""
        sides: Array = 1e-3 * np.linalg.norm(self.affine[:3, :3], axis=0)
        return sides

    def world(self) -> Array:
        """(nx, ny, nz, 3) places of voxels in the phantom's frame, m."""
        index = np.stack(np.meshgrid(*[np.arange(n) for n in self.labels.shape], indexing="ij"), axis=-1)
        placed = index @ self.affine[:3, :3].T + self.affine[:3, 3]
        result: Array = 1e-3 * placed * [-1.0, -1.0, 1.0] + self.offset
        return result


Fault = Callable[[Drawn, np.random.Generator], None]


def _share_along(drawn: Drawn, name: str) -> tuple[NDArray[np.bool_], Array, float]:
    """Voxels of a vessel, the arc length of each from the take-off's voxels, and the vessel's length in them, m."""
    mask = drawn.labels == drawn.numbers[name]
    _, arc, _ = nearest_on_branch(drawn.tree[name], drawn.world()[mask])
    low, high = np.percentile(arc, [1, 99]) if len(arc) else (0.0, 0.0)
    return mask, arc - low, float(high - low)


def _branches(drawn: Drawn) -> list[str]:
    return [name for name in drawn.numbers if name != "aorta"]


def _relabel(drawn: Drawn, name: str, low: float, high: float, value: int, metres: bool = False) -> None:
    mask, arc, length = _share_along(drawn, name)
    scale = 1.0 if metres else length
    chosen = (arc >= low * scale) & (arc < high * scale)
    places = np.argwhere(mask)[chosen]
    drawn.labels[tuple(places.T)] = value


def as_drawn(drawn: Drawn, generator: np.random.Generator) -> None:
    """None."""


def ostium_gap(drawn: Drawn, generator: np.random.Generator) -> None:
    for name in _branches(drawn):
        _relabel(drawn, name, -1.0, 4e-3, 0, metres=True)


def gap(drawn: Drawn, generator: np.random.Generator) -> None:
    for name in _branches(drawn):
        _, _, length = _share_along(drawn, name)
        _relabel(drawn, name, length / 2 - 2e-3, length / 2 + 2e-3, 0, metres=True)


def specks(drawn: Drawn, generator: np.random.Generator) -> None:
    values = list(drawn.numbers.values())
    for _ in range(60):
        corner = [int(generator.integers(0, n - 2)) for n in drawn.labels.shape]
        block = tuple(slice(c, c + int(generator.integers(1, 3))) for c in corner)
        drawn.labels[block] = int(generator.choice(values))


def ragged(drawn: Drawn, generator: np.random.Generator) -> None:
    inside = drawn.labels > 0
    nearest = ndimage.distance_transform_edt(~inside, return_distances=False, return_indices=True)
    outer = ndimage.binary_dilation(inside) & ~inside & (generator.random(inside.shape) < 0.2)
    inner = inside & ~ndimage.binary_erosion(inside) & (generator.random(inside.shape) < 0.2)
    drawn.labels[outer] = drawn.labels[tuple(nearest)][outer]
    drawn.labels[inner] = 0


def eroded(drawn: Drawn, generator: np.random.Generator) -> None:
    drawn.labels[~ndimage.binary_erosion(drawn.labels > 0, border_value=1)] = 0


def thick(drawn: Drawn, generator: np.random.Generator) -> None:
    inside = drawn.labels > 0
    nearest = ndimage.distance_transform_edt(~inside, return_distances=False, return_indices=True)
    grown = ndimage.binary_dilation(inside) & ~inside
    drawn.labels[grown] = drawn.labels[tuple(nearest)][grown]


def swapped(drawn: Drawn, generator: np.random.Generator) -> None:
    for name in _branches(drawn):
        if drawn.tree[name].parent == "aorta":
            _relabel(drawn, name, -1.0, 1 / 3, drawn.numbers["aorta"])


def tip_swapped(drawn: Drawn, generator: np.random.Generator) -> None:
    names = _branches(drawn)
    for name, other in zip(names, names[1:] + names[:1], strict=True):
        _relabel(drawn, name, 0.8, 2.0, drawn.numbers[other])


def short(drawn: Drawn, generator: np.random.Generator) -> None:
    height = drawn.world()[..., 2]
    top = height[drawn.labels == drawn.numbers["aorta"]].max()
    keep = np.flatnonzero((height < top + 20e-3).any(axis=(0, 1)))
    drawn.labels = drawn.labels[:, :, keep.min() : keep.max() + 1]
    drawn.affine = drawn.affine.copy()
    drawn.affine[:3, 3] += drawn.affine[:3, 2] * keep.min()


def one_label(drawn: Drawn, generator: np.random.Generator) -> None:
    drawn.labels = (drawn.labels > 0).astype(np.uint8)
    drawn.numbers = {"": 1}


def vein(drawn: Drawn, generator: np.random.Generator) -> None:
    world = drawn.world()
    aorta = world[drawn.labels == drawn.numbers["aorta"]]
    top = aorta[aorta[:, 2].argmax()]
    across = np.linalg.norm((world - (top + np.array([0.0, -14e-3, 15e-3])))[..., 1:], axis=-1) < 6e-3
    drawn.labels[across & (drawn.labels == 0)] = VEIN


def leak(drawn: Drawn, generator: np.random.Generator) -> None:
    world = drawn.world()
    aorta = drawn.labels == drawn.numbers["aorta"]
    rim = world[aorta & ~ndimage.binary_erosion(aorta)]
    low = rim[rim[:, 2] < np.median(rim[:, 2])]
    centre = low[int(generator.integers(len(low)))]
    ball = np.linalg.norm(world - centre, axis=-1) < 10e-3
    drawn.labels[ball & (drawn.labels == 0)] = drawn.numbers["aorta"]


def bridge(drawn: Drawn, generator: np.random.Generator) -> None:
    names = _branches(drawn)
    for name, other in pairwise(names):
        _, arc, length = _share_along(drawn, name)
        first = np.argwhere(drawn.labels == drawn.numbers[name])[np.abs(arc - length / 2).argmin()]
        others = np.argwhere(drawn.labels == drawn.numbers[other])
        second = others[np.linalg.norm((others - first) * drawn.spacing, axis=1).argmin()]
        for share in np.linspace(0, 1, 200):
            place = np.round(first + share * (second - first)).astype(int)
            block = tuple(slice(p, p + 2) for p in place)
            part = drawn.labels[block]
            part[part == 0] = drawn.numbers[name if share < 0.5 else other]


def holes(drawn: Drawn, generator: np.random.Generator) -> None:
    world = drawn.world()
    depth = ndimage.distance_transform_edt(drawn.labels > 0, sampling=drawn.spacing)
    inner = np.argwhere(depth > 3e-3)
    for place in inner[generator.integers(0, len(inner), 12)]:
        radius = min(generator.uniform(2e-3, 4e-3), depth[tuple(place)] - 1.5e-3)
        drawn.labels[np.linalg.norm(world - world[tuple(place)], axis=-1) < radius] = 0


def left_handed(drawn: Drawn, generator: np.random.Generator) -> None:
    drawn.labels = drawn.labels[::-1].astype(np.float32)
    flip = np.diag([-1.0, 1.0, 1.0, 1.0])
    flip[0, 3] = drawn.labels.shape[0] - 1
    drawn.affine = drawn.affine @ flip


def copied(drawn: Drawn, generator: np.random.Generator) -> None:
    coarse = drawn.labels[::2, ::2, ::2]
    ratio = COPIED / (2 * drawn.spacing)  # coarse voxels a new one
    shape = np.floor(np.array(coarse.shape) / ratio).astype(int)
    drawn.labels = ndimage.affine_transform(coarse, np.diag(ratio), (ratio - 1) / 2, tuple(shape), order=0)
    step = np.diag([*(2 * ratio), 1.0])
    step[:3, 3] = ratio - 1
    drawn.affine = drawn.affine @ step


FAULTS: dict[str, Fault] = {
    fault.__name__: fault
    for fault in (
        as_drawn,
        ostium_gap,
        gap,
        specks,
        ragged,
        eroded,
        thick,
        swapped,
        tip_swapped,
        short,
        one_label,
        vein,
        leak,
        bridge,
        holes,
        left_handed,
        copied,
    )
}


SWAPPED = (swapped.__name__, tip_swapped.__name__)  # labels that say no longer which vessel leaves which


def draw_arch(setting: str, seed: int) -> Drawn:
    """Labels of a random arch; those without a name are not numbered."""
    truth = load_phantom(setting, seed=seed)
    numbers = {name: number for number, name in enumerate(truth.tree.names, 1)}
    labels, affine = rasterise(truth, SPACING, None, numbers)
    return Drawn(labels, affine, numbers, truth.tree, np.zeros(3))


def draw_file(path: Path) -> Drawn:
    """Labels of a file; what its import without a fault finds is the truth."""
    import nibabel

    image = nibabel.load(path)
    with tempfile.TemporaryDirectory() as folder:
        truth = import_anatomy(path, cache_dir=Path(folder))
    assert truth.imported is not None
    from cathsim.anatomy.vessel_names import TOTALSEGMENTATOR

    labels = np.asarray(image.dataobj).astype(np.uint8)
    numbers = {
        name: value for value, name in TOTALSEGMENTATOR.items() if name in truth.tree and (labels == value).any()
    }
    labels[~np.isin(labels, list(numbers.values()))] = 0
    return Drawn(labels, image.affine, numbers, truth.tree, np.array(truth.imported.offset))


def judge(path: Path, drawn: Drawn, *, take_offs: bool) -> dict[str, Any]:
    """Imports labels and compares what is found with the truth.

    Args:
        take_offs: whether the labels still say which vessel leaves which.
    """
    with tempfile.TemporaryDirectory() as folder:
        try:
            found = import_anatomy(path, cache_dir=Path(folder))
        except (MeshRefusedError, ValueError) as error:
            return {"right": False, "problems": [f"refused: {error}"], "notes": []}
    assert found.imported is not None
    problems = list(check_lumen(found, required_radius=LEAST_RADIUS).problems)
    left = {name: np.count_nonzero(drawn.labels == drawn.numbers.get(name, 1)) for name in drawn.tree.names}
    known = {name for name, voxels in left.items() if voxels} - {"sac"}
    problems += [f"missing: {name}" for name in sorted(known - set(found.tree.names)) if left[name] >= FEW]
    problems += [f"added: {name}" for name in sorted(set(found.tree.names) - known)]
    offset = np.array(found.imported.offset) - drawn.offset
    for name, target in found.targets.items():
        if name in drawn.tree:
            _, _, away = nearest_on_branch(drawn.tree[name], np.asarray(target.position)[None] - offset)
            if away[0] > NEAR:
                problems.append(f"target {name}: {1e3 * away[0]:.1f} mm from the vessel's centreline")
    for branch in drawn.tree:
        if branch.name not in found.tree:
            continue
        parent = found.tree[branch.name].parent
        if take_offs and parent != branch.parent and branch.parent in found.tree:
            problems.append(f"{branch.name} leaves {parent} instead of {branch.parent}")
        _, arc, _ = nearest_on_branch(branch, found.tree[branch.name].points - offset)
        if (early := _labelled_end(drawn, branch) - arc.max()) > EARLY[0] + EARLY[1] * branch.length:
            problems.append(f"{branch.name} ends {1e3 * early:.0f} mm before its labels")
        first, last = max(0.1 * branch.length, arc[0]), min(0.9 * branch.length, arc[-1] - 5e-3)
        if last <= first:  # a stump of which no stretch is away from both ends
            continue
        at = np.linspace(first, last, 100)
        share = 0.5 if branch.parent is None else 0.25
        ring = share * branch.radius_at(at)[:, None, None] * CORNERS
        blocked = found.grid.sample(branch.point_at(at)[:, None] + ring + offset) <= 0
        if blocked.mean() > BLOCKED:
            problems.append(f"{branch.name}: {100 * blocked.mean():.1f} % of its inside is wall")
    return {"right": not problems, "problems": problems, "notes": list(found.imported.notes)}


def _labelled_end(drawn: Drawn, branch: Branch) -> float:
    """Arc length (m) up to which a vessel's labels reach along it."""
    voxels = np.argwhere(drawn.labels == drawn.numbers.get(branch.name, 0)) if branch.name in drawn.numbers else []
    if len(voxels) < FEW or branch.parent is None:
        return 0.0
    places = 1e-3 * (voxels @ drawn.affine[:3, :3].T + drawn.affine[:3, 3]) * [-1.0, -1.0, 1.0] + drawn.offset
    _, arc, away = nearest_on_branch(branch, places)
    return float(np.percentile(arc[away < 2 * branch.radius_at(arc)], 98))


def run_case(source: str, fault: str, seed: int, setting: str) -> dict[str, Any]:
    """One source with one fault, in this process."""
    drawn = draw_arch(setting, int(source)) if source.isdigit() else draw_file(Path(source))
    FAULTS[fault](drawn, np.random.default_rng(seed))
    with tempfile.TemporaryDirectory() as folder:
        names = {number: name for name, number in drawn.numbers.items() if name}
        path = save_nifti(Path(folder) / "labels.nii.gz", drawn.labels, drawn.affine, names)
        return judge(path, drawn, take_offs=fault not in SWAPPED)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("path", nargs="?", help="a NIfTI file of TotalSegmentator's labels, instead of arches")
    parser.add_argument("--arches", type=int, default=3)
    parser.add_argument("--first", type=int, default=2000, help="seed of the first arch")
    parser.add_argument("--setting", default=SCAN, choices=RANDOM, help="of the arches")
    parser.add_argument("--faults", default=",".join(FAULTS), help="some of them, with commas between")
    parser.add_argument("--seed", type=int, default=0, help="of what is random in a fault")
    parser.add_argument("--one", help=argparse.SUPPRESS)
    options = parser.parse_args()
    faults = chosen_faults(parser, options, FAULTS)
    if options.one:
        print(json.dumps(run_case(options.one, faults[0], options.seed, options.setting)))
        return
    further = ["--seed", str(options.seed), "--setting", options.setting]
    run_cases(__file__, faults, [options.path] if options.path else arches(options), further)


if __name__ == "__main__":
    main()
