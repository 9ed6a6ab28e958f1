"""The command that reads images: tables, pictures, films, refusals."""

import csv
import errno
import json
import os
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from guide3d.geometry.camera import write_camera, write_opencv_yaml
from guide3d.image_file import read_grey_levels, write_png
from guide3d.opencv import cv2
from guide3d.reading import command
from guide3d.reading.image_reading import read
from guide3d.reading.output.curve_files import write_text
from guide3d.reading.output.overlay import confidence_colour, draw_reading, space_page
from guide3d.reading.pair_reading import PairReading, read_pair
from guide3d.reconstruction.synthetic_scene import scenes
from tests.guide3d.reading.drawn_maps import DarkLineReader, maps_of, picture

SCENE = list(scenes(2, seed=77))[1]


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two drawn views, their cameras, and things that are none."""
    folder = tmp_path_factory.mktemp("data")
    for letter, points in zip("ab", SCENE.points, strict=True):
        write_png(picture(maps_of(points)), folder / f"{letter}.png")
    (folder / "cameras").mkdir()
    for detector, camera in zip(("16710", "16709"), SCENE.cameras, strict=True):
        write_camera(camera, folder / "cameras" / f"today_{detector}.txt")
    (folder / "named").mkdir()
    for letter, camera in zip("ab", SCENE.cameras, strict=True):
        write_opencv_yaml(camera, folder / "named" / f"camera_{letter}.yaml")
    rng = np.random.default_rng(0)
    write_png(rng.integers(0, 255, (300, 300, 3), dtype=np.uint8), folder / "photograph.png")
    write_png(rng.integers(0, 255, (64, 64), dtype=np.uint8), folder / "small.png")
    write_png(np.zeros((1024, 1024), np.uint8), folder / "black.png")
    write_png(rng.integers(170, 190, (1024, 1024), dtype=np.uint8), folder / "empty.png")
    whole = (folder / "a.png").read_bytes()
    (folder / "cut.png").write_bytes(whole[: len(whole) // 2])
    (folder / "cut.dcm").write_bytes(bytes(128) + b"DICM" + whole[:50])
    return folder


@pytest.fixture(autouse=True)
def _drawn_reader(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command, "shipped_reader", DarkLineReader)


def _table(path: Path) -> np.ndarray:
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.reader(file))
    return np.array(rows[1:], float)


def test_one_image_is_written_as_curve_and_overlay(data: Path, tmp_path: Path) -> None:
    assert command.main([str(data / "a.png"), "--output", str(tmp_path / "out")]) == 0
    assert {file.name for file in (tmp_path / "out").iterdir()} == {"curve.csv", "curve.json", "overlay.png"}
    table, record = _table(tmp_path / "out" / "curve.csv"), json.loads((tmp_path / "out" / "curve.json").read_text())
    assert np.abs(table[:, 1:3] - record["points_px"]).max() < 2e-3
    assert record["found"]
    assert cv2.imread(str(tmp_path / "out" / "overlay.png")).shape == (1024, 1024, 3)


def _points_of_polydata(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Points and deviations of a poly-line through all points."""
    piece = ElementTree.parse(path).getroot().find("PolyData/Piece")
    points = np.array(piece.findtext("Points/DataArray").split(), float).reshape(-1, 3)
    return points, np.array(piece.findtext("PointData/DataArray").split(), float)


def test_two_images_are_written_as_a_wire_in_space(data: Path, tmp_path: Path) -> None:
    words = [str(data / "a.png"), str(data / "b.png"), "--cameras", str(data / "named"), "--output", str(tmp_path)]
    assert command.main(words) == 0
    names = {"curve.csv", "curve.json", "curve.mrk.json", "curve.vtp", "overlay_a.png", "overlay_b.png", "view.html"}
    assert {file.name for file in tmp_path.iterdir()} == names
    table, record = _table(tmp_path / "curve.csv"), json.loads((tmp_path / "curve.json").read_text())
    assert np.hypot(*(table[0, 1:3] - SCENE.curve_mm[0, :2])) < 2.0
    assert np.abs(table[:, 1:4] - record["curve_mm"]).max() < 1e-3
    assert record["accepted"]
    assert np.shape(record["covariance_mm2"]) == (len(table), 3, 3)
    [markup] = json.loads((tmp_path / "curve.mrk.json").read_text())["markups"]
    assert (markup["type"], markup["coordinateSystem"], markup["coordinateUnits"]) == ("Curve", "LPS", "mm")
    assert [point["position"] for point in markup["controlPoints"]] == record["curve_mm"]
    points, deviations = _points_of_polydata(tmp_path / "curve.vtp")
    assert np.abs(points - record["curve_mm"]).max() < 1e-3
    assert np.abs(deviations - record["sd_mm"]).max() < 1e-3
    page = (tmp_path / "view.html").read_text()
    assert "http://" not in page
    assert "https://" not in page


