"""Portable MJCF: the wire, its feeder and a vessel of convex hulls as files that MuJoCo opens without this package.

python -m cathsim.export FOLDER --phantom type_1
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import re
import shutil
import sys
import tempfile
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import trimesh

from cathsim.__main__ import run
from cathsim.anatomy import PHANTOMS, Phantom, load_phantom
from cathsim.anatomy.entry import EntryLike, entry_name
from cathsim.contact.hull_vessel import hull_vessel
from cathsim.contact.hulls import Decomposition, decomposition
from cathsim.contact.sdf import GEOM_NAME
from cathsim.devices.arena import model_spec
from cathsim.guidewire import GUIDEWIRES, Guidewire, load_guidewire
from cathsim.presets import Accuracy

# Plain mj_step repeats no substep, so it needs shorter ones than the presets; ten times the mass keeps contacts stiff.
EXPORT_NUMERICS = Accuracy(timestep=0.002, refinement=1, mass_scale=10.0)  # a plain `mj_step` repeats no substep
MESHES, LUMEN, MODEL = "meshes", "lumen", "model.xml"
LUMEN_COLOUR = [0.82, 0.36, 0.34, 0.25]
VISIBLE = 0  # group of what viewers show at once; the hulls are in group 3


def export_mjcf(
    folder: str | Path,
    phantom: Phantom,
    wire: Guidewire,
    contact: str | Decomposition = "hulls",
    *,
    entry: EntryLike = "descending",
) -> Path:
    """Writes a model of a wire in a phantom that MuJoCo opens and steps by itself (tried: 3.3.7 and 4.0.0).

    The controls are the feeder's advance (m) and rotation (rad). The folder holds `model.xml` and, beside it, a mesh of
    each hull and of the lumen, which is only seen.

    Args:
        folder: is made, or replaced if it holds an earlier export.
        contact: "hulls", or how finely the wall is cut into them.
        entry: name of the phantom's entry.

    Returns:
        Path of `model.xml`.

    Raises:
        ValueError: a contact that only works inside this package, two devices, an unknown entry, or a folder with other
            files.
    """
    if not isinstance(wire, Guidewire):
        raise ValueError(
            "native code of this package rewrites the rod of a wire in a catheter at every step, which does not travel "
            f"in an MJCF file: export a Guidewire, got {type(wire).__name__}"
        )
    if contact == "sdf":
        raise ValueError(
            "contact='sdf' is native code of this package and does not travel in an MJCF file: export contact='hulls'"
        )
    folder = Path(folder)
    if folder.exists() and not (folder.is_dir() and _holds_an_export_alone(folder)):
        raise ValueError(f"{folder} is there and is no earlier export: name a new or an empty folder")
    folder.parent.mkdir(parents=True, exist_ok=True)
    # made before the wall is cut, which takes minutes
    with tempfile.TemporaryDirectory(dir=folder.parent, prefix=".exporting-") as made:
        vessel = dataclasses.replace(
            hull_vessel(phantom, entry_name(entry), decomposition(contact)), sheath_length=wire.length + 0.02
        )
        spec = model_spec(vessel, wire, EXPORT_NUMERICS)
        spec.delete(spec.geom(GEOM_NAME))
        spec.nuser_geom = 0
        spec.modelname = f"{phantom.name}_guidewire"
        # the first integrator that older versions know, too
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        spec.stat.center, spec.stat.extent = phantom.bounds.mean(axis=0), 0.3
        spec.visual.map.znear = 0.01
        spec.visual.headlight.ambient = [0.4, 0.4, 0.4]
        spec.add_mesh(name=LUMEN, inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL)
        spec.worldbody.add_geom(
            name=LUMEN,
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=LUMEN,
            rgba=LUMEN_COLOUR,
            contype=0,
            conaffinity=0,
            group=VISIBLE,
        )
        finished = Path(made) / "export"
        (finished / MESHES).mkdir(parents=True)
        surfaces = {f"hull{i}": trimesh.Trimesh(h.vertices, h.faces, process=False) for i, h in enumerate(vessel.hulls)}
        surfaces[LUMEN] = phantom.lumen_mesh
        for name, surface in surfaces.items():
            surface.export(finished / MESHES / f"{name}.stl")
        spec.meshdir = MESHES
        for mesh in spec.meshes:
            mesh.uservert, mesh.userface = [], []
            mesh.file = f"{mesh.name}.stl"
        spec.modelfiledir = str(finished)
        spec.compile()
        (finished / MODEL).write_text(_portable(spec.to_xml()), encoding="utf-8")
        mujoco.MjModel.from_xml_path(str(finished / MODEL))  # before it takes the place of an earlier one
        if folder.exists():
            shutil.rmtree(folder)
        os.replace(finished, folder)
    return folder / MODEL


def _holds_an_export_alone(folder: Path) -> bool:
    """Whether a folder may be replaced: it is empty, or has what an export writes and nothing else."""
    names = {path.relative_to(folder).as_posix() for path in folder.rglob("*")}
    needed = {MODEL, MESHES, f"{MESHES}/{LUMEN}.stl"}
    return not names or (
        needed <= names and all(re.fullmatch(rf"{MESHES}/hull\d+\.stl", name) for name in names - needed)
    )


def _portable(xml: str) -> str:
    """The position servos in the words of older versions, to which MuJoCo 4's general form of them is unknown."""
    root = ElementTree.fromstring(xml)
    for servo in root.iter("general"):
        stiffness, damping = servo.attrib.pop("gainprm"), servo.attrib.pop("biasprm").split()[2]
        for name in ("input", "biastype"):
            del servo.attrib[name]
        servo.tag = "position"
        servo.attrib |= {"kp": stiffness, "kv": damping.removeprefix("-")}
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def main(arguments: list[str] | None = None) -> int:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m cathsim.export", description=__doc__)
    parser.add_argument("folder", type=Path, help="to write to")
    parser.add_argument("--phantom", default="type_1", choices=PHANTOMS)
    parser.add_argument("--wire", default="default", choices=sorted(GUIDEWIRES))
    parser.add_argument("--entry", default="descending")
    parser.add_argument("--threshold", type=float, default=Decomposition.threshold, help="of the decomposition")
    options = parser.parse_args(arguments)
    try:
        path = export_mjcf(
            options.folder,
            load_phantom(options.phantom),
            load_guidewire(options.wire),
            Decomposition(threshold=options.threshold),
            entry=options.entry,
        )
    except (ValueError, ImportError, OSError) as error:
        sys.stderr.write(f"{error}\n")
        return 2
    sys.stdout.write(f"{path}\n")
    return 0


if __name__ == "__main__":
    run(main)
