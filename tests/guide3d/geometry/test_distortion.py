"""The sheet's holes and the distortion map, against a drawn image intensifier."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from guide3d.calibration.perforated_sheet import SheetHoles, find_holes
from guide3d.geometry.distortion import Distortion, ideal_lattice, leave_out_errors, swirl_pattern
from tests.guide3d.calibration.drawn_cube import DETECTORS, among_holes, drawn_sheet


@pytest.fixture(scope="module")
def sheet() -> tuple[np.ndarray, np.ndarray, SheetHoles]:
    image, true = drawn_sheet("A")
    return image, true, find_holes(image)


def test_every_hole_is_found_where_it_is(sheet):
    _, true, holes = sheet
    distance, nearest = cKDTree(holes.centres_px).query(true)
    assert len(true) > 1000
    assert distance.max() < 1.0
    assert len(np.unique(nearest)) == len(true)
    whole = ~holes.partial[nearest]
    assert np.sqrt((distance[whole] ** 2).mean()) < 0.08
    # what was found beyond the true ones are holes cut by the border or the rim, never clutter
    assert len(holes) < 1.08 * len(true)


def test_the_map_undoes_the_distortion(sheet):
    distortion = Distortion.from_holes(sheet[2])
    raw = np.random.default_rng(3).uniform(30, 481, size=(400, 2))
    raw = raw[among_holes(distortion, raw)]
    ours, truth = distortion.undistort_points(raw), DETECTORS["A"].undistort(raw)
    # the frames may differ by a similarity, which any camera takes up
    a, b = ((p - p.mean(axis=0)) @ [1, 1j] for p in (ours, truth))
    assert np.abs(a * (np.vdot(a, b) / np.vdot(a, a)) - b).max() < 0.4
    assert np.abs(distortion.distort_points(ours) - raw).max() < 1e-5
    assert np.abs(ours - raw).max() > 4  # there was something to undo


def test_leave_out_error_tells_noise_from_distortion(sheet):
    _, _, holes = sheet
    clean = leave_out_errors(holes)
    assert clean.shape == (len(holes),)
    assert clean.mean() < 0.1
    noise = np.random.default_rng(0).normal(size=holes.centres_px.shape)
    shaken = SheetHoles(holes.centres_px + noise, holes.indices, holes.partial, 512, 512)
    assert leave_out_errors(shaken).mean() > 1.0


def test_the_ideal_frame_does_not_hang_on_border_holes(sheet):
    _, _, holes = sheet
    inner = (np.abs(holes.centres_px - 255.5) < 240).all(axis=1)
    fewer = SheetHoles(holes.centres_px[inner], holes.indices[inner], holes.partial[inner], 512, 512)
    middle = np.linalg.norm(fewer.centres_px - 255.5, axis=1) < 100

    def change(frame: str) -> float:
        return float(np.ptp((ideal_lattice(holes, frame)[inner] - ideal_lattice(fewer, frame))[middle], axis=0).max())

    assert change("least squares") < 0.75 * change("bounding box")
    box = ideal_lattice(holes, "bounding box")
    assert np.allclose(box.min(axis=0), holes.centres_px.min(axis=0))
    assert np.allclose(box.max(axis=0), holes.centres_px.max(axis=0))
    with pytest.raises(ValueError, match="least squares, bounding box"):
        ideal_lattice(holes, "frame")


def test_images_are_moved_as_points_are(sheet):
    image, _, holes = sheet
    distortion = Distortion.from_holes(holes)
    y, x = np.mgrid[: image.shape[0], : image.shape[1]].astype(float)
    some = np.s_[3::16, 3::16]
    true = distortion.distort_points(np.stack([x, y], axis=-1)[some])
    inside = among_holes(distortion, true.reshape(-1, 2)).reshape(true.shape[:2])
    inside &= (np.abs(true - 255.5) < 254).all(axis=-1)
    assert inside.mean() > 0.3
    # an image of columns or rows tells where each pixel came from; points are moved more exactly, by iteration
    for axis, places in enumerate((x, y)):
        for kind, tolerance in ((np.float64, 0.06), (np.uint16, 0.56), (np.int32, 0.56)):
            moved = distortion.undistort_image(places.astype(kind))
            assert moved.dtype == kind
            assert np.abs(moved[some] - true[..., axis])[inside].max() < tolerance
    colours = distortion.undistort_image(np.stack([image, image // 2, image // 3], axis=-1))
    assert np.array_equal(colours[..., 0], distortion.undistort_image(image))
    assert (distortion.undistort_image(np.full(image.shape, 7, np.uint8), fill=99.0) == 99).any()
    with pytest.raises(ValueError, match=r"expected an image of 512 x 512 px, .* found 300 x 200"):
        distortion.undistort_image(np.zeros((200, 300)))
    with pytest.raises(ValueError, match=r"expected pixels of shape \(\.\.\., 2\)"):
        distortion.undistort_points(np.zeros((4, 3)))


def test_saved_maps_and_swirls(sheet, tmp_path):
    distortion = Distortion.from_holes(sheet[2])
    distortion.save(tmp_path / "map.npz")
    points = np.array([[100.0, 200.0], [400.0, 50.0]])
    assert np.array_equal(
        Distortion.load(tmp_path / "map.npz").undistort_points(points), distortion.undistort_points(points)
    )
    with np.load(tmp_path / "map.npz") as saved:
        np.savez(tmp_path / "spline.npz", **{**saved, "method": "spline"})
    with pytest.raises(ValueError, match=r"spline\.npz: .* the method spline of 25 neighbours: make the map again"):
        Distortion.load(tmp_path / "spline.npz")
    moved = distortion.swirled(2.0).undistort_points(points) - distortion.undistort_points(points)
    assert np.abs(moved - 2.0 * swirl_pattern(distortion.undistort_points(points), 512, 512)).max() < 0.02
    assert np.allclose(swirl_pattern(np.array([511.5, 255.5]), 512, 512), [0.0, 1.0])
    (tmp_path / "bad.npz").write_bytes(b"PK nonsense")
    with pytest.raises(ValueError, match=r"bad\.npz: expected a map as Distortion\.save writes it"):
        Distortion.load(tmp_path / "bad.npz")
    with pytest.raises(FileNotFoundError, match="is missing"):
        Distortion.load(tmp_path / "none.npz")


def test_what_is_no_sheet_is_refused():
    noise = np.random.default_rng(0).integers(0, 255, size=(256, 256))
    stripes = np.tile(100 + 50 * np.sin(np.arange(256) / 2), (256, 1))
    for image in (noise, stripes, np.zeros((10, 10)), np.zeros((256, 256, 3))):
        with pytest.raises(ValueError, match=r"expected (an X-ray of a perforated sheet|a grey image)"):
            find_holes(image.astype(np.uint8))


def test_a_map_that_claims_more_than_memory_is_refused(tmp_path):
    many = np.zeros((2_200_000, 2))
    np.savez_compressed(tmp_path / "bomb.npz", size=[8, 8], fit=[1, 1], method="x", ideal_px=many, raw_px=many)
    assert (tmp_path / "bomb.npz").stat().st_size < 1e6
    with pytest.raises(ValueError, match=r"bomb\.npz: expected a map .* more points than any sheet"):
        Distortion.load(tmp_path / "bomb.npz")
