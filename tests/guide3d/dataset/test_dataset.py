"""The data set on disk: what is read back, what is damaged, what is missing."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from guide3d.dataset.cvat import write_cvat
from guide3d.dataset.dataset import Dataset, split
from guide3d.dataset.frame import ImageError
from guide3d.dataset.true_curves import TrueCurve, write_truth
from guide3d.geometry.polyline import arc_length
from tests.guide3d.dataset.drawn_dataset import SIZE, annotation, cameras, wire, write_dataset

REAL = Path(__file__).resolve().parents[4] / "shared" / "real"


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("data") / "set"
    write_dataset(root)
    return root


@pytest.fixture
def root(kept: Path, tmp_path: Path) -> Path:
    """A copy to damage."""
    return Path(shutil.copytree(kept, tmp_path / "set"))


def change(path: Path, edit) -> None:
    content = json.loads(path.read_text(encoding="utf-8"))
    edit(content)
    path.write_text(json.dumps(content), encoding="utf-8")


def test_what_was_written_is_read(kept: Path) -> None:
    data = Dataset.open(kept)
    assert list(data.acquisitions) == ["0-bca-angle-2", "0-bca-straight-4", "1-bca-angle-1", "1-bca-straight-3"]
    assert [data.frames[i].number for i in data.acquisitions["1-bca-angle-1"]] == [0, 1, 2]
    assert data.undistorted is True
    assert data.skipped == ()
    frame = data.frames[data.acquisitions["1-bca-straight-3"][1]]
    assert (frame.fluid, frame.wire, frame.label) == (True, "straight", "1-bca-straight-3/001")
    expected = annotation("1-bca-straight-3", 1, wire(0.4 * 2 + 0.05))
    assert np.abs(frame.polyline("a") - expected.points_a).max() <= 0.0051
    assert frame.image("b").shape == (SIZE, SIZE)
    assert data.camera_a is not None
    assert np.allclose(data.camera_a.P, cameras()["a"].P)
    assert np.allclose(np.diff(arc_length(frame.curve_mm))[:-1], 0.5, atol=0.002)
    seen, drawn = data.camera_a.project(frame.curve_mm), cameras()["a"].project(wire(0.85))
    assert np.linalg.norm(seen[:, None] - drawn[None], axis=2).min(axis=1).max() < 0.3
    assert np.abs(seen[[0, -1]] - drawn[[0, -1]]).max() < 0.01
    assert np.abs(frame.spline("a").sample(50)[[0, -1]] - frame.polyline("a")[[0, -1]]).max() < 0.05
    assert np.abs(frame.reconstruction_mm[0] - wire(0.85)[0]).max() < 0.01
    assert np.allclose(np.diff(arc_length(frame.reconstruction_mm)), 1.0, atol=0.01)


def test_a_mask_covers_the_wire_of_the_image(kept: Path) -> None:
    frame = Dataset.open(kept).frames[0]
    image, mask = frame.image("a"), frame.mask("a", 3.0)
    assert set(np.unique(mask)) == {0, 255}
    assert (image[mask > 0] < 100).all()
    assert (image[mask == 0] > 100).all()


def test_truth_ends_where_the_wire_leaves_an_image(tmp_path: Path) -> None:
    root = tmp_path / "set"
    write_dataset(root, acquisitions=1, frames=1, images=False)
    write_truth(root / "truth.json", {("1-bca-angle-1", 0): TrueCurve(wire(0.0), (30.0, 20.0))})
    frame = Dataset.open(root).frames[0]
    assert arc_length(frame.curve_mm)[-1] == pytest.approx(20.0, abs=3e-3)
    assert arc_length(frame.visible_curve_mm("a"))[-1] == pytest.approx(30.0, abs=3e-3)


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        (lambda frame: frame.pop("camera2"), 'expected "camera2" or "cameraB"'),
        (lambda frame: frame["camera1"].update(points=[[3, 4]]), "at least 2 different points, got 1"),
        (lambda frame: frame["camera1"].update(points=[[1, 2], [3, None]]), "annotation of camera A|float"),
        (lambda frame: frame["camera1"]["points"].append([300, 20]), "outside the image of 128 x 128 px"),
        (lambda frame: frame["camera2"].update(image=frame["camera1"]["image"]), "both images are of camera A"),
        (lambda frame: frame["camera2"].update(image="0-bca-angle-9-1/000.png"), "two acquisitions"),
    ],
)
def test_a_damaged_entry_is_left_out_by_name(root: Path, edit, said: str) -> None:
    change(root / "raw.json", lambda videos: edit(videos[0]["frames"][1]))
    data = Dataset.open(root)
    assert len(data) == 11
    assert len(data.skipped) == 1
    with pytest.raises(ValueError, match=said):
        Dataset.open(root, strict=True)


def test_cameras_are_told_by_the_folder_not_by_the_key(root: Path) -> None:
    def swap(videos: list) -> None:
        for frame in videos[0]["frames"]:
            frame["cameraA"], frame["cameraB"] = frame.pop("camera2"), frame.pop("camera1")

    plain = Dataset.open(root)
    change(root / "raw.json", swap)
    swapped = Dataset.open(root)
    for before, after in zip(plain.frames, swapped.frames, strict=True):
        assert np.array_equal(before.polyline("a"), after.polyline("a"))


def test_missing_camera_file_and_missing_root(root: Path, tmp_path: Path) -> None:
    (root / "calibration" / "projection_16709.txt").unlink()
    with pytest.raises(FileNotFoundError, match=r"camera B, \*16709\*.txt or .yaml, is missing"):
        Dataset.open(root)
    shutil.rmtree(root / "calibration")
    assert Dataset.open(root).camera_b is None
    with pytest.raises(FileNotFoundError, match="expected the folder of a Guide3D data set"):
        Dataset.open(tmp_path / "nothing")
    (tmp_path / "empty").mkdir()
    with pytest.raises(FileNotFoundError, match="no annotation"):
        Dataset.open(tmp_path / "empty")


def test_images_that_cannot_be_used_say_so(root: Path) -> None:
    data = Dataset.open(root)
    frame = data.frames[0]
    path = frame.image_path("a")
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ImageError, match=r"0-bca-angle-2-2/000\.png cannot be read"):
        frame.image("a")
    Image.new("L", (64, 64)).save(path)
    with pytest.raises(ImageError, match="expected 128 x 128 px, got 64 x 64"):
        frame.image("a")
    path.unlink()
    with pytest.raises(ImageError, match="is missing"):
        frame.image("a")


def test_annotations_without_images(root: Path) -> None:
    shutil.rmtree(root / "images")
    frame = Dataset.open(root).frames[0]
    assert frame.mask("a").any()
    with pytest.raises(ImageError, match="annotations only"):
        frame.image("a")


def test_names_in_capitals_are_found_and_hidden_files_are_not(root: Path, tmp_path: Path) -> None:
    expected = Dataset.open(root)
    for name in ("raw.json", "sphere.json", "truth.json", "dataset.json"):
        (root / name).rename(root / name.title().replace("Json", "JSON"))
        (root / f"._{name}").write_bytes(b"\0\5\x16\7")  # what macOS leaves on other disks
    data = Dataset.open(root)
    assert data.undistorted is True
    for frame, one in zip(data.frames, expected.frames, strict=True):
        assert np.array_equal(frame.curve_mm, one.curve_mm)
        assert np.array_equal(frame.reconstruction_mm, one.reconstruction_mm)
    (root / "Raw.JSON").unlink()
    pairs = [annotation("1-bca-angle-1", 0, wire(0.0))]
    write_cvat(root / "Export.XML", pairs, {"a": (SIZE, SIZE), "b": (SIZE, SIZE)})
    (root / "._Export.XML").write_bytes(b"\0\5\x16\7")
    assert [frame.label for frame in Dataset.open(root).frames] == ["1-bca-angle-1/000"]


@pytest.mark.parametrize("name", ["raw.json", "truth.json", "dataset.json"])
def test_pipes_are_no_part_of_a_data_set(root: Path, name: str) -> None:
    (root / name).unlink()
    os.mkfifo(root / name)
    with pytest.raises(ValueError, match=rf"{name} is no regular file"):
        Dataset.open(root)
    if name == "raw.json":
        with pytest.raises(ValueError, match=rf"{name} is no regular file"):
            Dataset.open(root / name)


def test_properties_say_whether_annotations_are_undistorted(root: Path) -> None:
    (root / "dataset.json").unlink()
    assert Dataset.open(root).undistorted is None
    assert Dataset.open(root, undistorted=False).undistorted is False
    (root / "dataset.json").write_text('{"undistorted": "yes"}')
    with pytest.raises(ValueError, match="true or false"):
        Dataset.open(root)
    (root / "dataset.json").write_text("{")
    with pytest.raises(ValueError, match="expected JSON"):
        Dataset.open(root)


def test_a_data_set_splits_by_acquisition(kept: Path) -> None:
    data = Dataset.open(kept)
    parts = split(data, seed=3)
    assert parts == split(data, seed=3)
    names = [*parts.train, *parts.validation, *parts.test]
    assert sorted(names) == sorted(data.acquisitions)


@pytest.mark.skipif(not REAL.is_dir(), reason="the real data are not there (../shared/real)")
def test_the_public_sample_opens_without_images() -> None:
    data = Dataset.open(REAL / "guide3d_raw_sample.json")
    assert {name: len(frames) for name, frames in data.acquisitions.items()} == {"1-bca-angle-5": 3}
    frame = data.frames[0]
    assert (frame.fluid, frame.wire, data.undistorted, data.skipped) == (True, "angled", None, ())
    assert frame.annotation.image_a.endswith("-2/000.png")
    assert np.array_equal(frame.polyline("a")[0], [578, 305])
    assert np.array_equal(frame.polyline("b")[0], [514, 298])
    assert frame.curve_mm is None
    with pytest.raises(ValueError, match="several sets of cameras"):
        Dataset.open(REAL / "guide3d_raw_sample.json", calibration=REAL / "xray_calibration")
