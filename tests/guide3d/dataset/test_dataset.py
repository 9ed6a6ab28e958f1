"""The data set and its files: what was written is read, what cannot be used is left out by name; splits, clicks."""

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from guide3d.dataset.acquisition_split import COMPOSITION, composition, partners, plan_acquisitions, split_acquisitions
from guide3d.dataset.annotation_files import acquisition_name, camera_of, image_name, read_curves, read_raw
from guide3d.dataset.cvat import read_cvat, write_cvat
from guide3d.dataset.dataset import Dataset
from guide3d.dataset.frame import ImageError, strip_mask
from guide3d.dataset.true_curves import TrueCurve, annotate, click, fit_annotation, visible_part, write_truth
from guide3d.geometry.polyline import arc_length, distances_to
from tests.guide3d.dataset.drawn_dataset import SIZE, annotation, cameras, wire, write_dataset
from tests.guide3d.real_images import real_folder


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
    (tmp_path / "empty").mkdir()
    for name, said in (("nothing", "nothing"), ("empty", "no annotation")):
        with pytest.raises(FileNotFoundError, match=said):
            Dataset.open(tmp_path / name)


def test_names_in_capitals_are_found_and_hidden_files_are_not(root: Path, tmp_path: Path) -> None:
    expected = Dataset.open(root)
    for name in ("raw.json", "sphere.json", "truth.json", "dataset.json"):
        (root / name).rename(root / name.title().replace("Json", "JSON"))
        (root / f"._{name}").write_bytes(b"\0\5\x16\7")  # what macOS leaves on other disks
    data = Dataset.open(root)
    assert data.undistorted is True
    for frame, one in zip(data.frames[:2], expected.frames, strict=False):
        assert np.array_equal(frame.curve_mm, one.curve_mm)
        assert np.array_equal(frame.reconstruction_mm, one.reconstruction_mm)
    (root / "Raw.JSON").unlink()
    pairs = [annotation("1-bca-angle-1", 0, wire(0.0))]
    write_cvat(root / "Export.XML", pairs, {"a": (SIZE, SIZE), "b": (SIZE, SIZE)})
    (root / "._Export.XML").write_bytes(b"\0\5\x16\7")
    assert [frame.label for frame in Dataset.open(root).frames] == ["1-bca-angle-1/000"]


def test_pipes_are_no_part_of_a_data_set(root: Path) -> None:
    (root / "raw.json").unlink()
    os.mkfifo(root / "raw.json")
    for place in (root, root / "raw.json"):
        with pytest.raises(ValueError, match=r"raw\.json is no regular file"):
            Dataset.open(place)


def test_properties_say_whether_annotations_are_undistorted(root: Path) -> None:
    (root / "dataset.json").unlink()
    assert Dataset.open(root).undistorted is None
    assert Dataset.open(root, undistorted=False).undistorted is False
    (root / "dataset.json").write_text('{"undistorted": "yes"}')
    with pytest.raises(ValueError, match="true or false"):
        Dataset.open(root)


def test_the_public_sample_opens_without_images() -> None:
    real = real_folder()
    data = Dataset.open(real / "guide3d_raw_sample.json")
    assert {name: len(frames) for name, frames in data.acquisitions.items()} == {"1-bca-angle-5": 3}
    frame = data.frames[0]
    assert (frame.fluid, frame.wire, data.undistorted, data.skipped) == (True, "angled", None, ())
    assert frame.annotation.image_a.endswith("-2/000.png")
    assert np.array_equal(frame.polyline("a")[0], [578, 305])
    assert np.array_equal(frame.polyline("b")[0], [514, 298])
    assert frame.curve_mm is None
    with pytest.raises(ValueError, match="several sets of cameras"):
        Dataset.open(real / "guide3d_raw_sample.json", calibration=real / "xray_calibration")


SIDE = 256