def test_a_sequence_has_a_row_a_frame(data: Path, tmp_path: Path) -> None:
    for letter, points in zip("ab", SCENE.points, strict=True):
        (tmp_path / letter).mkdir()
        for frame in range(3):
            image = picture(maps_of(points[20 * frame :]))
            write_png(
                image if frame != 1 or letter == "a" else np.zeros_like(image), tmp_path / letter / f"{frame}.png"
            )
    words = [str(tmp_path / "a"), str(tmp_path / "b"), "--video", "--cameras", str(data / "cameras")]
    assert command.main([*words, "--output", str(tmp_path / "out")]) == 0
    with (tmp_path / "out" / "frames.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["found"] for row in rows] == ["1", "0", "1"]
    assert "no contrast" in rows[1]["messages"]
    assert float(rows[2]["length"]) < float(rows[0]["length"]) - 2.0
    assert len(json.loads((tmp_path / "out" / "frames.json").read_text())) == 3
    assert (tmp_path / "out" / "view.html").is_file()


def test_results_of_an_earlier_reading_of_another_kind_go(data: Path, tmp_path: Path, capsys) -> None:
    out = tmp_path / "out"
    (tmp_path / "frames").mkdir()
    for number, size in enumerate((1024, 900)):
        write_png(picture(maps_of(SCENE.points[0]))[:size, :size], tmp_path / "frames" / f"{number}.png")
    out.mkdir()
    (out / "view.html").write_text("mine")
    (out / "notes.csv").write_text("mine")
    assert command.main([str(tmp_path / "frames"), "--video", "--output", str(out)]) == 0
    said = capsys.readouterr().err
    assert "1.png has 900 x 900 px, the first picture of its folder 1024 x 1024 px" in said
    assert {file.name for file in out.iterdir()} == {"frames.csv", "frames.json", "view.html", "notes.csv"}
    assert command.main([str(data / "a.png"), "--output", str(out)]) == 0
    assert "earlier reading were removed: frames.csv, frames.json, view.html" in capsys.readouterr().err
    assert {file.name for file in out.iterdir()} == {*command._ONE, "notes.csv"}


def test_a_full_disk_leaves_no_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space"):
        write_text("curve", tmp_path / "out" / "today" / "curve.csv")
    assert not list(tmp_path.iterdir())


def test_a_film_is_a_sequence(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for letter, rate in (("a", 10), ("b", 20)):
        film = cv2.VideoWriter(str(tmp_path / f"{letter}.avi"), cv2.VideoWriter.fourcc(*"MJPG"), rate, (1024, 1024))
        if not film.isOpened():
            pytest.skip("this OpenCV writes no films")
        image = read_grey_levels(data / f"{letter}.png").astype(np.uint8)
        for _ in range(2):
            film.write(np.repeat(image[..., None], 3, axis=2))
        film.release()
    both = [str(tmp_path / f"{letter}.avi") for letter in "ab"]
    assert command.main([*both, "--cameras", str(data / "cameras"), "--video", "--output", str(tmp_path / "pair")]) == 0
    assert (tmp_path / "pair" / "frames.csv").read_text().count("\n") == 3
    assert "A has 10 frames a second and B 20: frames of one number, taken as one moment" in capsys.readouterr().err


def test_images_that_are_not_read_are_said(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    images = [cv2.imread(str(data / f"{letter}.png"), cv2.IMREAD_GRAYSCALE) for letter in "ab"]
    for letter, image, count in zip("ab", images, (3, 2), strict=True):
        cv2.imwritemulti(str(tmp_path / f"{letter}.tif"), [image] * count)
    words = [str(tmp_path / "a.tif"), str(tmp_path / "b.tif"), "--cameras", str(data / "cameras")]
    assert command.main([*words, "--video", "--output", str(tmp_path / "out")]) == 0
    assert "A has 3 frames and B 2: those without a partner were not read" in capsys.readouterr().err
    with (tmp_path / "out" / "frames.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["found"] for row in rows] == ["1", "1", "0"]
    assert rows[2]["messages"] == "there is no image of camera B at this moment"
    assert command.main([*words, "--output", str(tmp_path / "pair")]) == 0
    said = capsys.readouterr().err
    assert "a.tif holds 3 images, of which the first" in said
    assert "b.tif holds 2 images, of which the first" in said


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("photograph.png",), "coloured"),
        (("empty.png",), "no wire was found"),
        (("cut.png",), "cannot be read"),
        (("missing.png",), "is missing"),
        (("cut.dcm",), "cut.dcm"),
        (("a.png", "b.png"), "add --cameras FOLDER"),
        (("a.png", "a.png", "--cameras", "cameras"), "two views need two different images"),
        (("a.png", "--cameras", "cameras"), "--cameras needs two images"),
        (("a.png", "b.png", "--cameras", "."), "holds no cameras"),
        (("a.png", "small.png", "--cameras", "cameras"), "has 64 x 64 px, but camera B was calibrated for 1024 x 1024"),
        (("a.png", "black.png", "--cameras", "cameras"), "black.png: the image has no contrast"),
    ],
)
def test_bad_input_is_one_sentence_and_leaves_nothing(
    words: tuple[str, ...], said: str, data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = [word if word.startswith("--") else str(data / word) for word in words]
    assert command.main([*given, "--output", str(tmp_path / "out")]) == 1
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_of_several_sets_that_fit_the_last_by_name_is_taken(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "cameras"
    folder.mkdir()
    for name, cameras in (("2024-01", SCENE.cameras), ("2024-03", SCENE.cameras), ("2024-05", SCENE.cameras[::-1])):
        for detector, camera in zip(("16710", "16709"), cameras, strict=True):
            write_camera(camera, folder / f"{name}_{detector}.txt")
    words = [str(data / "a.png"), str(data / "b.png"), "--cameras", str(folder), "--output", str(tmp_path / "out")]
    assert command.main(words) == 0
    assert "2024-03_*.txt was taken of several sets" in capsys.readouterr().err


@pytest.fixture(scope="module")
def reading() -> PairReading:
    images = [picture(maps_of(points)) for points in SCENE.points]
    return read_pair(*images, SCENE.cameras, reader=DarkLineReader())


def test_data_and_pictures_stand_in_the_page(reading: PairReading) -> None:
    page = space_page([None, reading], [np.zeros((20, 30, 3), np.uint8)], 'a "title"</script><b>')
    assert page.count("</script>") == 1
    found = re.search(r"^const data = (.*);$", page, re.MULTILINE)
    data = json.loads(found[1])
    assert data["title"] == 'a "title"</script><b>'
    assert data["frames"][0] is None
    points = np.array(data["frames"][1]["points"])
    assert np.abs(points[[0, -1]] - reading.curve_mm[[0, -1]]).max() < 1e-3
    assert len(points) == len(data["frames"][1]["sd"])
    assert data["pictures"][0].startswith("data:image/jpeg;base64,")
    assert not re.search(r"https?://|src=|href=", page)


def test_an_overlay_shows_confidence_by_colour() -> None:
    points = next(iter(scenes(1, seed=77))).points[0]
    maps = maps_of(points, gaps=((150, 260),))
    image = picture(maps)
    overlay = draw_reading(image, read(image, DarkLineReader()))
    assert overlay.shape == (1024, 1024, 3)
    red, green = (overlay == confidence_colour(share) for share in (0.0, 1.0))
    assert red.all(axis=2).any() or (overlay[..., 0].astype(int) - overlay[..., 1] > 60).any()
    assert green.all(axis=2).any() or (overlay[..., 1].astype(int) - overlay[..., 0] > 60).any()
