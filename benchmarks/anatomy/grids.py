"""Memory and speed of distance grids and geodesic fields stored in blocks near the vessel.

    python benchmarks/anatomy/grids.py [--quick] [--resolution M] [--against FOLDER]

From the femoral to the carotid arteries: a Type I arch whose aorta goes on through the pelvis to one groin, with the
other side as a branch, about 650 mm high. Everything that reads grids works on it, with the fields of six targets in
memory. With --against, another version's source folder (its native code built), the simulator of both takes turns in
one run. Prints tables and, as its last line, one JSON object:
    grid_mb, dense_mb            the long vessel's grid, and what its box would be
    field_mb                     a geodesic field of it, mean
    held_mb, peak_mb             resident memory with grid and six fields, and the most while anything below worked
    build_cpu_s, field_cpu_s     processor time of grid and field
    arch_mb, arch_dense_mb       grid and fields of three targets of 12 arches at 1 mm, mean
    step_ratio                   processor time of a control step over the other version's, median
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

for _threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_threads, "1")

import numpy as np  # noqa: E402 - after the thread limits, which it reads once

import cathsim  # noqa: E402
from cathsim import ACCURACY, NavigateEnv, Simulation, load_guidewire, load_phantom  # noqa: E402
from cathsim.anatomy import Branch, Phantom, VesselTree  # noqa: E402
from cathsim.anatomy.entry import locate_entries  # noqa: E402
from cathsim.anatomy.generator.aortic_arch import build_arch  # noqa: E402
from cathsim.anatomy.generator.random_arch import sample_parameters  # noqa: E402
from cathsim.anatomy.library import NAMED, build_phantom  # noqa: E402
from cathsim.anatomy.lumen import build_lumen  # noqa: E402
from cathsim.anatomy.lumen_report import check_lumen  # noqa: E402
from cathsim.anatomy.phantom import locate_targets  # noqa: E402
from cathsim.anatomy.phantom_cache import PhantomCache  # noqa: E402
from cathsim.anatomy.pictures.phantom_picture import draw_phantom  # noqa: E402
from cathsim.anatomy.surface import lumen_surface  # noqa: E402
from cathsim.anatomy.vessel_tree import nearest_on_branch  # noqa: E402
from cathsim.blood.field import blood_field  # noqa: E402
from cathsim.blood.flow import BloodFlow  # noqa: E402
from cathsim.console.web.messages import surface_of  # noqa: E402
from cathsim.fluoroscopy import Projector, background_image  # noqa: E402
from cathsim.planning.path import plan_path  # noqa: E402

TARGETS = ("bca", "lcca", "lsa", "rsa", "rcca", "iliac_end")
ARCHES = 12
_MB = 1e-6
_SIMULATE = """
import json, sys, time
import numpy as np
from cathsim import NavigateEnv
env = NavigateEnv(sys.argv[1], "lcca", observation=sys.argv[2])
env.reset(seed=0)
print("ready", flush=True)
for line in sys.stdin:
    generator, spent, rewards = np.random.default_rng(int(line)), 0.0, 0.0
    for forward in (False, True):
        actions = generator.uniform(-1, 1, (int(sys.argv[3]) // 2, 2))
        if forward:
            actions[:, 0] = 1
        env.reset(seed=int(line))
        start = time.process_time()
        for number, action in enumerate(actions):
            _, reward, ended, cut, _ = env.step(action)
            rewards += reward
            if ended or cut or number % 120 == 119:
                env.reset()
        spent += time.process_time() - start
    print(json.dumps([spent / int(sys.argv[3]), rewards]), flush=True)
"""


def resident_mb(key: str) -> float:
    """VmRSS or VmHWM of this process, MB."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(key):
            return float(line.split()[1]) * 1024 * _MB
    raise RuntimeError(f"/proc/self/status has no {key}")


class Ledger:
    """Processor time and peak memory of one piece of work after the other."""

    def __init__(self) -> None:
        self.peak = 0.0
        print(f"{'':34s}{'CPU s':>8s}{'peak MB':>9s}{'held MB':>9s}")

    def run(self, name: str, work: Callable[[], Any]) -> Any:
        """Does a piece of work and prints what it took."""
        Path("/proc/self/clear_refs").write_text("5")  # the peak begins anew
        start = time.process_time()
        result = work()
        spent, peak = time.process_time() - start, resident_mb("VmHWM")
        self.peak = max(self.peak, peak)
        print(f"{name:34s}{spent:8.1f}{peak:9.0f}{resident_mb('VmRSS'):9.0f}", flush=True)
        return result, spent


def long_tree() -> VesselTree:
    """A vessel tree from the groins to the carotid arteries: the arch of Type I on a longer aorta."""
    arch = build_arch(NAMED["type_1"])
    below = np.linspace(0.0, 1.0, 400)[:-1]
    away = 1.0 - below
    course = arch.root.points[0] + np.stack([-0.12 * away**2, 0.05 * np.sin(np.pi * away), -0.36 * away], axis=1)
    width = np.interp(below, [0.0, 0.35, 0.6, 1.0], [0.004, 0.005, 0.009, arch.root.radius[0]])
    points = np.concatenate([course, arch.root.points])
    aorta = Branch("aorta", points, np.concatenate([width, arch.root.radius]))
    branches = [aorta]
    for branch in arch.branches[1:]:
        on_aorta = branch.parent == "aorta"
        arc = float(nearest_on_branch(aorta, branch.points[:1])[1][0]) if on_aorta else branch.parent_arc
        branches.append(Branch(branch.name, branch.points, branch.radius, branch.parent, arc, branch.open_end))
    bifurcation, along = 160, np.linspace(0.0, 1.0, 250)
    other = points[bifurcation] + np.stack([0.12 * along**1.5, -0.02 * along, -0.2 * along], axis=1)
    radius = np.linspace(0.006, 0.004, len(along))
    branches.append(Branch("iliac", other, radius, "aorta", float(aorta.arc[bifurcation])))
    return VesselTree(tuple(branches))


def long_phantom(resolution: float) -> Phantom:
    """The phantom of `long_tree`, built without a cache."""
    tree = long_tree()
    grid = build_lumen(tree, resolution=resolution, fillet_radius=NAMED["type_1"].fillet_radius)
    return Phantom("long", "0" * 32, None, tree, grid, locate_targets(tree), locate_entries(tree))


def readers(phantom: Phantom, folder: Path) -> dict[str, Callable[[], Any]]:
    """What reads grids, by a name: each a piece of work."""
    grid, place = phantom.grid, phantom.target("lcca").position
    start = phantom.entry().position
    middle = tuple(float(x) for x in phantom.bounds.mean(axis=0))
    cache = PhantomCache(folder)
    wire = load_guidewire("default").scaled(0.75)

    def navigate() -> None:
        env = NavigateEnv(phantom, "lcca", wire=wire, observation=("roadmap", "image"), reward="geodesic")
        env.reset(seed=0)
        for _ in range(60):
            env.step(np.array([1.0, 0.3]))

    return {
        "check of the lumen": lambda: check_lumen(phantom),
        "shortest path": lambda: plan_path(grid, start, place),
        "path off the walls": lambda: plan_path(grid, start, place, preferred_clearance=5e-3),
        "X-ray background, 480 px": lambda: background_image(
            grid, Projector.c_arm(centre=middle, field_of_view=0.4, size=480)
        ),
        "60 steps, roadmap and image": navigate,
        "blood's field": lambda: blood_field(phantom, BloodFlow()),
        "cache file written": lambda: cache.write(phantom),
        "cache file read, one field": lambda: cache.read("again", phantom.hash, None).geodesic_field("lcca"),  # type: ignore[union-attr]
        "console's surface": lambda: surface_of(phantom),
        "silhouette": lambda: grid.silhouette(1),
        "picture": lambda: draw_phantom(phantom, folder / "picture.png"),
        "surface of the lumen": lambda: lumen_surface(grid),
        "wall, 1.5 mm": lambda: phantom.wall_mesh(),
    }


def measure_long(resolution: float) -> dict[str, float]:
    """Memory and processor time of everything that reads the grid of the long vessel."""
    Simulation(load_phantom("type_1"), load_guidewire("default"), ACCURACY["fast"])  # loads what is loaded once
    ledger = Ledger()
    phantom, build = ledger.run("grid", lambda: long_phantom(resolution))
    dense = float(np.prod(phantom.grid.shape)) * 4 * _MB
    fields, spent = ledger.run("fields of six targets", lambda: [phantom.geodesic_field(name) for name in TARGETS])
    held = resident_mb("VmRSS")
    with tempfile.TemporaryDirectory() as folder:
        for name, work in readers(phantom, Path(folder)).items():
            ledger.run(name, work)
        file = sum(path.stat().st_size for path in Path(folder).rglob("*.npz")) * _MB
    size = " x ".join(f"{1e3 * x:.0f}" for x in np.ptp(phantom.grid.bounds, axis=0))
    nodes = " x ".join(str(n) for n in phantom.grid.shape)
    grid_mb, field_mb = phantom.grid.nbytes * _MB, statistics.mean(field.nbytes for field in fields) * _MB
    print(f"\n{size} mm at {1e3 * resolution:g} mm: {nodes} nodes, {dense:.0f} MB if dense, {grid_mb:.0f} MB in blocks")
    print(f"a field {field_mb:.0f} MB; cache file with five fields {file:.0f} MB\n")
    return {
        "grid_mb": grid_mb,
        "dense_mb": dense,
        "field_mb": field_mb,
        "held_mb": held,
        "peak_mb": ledger.peak,
        "build_cpu_s": build,
        "field_cpu_s": spent / len(TARGETS),
    }


def measure_arches(count: int) -> dict[str, float]:
    """Memory of random arches at 1 mm, each with the fields of three targets."""
    blocks, dense = [], []
    for seed in range(count):
        phantom = build_phantom(f"arch_{seed}", sample_parameters(np.random.default_rng(seed)))
        parts = (phantom.grid, *(phantom.geodesic_field(name) for name in ("bca", "lcca", "lsa")))
        blocks.append(sum(part.nbytes for part in parts) * _MB)
        dense.append(4.0 * len(parts) * float(np.prod(phantom.grid.shape)) * _MB)
    print(f"{count} arches at 1 mm with three fields: {statistics.mean(blocks):.1f} MB, at most {max(blocks):.1f} MB")
    print(f"dense: {statistics.mean(dense):.1f} MB, at most {max(dense):.1f} MB\n")
    return {"arch_mb": statistics.mean(blocks), "arch_dense_mb": statistics.mean(dense)}


def measure_against(other: Path, rounds: int, steps: int) -> dict[str, float]:
    """Processor time of a control step over another version's, in turns; both must earn the same rewards."""
    own = Path(cathsim.__file__).parents[1]
    ratios: list[float] = []
    for name, observation in (("type_1", "tip"), ("type_1", "roadmap"), ("bovine", "tip"), ("bovine", "roadmap")):
        processes = []
        for source in (other, own):
            environment = {**os.environ, "PYTHONPATH": str(source)}
            command = [sys.executable, "-c", _SIMULATE, name, observation, str(steps)]
            pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
            processes.append(subprocess.Popen(command, env=environment, text=True, **pipes))  # type: ignore[call-overload]
        for process in processes:
            process.stdout.readline()
        pairs, same = [], True
        for seed in range(rounds):
            measured = {}
            for index in (0, 1) if seed % 2 else (1, 0):
                processes[index].stdin.write(f"{seed}\n")
                processes[index].stdin.flush()
                measured[index] = json.loads(processes[index].stdout.readline())
            pairs.append(measured[1][0] / measured[0][0])
            same &= measured[1][1] == measured[0][1]
        for process in processes:
            process.stdin.close()
            process.wait()
        ratios.append(statistics.median(pairs))
        verdict = "the same rewards" if same else "OTHER REWARDS"
        print(f"{name:10s}{observation:10s} time over the other version's {ratios[-1]:.3f}, {verdict}", flush=True)
    return {"step_ratio": statistics.median(ratios)}


def main() -> None:
    """Runs the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="coarser and fewer, under 60 s")
    parser.add_argument("--resolution", type=float, help="m between nodes of the long vessel (0.0005; quick 0.001)")
    parser.add_argument("--against", type=Path, metavar="FOLDER", help="another version's packages/cathsim/src, built")
    arguments = parser.parse_args()
    quick = arguments.quick
    result = measure_long(arguments.resolution or (1e-3 if quick else 5e-4)) | measure_arches(3 if quick else ARCHES)
    if arguments.against:
        result |= measure_against(arguments.against, 3 if quick else 9, 400 if quick else 800)
    print(json.dumps({name: round(value, 3) for name, value in result.items()}))


if __name__ == "__main__":
    main()
