"""Files of other programs and of devices: surfaces, volumes, images, texts; damaged bytes, other faces and values."""

import logging
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import nibabel
import nrrd
import numpy as np
import pytest
import SimpleITK
import trimesh
import yaml

from cathsim.anatomy import import_anatomy
from cathsim.anatomy.mesh.parts.vessel_parts import read_parts
from cathsim.anatomy.volume.files.reading import read_labels
from cathsim.devices.catheter import Catheter
from cathsim.devices.device_file import CATHETER, FOLDERS, PRESETS
from cathsim.devices.shelf import load_catheter
from cathsim.guidewire import Guidewire, load_guidewire
from guide3d.calibration.cube_files import read_beads
from guide3d.geometry.camera import read_camera
from guide3d.image_file import read_grey_levels
from tests.cathsim.anatomy.generator.drawn_arch import arch_mesh
from tests.cathsim.anatomy.volume.files.test_hostile_volumes import tubes
from tests.fuzz.mutations import altered, damaged, rewritten
from tests.fuzz.promise import BrokenPromiseError, fuzz, refused
from tests.integration.documents.pages import PROJECT_ROOT

VTK = PROJECT_ROOT / "tests" / "cathsim" / "anatomy" / "mesh" / "files" / "vtk"
CAMERA = "image size\n1024,1024\n\ncamera matrix\n7000,0,500\n0,7000,510\n0,0,1\n\nrotation\n1,0,0\n0,1,0\n0,0,1\n\n" \
         "translation\n1\n2\n90\n"  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One small file of each kind, by the program that usually writes it."""
    folder = tmp_path_factory.mktemp("files")
    for kind in ("stl", "ply", "obj", "glb"):
        trimesh.creation.icosphere(1).export(folder / f"surface.{kind}")
    labels = tubes()
    nibabel.save(nibabel.Nifti1Image(labels, np.diag([0.8, 0.9, 2.0, 1.0])), folder / "labels.nii.gz")  # type: ignore[no-untyped-call]
    nrrd.write(str(folder / "labels.nrrd"), labels, {"space": "left-posterior-superior", "space directions": np.eye(3)})
    SimpleITK.WriteImage(SimpleITK.GetImageFromArray(labels), str(folder / "labels.mha"), True)
    picture = np.random.default_rng(0).integers(0, 255, (64, 80), np.uint8)
    for kind in ("png", "jpg", "tif", "bmp"):
        cv2.imwrite(str(folder / f"image.{kind}"), picture)
    (folder / "camera.txt").write_text(CAMERA)
    beads = "".join(f"{x},{y},{z}\n" for x in range(4) for y in range(4) for z in range(4))
    (folder / "beads_cm.csv").write_text(f"x,y,z\n{beads}")
    return folder


def verdict(path: Path, read: Callable[[Path], Any], data: bytes, whole: Any) -> str:
    """Reads damaged bytes: finite numbers, or a refusal."""
    victim = path.with_name(f"victim{''.join(path.suffixes)}")
    victim.write_bytes(data)
    try:
        values = read(victim)
    except (ValueError, OSError) as error:
        return refused(error)
    if not np.isfinite(values).all():
        raise BrokenPromiseError("what was read is not finite")
    return "equal" if np.array_equal(values, whole) else "accepted"


def vertices(path: Path) -> Any:
    return np.concatenate([part.mesh.vertices for part in read_parts(path).parts])


def voxels(path: Path) -> Any:
    return read_labels(path, {1: "aorta", 2: "lsa"}).vessels


def matrix(path: Path) -> Any:
    return read_camera(path).P


def hurt(path: Path, rng: random.Random, text: bool = False) -> bytes:
    """A file's bytes, or lines of a text, with damage."""
    whole = path.read_bytes()
    if text and rng.random() < 0.7:
        return rewritten(whole.decode(), rng).encode("utf-8", "replace")
    return damaged(whole, rng)


@fuzz(seconds=10)
def test_surfaces(rng: random.Random, folder: Path) -> str:
    """A damaged surface is read with finite vertices, or refused."""
    written = [
        path for path in sorted(VTK.iterdir()) if path.suffix in (".vtp", ".vtk", ".stl") and path.name != "grid.vtk"
    ]
    source = rng.choice([*sorted(folder.glob("surface.*")), *written])
    copy = folder / f"copy{source.suffix}"
    copy.write_bytes(source.read_bytes())
    return verdict(copy, vertices, hurt(source, rng), None)


