"""Annotation files, splits and masks of the data set."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

from guide3d.dataset.acquisition_split import partners, split_acquisitions
from guide3d.dataset.annotation_files import acquisition_name, camera_of, image_name, read_curves, read_raw
from guide3d.dataset.cvat import read_cvat, write_cvat
from guide3d.dataset.frame import strip_mask
from tests.guide3d.dataset.drawn_dataset import SIZE, annotation, wire, write_dataset


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
    view = '"points": [[1, 2], [3, 4]]'
    path.write_text(
        f'[{{"frames": [{{"frame_number": 4, "cameraA": {{"image": "0-bca-straight-2-1/004.png", {view}}}, '
        f'"cameraB": {{"image": "0-bca-straight-2-2/004.png", {view}}}}}]}}]'
    )
    (only,) = read_raw(path, [])
    assert (only.acquisition, only.number, only.fluid, only.wire) == ("0-bca-straight-2", 4, False, "straight")
    assert only.image_a == "0-bca-straight-2-2/004.png"
    path.write_text(path.read_text().replace("0-bca-straight-2", "monday"))
    damaged: list[str] = []
    assert read_raw(path, damaged) == []
    assert 'expected "fluid" and "guidewire_type"' in damaged[0]


@pytest.mark.parametrize("folder", ["../secret", "/etc", "C:\\\\data", "a/../../b", "..\\\\b"])
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


def test_a_catheter_before_the_wire_is_not_the_wire(tmp_path: Path) -> None:
    line = '<polyline label="catheter" points="9,9;8,8"/><polyline label="guidewire" points="1,2;3,4"/>'
    images = "".join(f'<image name="1-bca-angle-3-{camera}/000.png">{line}</image>' for camera in (1, 2))
    (tmp_path / "cvat.xml").write_text(f"<annotations>{images}</annotations>")
    alone = '<image name="1-bca-angle-3-1/001.png"><polyline label="catheter" points="9,9;8,8"/></image>'
    (tmp_path / "cvat.xml").write_text(f"<annotations>{images}{alone}</annotations>")
    damaged: list[str] = []
    (one,) = read_cvat(tmp_path / "cvat.xml", damaged)
    assert one.points_a.tolist() == [[1, 2], [3, 4]]
    assert "it has no polyline with the label guidewire" in damaged[0]


def test_only_the_first_polyline_of_an_image_counts(tmp_path: Path) -> None:
    path = tmp_path / "cvat.xml"
    line = '<polyline points="1,2;3,4"/><polyline points="9,9;8,8"/>'
    path.write_text(
        "<annotations>"
        + "".join(f'<image name="1-bca-angle-3-{camera}/000.png">{line}</image>' for camera in (1, 2))
        + '<image name="1-bca-angle-3-1/001.png"/></annotations>'
    )
    damaged: list[str] = []
    (only,) = read_cvat(path, damaged)
    assert np.array_equal(only.points_a, [[1, 2], [3, 4]])
    assert "no polyline" in damaged[0]


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
    assert not groups[0] & groups[1]
    assert not groups[0] & groups[2]
    assert not groups[1] & groups[2]
    assert all(groups)


def test_a_mask_has_the_area_of_its_strip() -> None:
    mask = strip_mask([[20.0, 30.0], [80.0, 70.0], [100.0, 20.0]], SIZE, SIZE, 6.0)
    lengths = np.hypot(60, 40) + np.hypot(20, 50)
    expected = 6.0 * lengths + np.pi * 9  # a strip and its round ends; the bend takes away what it adds
    assert mask.dtype == np.uint8
    assert (mask > 0).sum() == pytest.approx(expected, rel=0.02)
