"""Import of anatomies from files: what is found in them, how long it takes, how much memory it needs.

    python benchmarks/anatomy/imports.py PATH|FOLDER [--quick] [--resolution MM] [--pictures FOLDER]

Imports every surface (STL, OBJ, PLY, VTP, GLB), every label volume and every folder of one file a vessel, each in a
process of its own and without any cache. Prints a table and, as its last line, one JSON object:
{"files": {name: {"ok", "branches", "targets", "problems", "volume_cm3", "build_cpu_s", "grid_mb"}}}, and for each the
peak memory, the unit, the targets' places in the phantom's frame and the notes of the import. problems: why it was
refused, or what is wrong with its lumen; a way counts as open from 0.6 mm of radius on, so that a child's narrowed
aorta is no fault. --quick: at most 60 s a file.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from cathsim.anatomy import MeshRefusedError, import_anatomy
from cathsim.anatomy.mesh.parts.vessel_parts import is_folder_of_parts
from cathsim.anatomy.mesh.reading import SUFFIXES
from cathsim.anatomy.volume.files.reading import SUFFIXES as VOLUMES
from tests.cathsim.anatomy.lumen_report import check_lumen

QUICK_SECONDS, SECONDS = 60.0, 600.0
LEAST_RADIUS = 6e-4  # m: a wire of 0.89 mm passes
EMPTY: dict[str, Any] = {
    "ok": False,
    "branches": [],
    "targets": [],
    "places_mm": {},
    "problems": [],
    "volume_cm3": None,
    "build_cpu_s": None,
    "grid_mb": None,
    "peak_mb": None,
    "unit": None,
    "notes": [],
}


def anatomies(path: Path) -> dict[str, Path]:
    """All anatomies at or below a path, by their names relative to it; a folder with one file a vessel is one."""
    if not path.is_dir() or _is_one(path):
        return {path.name: path}
    found = {}
    for one in sorted(path.rglob("*")):
        inner = [p for p in one.relative_to(path).parents if str(p) != "." and _is_one(path / p)]
        if not inner and (_is_one(one) if one.is_dir() else one.name.lower().endswith((*SUFFIXES, *VOLUMES))):
            found[one.relative_to(path).as_posix()] = one
    return found


def _is_one(path: Path) -> bool:
    return path.is_dir() and (is_folder_of_parts(path) or is_folder_of_parts(path, VOLUMES))


def measure(path: Path, resolution: float, picture: Path | None) -> dict[str, Any]:
    """Imports one anatomy in this process."""
    row = dict(EMPTY)
    began = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        try:
            phantom = import_anatomy(path, resolution=resolution, cache_dir=Path(folder))
        except (MeshRefusedError, ValueError) as error:
            reason = error.reason if isinstance(error, MeshRefusedError) else str(error)
            return {**row, "problems": [f"refused: {reason}"], "build_cpu_s": round(time.process_time() - began, 1)}
        row["build_cpu_s"] = round(time.process_time() - began, 1)
    row["problems"] = check_lumen(phantom, required_radius=LEAST_RADIUS)
    row["ok"] = not row["problems"]
    row["branches"] = [name for name in phantom.tree.names if name != "aorta"]
    row["targets"] = list(phantom.targets)
    row["places_mm"] = {name: np.round(1e3 * t.position, 2).tolist() for name, t in phantom.targets.items()}
    row["volume_cm3"] = round(len(phantom.grid.inside()) * phantom.grid.spacing**3 * 1e6, 1)
    row["grid_mb"] = round(phantom.grid.nbytes / 1e6, 1)
    row["peak_mb"] = round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3)
    assert phantom.imported is not None
    row["unit"], row["notes"] = phantom.imported.unit, list(phantom.imported.notes)
    if picture is not None:
        from cathsim.anatomy.pictures.import_picture import draw_import

        draw_import(phantom, picture)
    return row


def measure_apart(path: Path, resolution: float, picture: Path | None, seconds: float) -> dict[str, Any]:
    """Imports one anatomy in a process of its own, which may take so many seconds of wall clock."""
    command = [sys.executable, __file__, str(path), "--one", "--resolution", str(1e3 * resolution)]
    if picture is not None:
        command += ["--pictures", str(picture)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=seconds, check=False)
    except subprocess.TimeoutExpired:
        return {**EMPTY, "problems": [f"stopped after {seconds:g} s"]}
    lines = done.stdout.strip().splitlines()
    if done.returncode or not lines:
        last = (done.stderr.strip().splitlines() or [f"exit status {done.returncode}"])[-1]
        return {**EMPTY, "problems": [f"failed: {last}"]}
    row: dict[str, Any] = json.loads(lines[-1])
    return row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("path", type=Path, help="a surface, a label volume, or a folder")
    parser.add_argument("--quick", action="store_true", help="at most 60 s a file")
    parser.add_argument("--resolution", type=float, default=1.0, help="mm between lattice points")
    parser.add_argument("--pictures", type=Path, default=None, help="folder for a picture of each phantom")
    parser.add_argument("--one", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    resolution = arguments.resolution / 1e3
    if arguments.one:
        print(json.dumps(measure(arguments.path, resolution, arguments.pictures)))
        return
    if not arguments.path.exists():
        sys.exit(f"there is no {arguments.path}; give a surface, a label volume or a folder of them.")
    if arguments.pictures is not None:
        arguments.pictures.mkdir(parents=True, exist_ok=True)
    files = {}
    print(f"{'file':32s}{'ok':>5s}{'CPU s':>8s}{'grid MB':>9s}{'peak MB':>9s}{'cm3':>8s}  branches")
    for name, path in anatomies(arguments.path).items():
        picture = None
        if arguments.pictures is not None:
            picture = arguments.pictures / f"{name.replace('/', '_')}.png"
        row = measure_apart(path, resolution, picture, QUICK_SECONDS if arguments.quick else SECONDS)
        files[name] = row
        numbers = "".join(
            f"{'-' if row[key] is None else np.format_float_positional(row[key], trim='-'):>{width}s}"
            for key, width in (("build_cpu_s", 8), ("grid_mb", 9), ("peak_mb", 9), ("volume_cm3", 8))
        )
        print(f"{name[:31]:32s}{'yes' if row['ok'] else 'no':>5s}{numbers}  {', '.join(row['branches'])}", flush=True)
        for problem in row["problems"]:
            print(f"    {problem}", flush=True)
    print(json.dumps({"files": files}))


if __name__ == "__main__":
    main()