def hook(count: int = 2000) -> np.ndarray:
    """(count, 2) px: a straight stretch and a tight bend of 12 px radius."""
    bend = np.pi * np.linspace(0.0, 1.0, count // 2)
    return np.concatenate(
        [
            np.column_stack([50 + 12 * np.sin(bend[::-1]), 40 - 12 * np.cos(bend[::-1])]),
            np.column_stack([np.linspace(50, -30, count // 2), np.full(count // 2, 28.0)]),
        ]
    )


def test_annotations_are_as_near_as_their_noise() -> None:
    wire = hook()
    points = annotate(wire, 0.0, SIDE, np.random.default_rng(0))
    assert distances_to(points, wire).max() < 0.1
    assert np.array_equal(points[[0, -1]], wire[[0, -1]])
    assert len(points) < 60
    exact = annotate(hook() + np.array([40.0, 0.0]), 0.0, SIDE, np.random.default_rng(0))
    clicked = click(exact, 1.0, SIDE, np.random.default_rng(1))
    assert 0.2 < distances_to(exact, clicked).mean() < 1.5
    assert distances_to(fit_annotation(clicked, 1.0).sample(300), clicked).max() < 4.0
    assert distances_to(fit_annotation(exact, 0.0).sample(300), exact).max() < 0.3


def test_clicks_are_apart_noisy_and_reach_both_ends() -> None:
    wire = np.column_stack([np.linspace(10.0, 240.0, 4000), np.full(4000, 100.0)])
    drawn = [annotate(wire, 1.0, SIDE, np.random.default_rng(seed)) for seed in range(200)]
    assert np.array_equal(drawn[3], annotate(wire, 1.0, SIDE, np.random.default_rng(3)))
    assert all(8 <= len(points) <= 17 for points in drawn)
    off = np.concatenate([points[:, 1] - 100.0 for points in drawn])
    assert off.std() == pytest.approx(1.0, abs=0.06)
    ends = np.array([points[[0, -1], 0] for points in drawn])
    assert np.abs(ends.mean(axis=0) - [10.0, 240.0]).max() < 0.25
    bent = hook() + np.array([40.0, 0.0])
    near = annotate(bent, 1e-9, SIDE, np.random.default_rng(0))  # closer in a bend
    assert distances_to(near, bent).max() < 1.5


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
    assert {(one.target, one.phantom) for one in plan} == {(t, p) for t in ("bca", "lsa") for p in ("type_1", "type_2")}
    assert plan == plan_acquisitions(2400, 13, ["type_1", "type_2"], ["bca", "lsa"])


def test_a_curve_is_cut_where_it_leaves_the_image() -> None:
    wire = hook()
    part = visible_part(wire, arc_length(wire), SIDE)
    assert part is not None
    assert part.points[-1] == pytest.approx([0.0, 28.0])
    assert part.length == pytest.approx(12 * np.pi + 50, abs=1e-3)
    assert visible_part(wire[::-1], arc_length(wire), SIDE) is None
    whole = visible_part(wire + np.array([40.0, 0.0]), arc_length(wire), SIDE)
    assert whole is not None
    assert len(whole.points) == len(wire)


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


def test_names_of_the_public_layout() -> None:
    assert acquisition_name(True, "bca", "angled", 5) == "1-bca-angle-5"
    assert image_name("1-bca-angle-5", "a", 7) == "1-bca-angle-5-2/007.png"
    assert camera_of("1-bca-angle-5-1/007.png") == "b"
    assert camera_of("somewhere/007.png") is None


def test_a_raw_file_must_be_a_list_of_videos(tmp_path: Path) -> None:
    path = tmp_path / "raw.json"
    with pytest.raises(FileNotFoundError, match=r"raw.json is missing"):
        read_raw(path, [])
    path.write_text("{}")
    with pytest.raises(ValueError, match="expected a list of videos, found dict"):
        read_raw(path, [])
    path.write_text('[{"frames": [3]}, {"fluid": 1}]')
    damaged: list[str] = []
    assert read_raw(path, damaged) == []
    assert len(damaged) == 2


def test_kind_of_wire_comes_from_the_name_where_the_entry_is_silent(tmp_path: Path) -> None:
    path = tmp_path / "raw.json"
    a, b = ({"image": f"0-bca-straight-2-{k}/004.png", "points": [[1, 2], [3, 4]]} for k in (1, 2))
    path.write_text(json.dumps([{"frames": [{"frame_number": 4, "cameraA": a, "cameraB": b}]}]))
    (only,) = read_raw(path, [])
    assert (only.acquisition, only.number, only.fluid, only.wire) == ("0-bca-straight-2", 4, False, "straight")
    assert only.image_a == "0-bca-straight-2-2/004.png"
    path.write_text(path.read_text().replace("0-bca-straight-2", "monday"))
    damaged: list[str] = []
    assert read_raw(path, damaged) == []
    assert 'expected "fluid" and "guidewire_type"' in damaged[0]


@pytest.mark.parametrize("folder", ["/etc", "C:\\\\data", "a/../../b", "..\\\\b"])
def test_images_outside_the_folder_are_left_out(tmp_path: Path, folder: str) -> None:
    names = [f"{folder}/1-bca-angle-5-{camera}/000.png" for camera in (2, 1)]
    views = [{"image": name.replace("\\\\", "\\"), "points": [[1, 2], [3, 4]]} for name in names]
    videos = [{"fluid": True, "guidewire_type": "angled", "frames": [{"camera1": views[0], "camera2": views[1]}]}]
    (tmp_path / "raw.json").write_text(json.dumps(videos), encoding="utf-8-sig")
    damaged: list[str] = []
    assert read_raw(tmp_path / "raw.json", damaged) == []
    assert "expected an image below the folder of images" in damaged[0]
    images = [f'<image name="{name}"><polyline label="guidewire" points="1,2;3,4"/></image>' for name in names]
    (tmp_path / "a.xml").write_text(f"<annotations>{''.join(images)}</annotations>")
    assert read_cvat(tmp_path / "a.xml", damaged) == []
    assert len(damaged) == 3


def test_pipes_and_growing_xml_are_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for read in (read_raw, read_cvat, read_curves):
        with pytest.raises(ValueError, match="pipe is no regular file"):
            read(tmp_path / "pipe", [])
    entities = "".join(f'<!ENTITY e{k} "{f"&e{k - 1};" * 10}">' for k in range(1, 12))
    (tmp_path / "laughs.xml").write_text(f'<!DOCTYPE a [<!ENTITY e0 "ha">{entities}]><a>&e11;</a>')
    with pytest.raises(ValueError, match="expected CVAT's XML"):
        read_cvat(tmp_path / "laughs.xml", [])


def test_curves_round_trip_and_damage(tmp_path: Path) -> None:
    data = write_dataset(tmp_path / "set", acquisitions=1, frames=2, images=False)
    curves = read_curves(tmp_path / "set" / "sphere.json", [])
    assert set(curves) == {("1-bca-angle-1", 0), ("1-bca-angle-1", 1)}
    space = curves["1-bca-angle-1", 0].space
    nearest = np.linalg.norm(space.sample(2000)[:, None] - wire(0.0)[None], axis=2).min(axis=0)
    assert nearest.max() < 0.05
    text = (tmp_path / "set" / "sphere.json").read_text()
    (tmp_path / "bad.json").write_text(text.replace('"k":3', '"q":3', 1))
    damaged: list[str] = []
    assert len(read_curves(tmp_path / "bad.json", damaged)) == 1
    assert "missing" in damaged[0]
    for entry, change in (("t", lambda knots: [float("nan"), *knots[1:]]), ("k", lambda degree: -1)):
        content = json.loads(text)
        space = content[0]["frames"][0]["3d"]
        tck = space.get("tck", space)
        tck[entry] = change(tck[entry])
        (tmp_path / "bad.json").write_text(json.dumps(content))
        damaged = []
        assert len(read_curves(tmp_path / "bad.json", damaged)) == 1
        assert "B-spline" in damaged[0]
    assert data.frames[0].views is not None


def test_cvat_round_trip_and_incomplete_pairs(tmp_path: Path) -> None:
    pairs = [annotation("0-bca-angle-1", number, wire(0.1 * number)) for number in range(3)]
    path = tmp_path / "cvat.xml"
    write_cvat(path, pairs, {"a": (SIZE, SIZE), "b": (SIZE, SIZE)})
    read = read_cvat(path, [])
    assert [one.label for one in read] == [one.label for one in pairs]
    assert np.abs(read[2].points_b - pairs[2].points_b).max() <= 0.0051
    path.write_text(path.read_text().replace("0-bca-angle-1-1/001.png", "0-bca-angle-1-1/009.png"))
    damaged: list[str] = []
    assert [one.number for one in read_cvat(path, damaged)] == [0, 2]
    assert sorted("A" if "camera A has no" in line else "B" for line in damaged) == ["A", "B"]
    path.write_text("<annotations>")
    with pytest.raises(ValueError, match="expected CVAT's XML"):
        read_cvat(path, [])


CATHETER = '<polyline label="catheter" points="9,9;8,8"/>'


@pytest.mark.parametrize(
    ("lines", "others", "said"),
    [
        (CATHETER + '<polyline label="guidewire" points="1,2;3,4"/>', CATHETER, "polyline with the label guidewire"),
        ('<polyline points="1,2;3,4"/><polyline points="9,9;8,8"/>', "", "no polyline"),
    ],
)
def test_the_wires_first_polyline_counts(lines: str, others: str, said: str, tmp_path: Path) -> None:
    shown = ("1/000", lines), ("2/000", lines), ("1/001", others)
    images = "".join(f'<image name="1-bca-angle-3-{place}.png">{content}</image>' for place, content in shown)
    (tmp_path / "cvat.xml").write_text(f"<annotations>{images}</annotations>")
    damaged: list[str] = []
    (one,) = read_cvat(tmp_path / "cvat.xml", damaged)
    assert one.points_a.tolist() == [[1, 2], [3, 4]]
    assert said in damaged[0]


def kinds(count: int, frames: int = 10) -> dict[str, tuple[str, int]]:
    return {f"{i % 2}-bca-{('angle', 'straight')[i // 2 % 2]}-{i}": (f"{i % 4}", frames) for i in range(count)}


def test_a_split_is_fixed_disjoint_and_near_its_shares() -> None:
    acquisitions = kinds(80)
    parts = split_acquisitions(acquisitions, seed=1)
    assert parts == split_acquisitions(dict(reversed(acquisitions.items())), seed=1)
    assert parts != split_acquisitions(acquisitions, seed=2)
    every = [*parts.train, *parts.validation, *parts.test]
    assert sorted(every) == sorted(acquisitions)
    assert (len(parts.train), len(parts.validation), len(parts.test)) == (64, 8, 8)
    for part in (parts.validation, parts.test):  # each kind is in each part
        assert {acquisitions[name][0] for name in part} == {"0", "1", "2", "3"}


def test_partners_with_and_without_fluid_stay_together() -> None:
    acquisitions = {f"{fluid}-bca-angle-{i}": (f"{fluid}", 10) for i in range(20) for fluid in (0, 1)}
    parts = split_acquisitions(acquisitions, seed=0)
    groups = [{partners(name) for name in part} for part in (parts.train, parts.validation, parts.test)]
    assert all(groups)
    assert sum(map(len, groups)) == len(set.union(*groups))


def test_a_mask_has_the_area_of_its_strip() -> None:
    mask = strip_mask([[20.0, 30.0], [80.0, 70.0], [100.0, 20.0]], SIZE, SIZE, 6.0)
    lengths = np.hypot(60, 40) + np.hypot(20, 50)
    expected = 6.0 * lengths + np.pi * 9  # a strip and its round ends; the bend takes away what it adds
    assert mask.dtype == np.uint8
    assert (mask > 0).sum() == pytest.approx(expected, rel=0.02)