@fuzz(414, seconds=10)
def test_packed_volumes(rng: random.Random, folder: Path) -> str:
    """A damaged volume with a checksum over its values has the same labels, or is refused."""
    path = folder / f"labels.{rng.choice(('nii.gz', 'nrrd', 'mha'))}"
    found = verdict(path, voxels, hurt(path, rng), voxels(path))
    if found == "accepted":
        raise BrokenPromiseError("a damaged volume has other labels")
    return found


@fuzz()
def test_images(rng: random.Random, folder: Path) -> str:
    """A damaged image is read with finite levels, or refused."""
    path = rng.choice(sorted(folder.glob("image.*")))
    return verdict(path, lambda path: read_grey_levels(path), hurt(path, rng), None)


@fuzz()
def test_cameras_and_beads(rng: random.Random, folder: Path) -> str:
    """A damaged text has finite numbers, or is refused."""
    path, read = rng.choice(((folder / "camera.txt", matrix), (folder / "beads_cm.csv", read_beads)))
    return verdict(path, read, hurt(path, rng, text=True), read(path))


COARSE = 2.5e-3  # m


@pytest.fixture(scope="module")
def mesh() -> trimesh.Trimesh:
    """An arch."""
    logging.getLogger("trimesh").setLevel(logging.CRITICAL)
    return arch_mesh(0.03)


@fuzz(2005, seconds=120, megabytes=3000, slow=True)
def test_surfaces_imported(rng: random.Random, mesh: trimesh.Trimesh, folder: Path) -> str:
    """The import gives a phantom with a lumen and targets, or a refusal, within the import's own budget."""
    path = folder / f"arch.{rng.choice(('obj', 'ply', 'stl'))}"
    if rng.random() < 0.7:
        mesh.export(path)
        path.write_bytes(damaged(path.read_bytes(), rng))
    else:
        remade(mesh, rng).export(path)
    try:
        phantom = import_anatomy(path, resolution=COARSE, cache_dir=folder / "cache")
    except ValueError as error:
        return refused(error)
    ends = np.array([target.position for target in phantom.targets.values()])
    if not np.isfinite(ends).all() or not phantom.targets:
        raise BrokenPromiseError("a phantom without finite targets was imported")
    return "accepted"


def remade(mesh: trimesh.Trimesh, rng: random.Random) -> trimesh.Trimesh:
    """A mesh with faces missing, turned, doubled or of other vertices, or with vertices moved."""
    draw = np.random.default_rng(rng.randrange(2**32))
    vertices, faces = mesh.vertices.copy(), mesh.faces.copy()
    kind = rng.randrange(6)
    if kind == 0:
        faces = faces[draw.random(len(faces)) < rng.choice((0.5, 0.9, 0.99))]
    elif kind == 1:
        turned = draw.random(len(faces)) < 0.5
        faces[turned] = faces[turned, ::-1]
    elif kind == 2:
        vertices += draw.normal(size=vertices.shape) * rng.choice((1e-4, 1e-3, 1e-2))
    elif kind == 3:
        vertices *= np.array(rng.choice(((1, 1, 0), (1e-6, 1e-6, 1e-6), (1e6, 1e6, 1e6), (1, 1, 5))))
    elif kind == 4:
        faces = np.concatenate((faces, faces[draw.integers(len(faces), size=2000)]))
    else:
        faces = draw.integers(len(vertices), size=(500, 3))
    return trimesh.Trimesh(vertices, faces, process=False)


DEVICES = [(kind, path) for kind in sorted(FOLDERS) for path in sorted((PRESETS / FOLDERS[kind]).glob("*"))]


@fuzz(1534)
def test_devices(rng: random.Random, folder: Path) -> str:
    """A file that is taken gives a device, all of whose numbers its class has checked."""
    kind, preset = rng.choice(DEVICES)
    path, content = folder / "device.yaml", preset.read_bytes()
    path.write_bytes(damaged(content, rng) if rng.random() < 0.5 else altered_yaml(content, rng))
    try:
        device = load(kind, path)
    except ValueError as error:
        if str(path) not in str(error):
            raise BrokenPromiseError(f"a refusal does not name the file: {str(error)[:300]!r}") from error
        return refused(error)
    return "equal" if device == load(kind, preset) else "accepted"


def altered_yaml(content: bytes, rng: random.Random) -> bytes:
    """A file whose values are exchanged, missing or added."""
    try:
        return yaml.safe_dump(altered(yaml.safe_load(content), rng)).encode()
    except RecursionError:  # the writer has a limit of depth, too
        return b"kind: " + b"[" * 3000


def load(kind: str, path: Path) -> Guidewire | Catheter:
    """The device of a file."""
    return load_catheter(path) if kind == CATHETER else load_guidewire(path)
