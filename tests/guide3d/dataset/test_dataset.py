"""The data set: what was written is read, what cannot be used is left out by name, simulated annotations."""

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from guide3d.dataset.acquisition_split import COMPOSITION, composition, plan_acquisitions
from guide3d.dataset.cvat import write_cvat
from guide3d.dataset.dataset import Dataset
from guide3d.dataset.frame import ImageError
from guide3d.dataset.simulated_annotation import annotate, click, fit_annotation, visible_part
from guide3d.dataset.true_curves import TrueCurve, write_truth
from guide3d.geometry.polyline import arc_length, distances_to
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
    assert np.allclose(data.camera_a.P, cameras()["a"].P)
    assert np.allclose(np.diff(arc_length(frame.curve_mm))[:-1], 0.5, atol=0.002)
    seen, drawn = data.camera_a.project(frame.curve_mm), cameras()["a"].project(wire(0.85))
    assert np.linalg.norm(seen[:, None] - drawn[None], axis=2).min(axis=1).max() < 0.3
    assert np.abs(seen[[0, -1]] - drawn[[0, -1]]).max() < 0.01
    assert np.abs(frame.spline("a").sample(50)[[0, -1]] - frame.polyline("a")[[0, -1]]).max() < 0.05
    assert np.abs(frame.reconstruction_mm[0] - wire(0.85)[0]).max() < 0.01
    assert np.allclose(np.diff(arc_length(frame.reconstruction_mm)), 1.0, atol=0.01)


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


SIMULATED_ANNOTATION_SIZE = 256


def hook(count: int = 2000) -> np.ndarray:
    """(count, 2) px: a straight stretch and a tight bend of 12 px radius."""
    bend = np.pi * np.linspace(0.0, 1.0, count // 2)
    return np.concatenate(
        [
            np.column_stack([50 + 12 * np.sin(bend[::-1]), 40 - 12 * np.cos(bend[::-1])]),
            np.column_stack([np.linspace(50, -30, count // 2), np.full(count // 2, 28.0)]),
        ]
    )


def test_exact_annotations_stay_within_a_tenth_of_a_pixel() -> None:
    wire = hook()
    points = annotate(wire, 0.0, SIMULATED_ANNOTATION_SIZE, np.random.default_rng(0))
    assert distances_to(points, wire).max() < 0.1
    assert np.array_equal(points[[0, -1]], wire[[0, -1]])
    assert len(points) < 60


def test_clicks_are_apart_noisy_and_reach_both_ends() -> None:
    wire = np.column_stack([np.linspace(10.0, 240.0, 4000), np.full(4000, 100.0)])
    drawn = [annotate(wire, 1.0, SIMULATED_ANNOTATION_SIZE, np.random.default_rng(seed)) for seed in range(200)]
    assert np.array_equal(drawn[3], annotate(wire, 1.0, SIMULATED_ANNOTATION_SIZE, np.random.default_rng(3)))
    assert all(8 <= len(points) <= 17 for points in drawn)
    off = np.concatenate([points[:, 1] - 100.0 for points in drawn])
    assert off.std() == pytest.approx(1.0, abs=0.06)
    ends = np.array([points[[0, -1], 0] for points in drawn])
    assert np.abs(ends.mean(axis=0) - [10.0, 240.0]).max() < 0.25
    bent = hook() + np.array([40.0, 0.0])
    assert (
        distances_to(annotate(bent, 1e-9, SIMULATED_ANNOTATION_SIZE, np.random.default_rng(0)), bent).max() < 1.5
    )  # closer in a bend


def test_composition_is_the_thesiss() -> None:
    assert composition(8746) == {kind: count // 2 for kind, count in COMPOSITION.items()}
    for images in (8, 40, 2400):
        counts = composition(images)
        assert sum(counts.values()) == images // 2
        assert min(counts.values()) >= 1
    assert composition(2400)[True, "angled"] == round(1200 * 3664 / 8746)


def test_a_plan_names_every_acquisition_once_and_repeats_itself() -> None:
    plan = plan_acquisitions(2400, 13, ["type_1", "type_2"], ["bca", "lsa"])
    assert len({one.name for one in plan}) == len(plan)
    assert sum(one.pairs for one in plan) == 1200
    assert max(one.pairs for one in plan) <= 13
    assert {one.target for one in plan} == {"bca", "lsa"}
    assert {one.phantom for one in plan} == {"type_1", "type_2"}
    assert plan == plan_acquisitions(2400, 13, ["type_1", "type_2"], ["bca", "lsa"])


def test_a_curve_is_cut_where_it_leaves_the_image() -> None:
    wire = hook()
    part = visible_part(wire, arc_length(wire), SIMULATED_ANNOTATION_SIZE)
    assert part is not None
    assert part.points[-1] == pytest.approx([0.0, 28.0])
    assert part.length == pytest.approx(12 * np.pi + 50, abs=1e-3)
    assert visible_part(wire[::-1], arc_length(wire), SIMULATED_ANNOTATION_SIZE) is None
    whole = visible_part(wire + np.array([40.0, 0.0]), arc_length(wire), SIMULATED_ANNOTATION_SIZE)
    assert whole is not None
    assert len(whole.points) == len(wire)


def test_clicks_on_an_annotation_are_as_near_as_their_noise() -> None:
    exact = annotate(hook() + np.array([40.0, 0.0]), 0.0, SIMULATED_ANNOTATION_SIZE, np.random.default_rng(0))
    clicked = click(exact, 1.0, SIMULATED_ANNOTATION_SIZE, np.random.default_rng(1))
    assert 0.2 < distances_to(exact, clicked).mean() < 1.5
    assert distances_to(fit_annotation(clicked, 1.0).sample(300), clicked).max() < 4.0
    assert distances_to(fit_annotation(exact, 0.0).sample(300), exact).max() < 0.3


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
