"""From a folder of images to cameras: a drawn one and damaged ones; the real one is in reading/test_real_images."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from guide3d.calibration.__main__ import main
from guide3d.calibration.cube_files import find_files, read_beads, read_references
from guide3d.geometry.camera import read_camera, read_opencv_yaml
from guide3d.geometry.distortion import Distortion
from tests.guide3d.calibration.drawn_cube import CAMERAS, DETECTORS, POINTS_MM, among_holes, write_folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return write_folder(tmp_path_factory.mktemp("drawn"))


@pytest.fixture(scope="module")
def report(folder, tmp_path_factory) -> Path:
    output = tmp_path_factory.mktemp("report")
    assert main([str(folder), "--output", str(output)]) == 0
    return output


def test_the_written_cameras_see_what_the_true_ones_see(report):
    for detector, truth in CAMERAS.items():
        camera = read_camera(report / f"camera_{detector}.txt")
        distortion = Distortion.load(report / f"distortion_{detector}.npz")
        assert np.linalg.norm(camera.centre_mm - truth.centre_mm) < 12.0
        raw = DETECTORS[detector].distort(truth.project(POINTS_MM))
        measured = truth.contains(raw, -20.0) & among_holes(distortion, raw)
        points, raw = POINTS_MM[measured], raw[measured]
        assert len(points) > 30
        assert np.abs(distortion.distort_points(camera.project(points)) - raw).max() < 0.5
        again = read_opencv_yaml(report / "opencv" / f"camera_{detector}.yaml")
        assert np.allclose(again.P, camera.P)
        assert np.linalg.eigvalsh(again.covariance / np.outer(*2 * [np.sqrt(np.diag(again.covariance))])).min() > 0


def test_the_report_shows_every_picture(report):
    page = (report / "index.html").read_text()
    pictures = sorted(report.glob("*.png"))
    kinds = ("holes", "displacement", "beads_pose1")
    assert [path.stem for path in pictures] == sorted(f"{kind}_{d}" for kind in kinds for d in ("A", "B"))
    for path in pictures:
        assert f'src="{path.name}"' in page
        with Image.open(path) as picture:
            assert len(np.unique(np.asarray(picture).reshape(-1, 3)[::17], axis=0)) > 20


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        ("no beads", "expected a bead file, framespec_cm.csv"),
        ("no sheet", "expected a sheet image undistort_B.png beside it"),
        ("no cube", "expected images of the bead cube"),
        ("other size", "pose1_A.png: expected an image of 512 x 512 px, as the sheet's, found 300 x 200"),
        ("corrupted", "pose1_A.png: expected a readable image, found a damaged or foreign file"),
        ("flat", "undistort_A.png: expected a grey X-ray image, found one value everywhere"),
        ("photograph", "undistort_A.png: expected an X-ray of a perforated sheet"),
        ("no cube in it", r"pose1_A.png: expected (12 beads of the cube|a lattice that explains 12)"),
        ("missing folder", "is missing: expected one with sheet and cube images"),
    ],
)
def test_bad_input_gives_one_clear_sentence(folder, tmp_path, capsys, spoil, message):
    bad, cube, sheet = tmp_path / "bad", tmp_path / "bad" / "pose1_A.png", tmp_path / "bad" / "undistort_A.png"
    if spoil != "missing folder":
        shutil.copytree(folder, bad)
    rng = np.random.default_rng(0)
    if spoil == "no beads":
        (bad / "framespec_cm.csv").unlink()
    elif spoil == "no sheet":
        (bad / "undistort_B.png").unlink()
    elif spoil == "no cube":
        cube.unlink()
        (bad / "pose1_B.png").unlink()
    elif spoil == "other size":
        Image.open(cube).resize((300, 200)).save(cube)
    elif spoil == "corrupted":
        cube.write_bytes(cube.read_bytes()[:20_000])
    elif spoil == "flat":
        Image.new("L", (512, 512), 90).save(sheet)
    elif spoil == "photograph":
        Image.fromarray(rng.integers(0, 255, size=(64, 64), dtype=np.uint8)).resize((512, 512)).save(sheet)
    elif spoil == "no cube in it":
        Image.fromarray((120 + 3 * rng.normal(size=(512, 512))).astype(np.uint8)).save(cube)
    assert main([str(bad), "--output", str(tmp_path / "out")]) == 1
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.count("\n") == 1
    assert re.search(message, said.err)
    assert not (tmp_path / "out").exists()


def test_bead_and_reference_files(tmp_path):
    (tmp_path / "framespec_mm.csv").write_text("x,y,z\n" + "\n".join(f"{k},0,1.5" for k in range(9)) + "\n")
    assert np.allclose(read_beads(tmp_path / "framespec_mm.csv")[2], [2.0, 0.0, 1.5])
    (tmp_path / "framespec_inch.csv").write_text("")
    with pytest.raises(ValueError, match="expected a name that ends in its unit"):
        read_beads(tmp_path / "framespec_inch.csv")
    (tmp_path / "marks.ref").write_text("22 circle\r\n1 single\r\n")
    assert read_references(tmp_path / "marks.ref", 64) == {"circle": 21, "single": 0}
    (tmp_path / "marks.ref").write_text("65 circle\n")
    with pytest.raises(ValueError, match="line 1: expected a bead from 1 to 64 and its mark, found '65 circle'"):
        read_references(tmp_path / "marks.ref", 64)


@pytest.mark.parametrize(
    ("layout", "header", "mark"),
    [
        ("{x},{y},{z}", "x{0}y{0}z", "utf-8"),
        ("{x}\t{y}\t{z}", "z{0}x{0}y", "utf-16"),
        ("{x}, {y}, {z},,", None, "utf-8"),
        ("german", "z{0}x{0}y", "utf-8-sig"),
        ("german tabs", "X (cm){0}Y (cm){0}Z (cm)", "utf-8"),
    ],
)
def test_all_beads_are_read_in_every_layout(tmp_path, layout, header, mark):
    beads = np.round(np.random.default_rng(0).uniform(-5, 60, (64, 3)), 3)
    separator = {"german": ";", "german tabs": "\t"}.get(layout, layout[3:].split("{")[0])
    written = beads[:, [2, 0, 1]] if header and header.startswith("z") else beads
    if layout.startswith("german"):
        lines = [separator.join(f"{value}".replace(".", ",") for value in row) for row in written]
    else:
        lines = [layout.format(x=x, y=y, z=z) for x, y, z in written]
    if header:
        lines.insert(0, header.format(separator))
    (tmp_path / "Framespec_CM.CSV").write_bytes("\r\n".join(lines).encode(mark))
    assert np.allclose(read_beads(tmp_path / "Framespec_CM.CSV"), 10 * beads)


@pytest.mark.parametrize(
    ("header", "last", "said"),
    [
        ("x (mm),y (mm),z (mm)", "1,2,3", "line 1: the header is in mm, the file's name says cm"),
        ("x [cm],y [cm],z [cm]", "4,0,1.5", "line 11: the bead at '4,0,1.5' is there twice"),
        ("x axis,y axis,z axis", "1e300,0,0", "line 11: expected at most 10000 mm, found '1e300,0,0' cm"),
        ("x,y,z", "6.5,zero,0", "line 11: expected three numbers x,y,z, found '6.5,zero,0'"),
    ],
)
def test_beads_that_contradict_each_other_are_refused(tmp_path, header, last, said):
    rows = [header, *(f"{k},0,1.5" for k in range(9)), last]
    (tmp_path / "framespec_cm.csv").write_text("\n".join(rows))
    with pytest.raises(ValueError, match=re.escape(said)):
        read_beads(tmp_path / "framespec_cm.csv")


@pytest.mark.parametrize("text", ["1 circle\n1 cross", "1 circle\n2 CIRCLE"])
def test_a_bead_or_a_mark_that_is_there_twice_is_refused(tmp_path, text):
    (tmp_path / "marks.ref").write_text(text)
    with pytest.raises(ValueError, match="line 2: expected one bead for each mark, found"):
        read_references(tmp_path / "marks.ref", 64)


def test_names_in_capitals_are_found_and_doubled_ones_refused(folder, tmp_path):
    for path in folder.iterdir():
        name = path.name.replace("undistort", "Undistort").replace("framespec_cm.csv", "Framespec_CM.CSV")
        shutil.copy(path, tmp_path / name.replace(".png", ".PNG"))
    found, expected = find_files(tmp_path), find_files(folder)
    assert found.sheets.keys() == expected.sheets.keys()
    assert found.cubes.keys() == expected.cubes.keys()
    assert np.array_equal(read_beads(found.beads), read_beads(expected.beads))
    shutil.copy(found.sheets["A"], tmp_path / "undistort_A.jpg")
    with pytest.raises(ValueError, match=r"several files of one kind \(undistort_A.jpg, Undistort_A.PNG\)"):
        find_files(tmp_path)
