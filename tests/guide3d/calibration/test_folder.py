"""Folders of calibration: one set of cameras, several, or half of one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from guide3d.calibration.folder import cameras_in, rigs_in
from guide3d.geometry.camera import write_camera, write_opencv_yaml
from guide3d.reconstruction.synthetic_scene import scenes

CAMERAS = next(iter(scenes(1, seed=5))).cameras


def _write(folder: Path, *names: str) -> Path:
    for camera, name in zip(CAMERAS, names, strict=False):
        write_opencv_yaml(camera, folder / name)
    return folder


@pytest.mark.parametrize(
    ("names", "name"),
    [
        (("cam_16710.yaml", "cam_16709.yaml"), "cam_*.yaml"),
        (("camera_a.yaml", "camera_b.yaml"), "*.yaml"),
        (("Camera_A.YAML", "Camera_B.YAML"), "*.YAML"),
        (("Cam_16710.YML", "Cam_16709.YML"), "Cam_*.YML"),
        (("left_16710.yaml", "right_16709.yaml"), "left_16710.yaml, right_16709.yaml"),
    ],
)
@pytest.mark.parametrize("below", ["calibration"])
def test_one_set_is_found(tmp_path: Path, names: tuple[str, str], name: str, below: str) -> None:
    _write(tmp_path / below, *names)
    (rig,) = rigs_in(tmp_path)
    cameras = cameras_in(tmp_path)
    assert rig.name == name
    assert cameras is not None
    for camera, read, expected in zip(rig.cameras, cameras, CAMERAS, strict=True):
        assert np.allclose(camera.P, expected.P)
        assert np.array_equal(camera.P, read.P)


@pytest.mark.parametrize(("ending", "unit", "away"), [("txt", "mm", r"\d+e\+0\d|\d{4}"), ("yaml", "cm", r"\d\d\.\d+")])
def test_cameras_in_another_unit_are_refused(tmp_path: Path, ending: str, unit: str, away: str) -> None:
    for camera, detector in zip(CAMERAS, (16710, 16709), strict=True):
        path = tmp_path / f"cam_{detector}.{ending}"
        (write_camera if ending == "txt" else write_opencv_yaml)(camera, path, unit)
        if ending == "yaml":
            path.write_text(path.read_text().replace("world_unit", "made_in"))
    with pytest.raises(ValueError, match=rf"cam_16709\.{ending}: the views meet ({away}) mm from the X-ray sources"):
        rigs_in(tmp_path)


def test_several_sets_are_listed_or_refused(tmp_path: Path) -> None:
    _write(tmp_path, "may_16710.yaml", "may_16709.yaml")
    _write(tmp_path, "june_16710.yaml", "june_16709.yaml")
    assert [rig.name for rig in rigs_in(tmp_path)] == ["june_*.yaml", "may_*.yaml"]
    with pytest.raises(ValueError, match=r"several sets of cameras \(june_\*.yaml, may_\*.yaml\)"):
        cameras_in(tmp_path)


def test_half_a_set_or_none(tmp_path: Path) -> None:
    assert cameras_in(tmp_path) is None
    with pytest.raises(FileNotFoundError, match="holds no cameras"):
        rigs_in(tmp_path)
    _write(tmp_path, "may_16710.yaml")
    for read in (cameras_in, rigs_in):
        with pytest.raises(FileNotFoundError, match=r"camera B, \*16709\*.txt or .yaml, is missing"):
            read(tmp_path)
    with pytest.raises(FileNotFoundError, match="expected a folder with camera files"):
        cameras_in(tmp_path / "none")


def test_files_that_make_no_set(tmp_path: Path) -> None:
    _write(tmp_path, "one_16710.yaml", "three_16709.yaml")
    _write(tmp_path, "two_16710.yaml")
    with pytest.raises(ValueError, match="several files"):
        cameras_in(tmp_path)
