"""Cameras and curves: files, epipolar geometry, splines, metrics."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from guide3d.geometry.bspline import BSplineCurve, fit_bspline
from guide3d.geometry.camera import Camera, read_camera, read_opencv_yaml, write_camera, write_opencv_yaml
from guide3d.geometry.epipolar import EpipolarGeometry, epilines, fundamental_matrix
from guide3d.geometry.metrics import chamfer, curve_metrics, distances_along, frechet, max_ed, mete
from guide3d.geometry.polyline import arc_length, at_length, distances_to, resample
from guide3d.geometry.triangulation import calibration_covariance, point_covariance, triangulate, triangulate_linear
from guide3d.opencv import cv2
from guide3d.reconstruction.synthetic_scene import rig


@pytest.fixture
def camera() -> Camera:
    K = np.array([[5100.0, 9.0, 510.0], [0.0, 5080.0, 470.0], [0.0, 0.0, 1.0]])
    R = Rotation.from_euler("xyz", [0.3, -1.1, 2.0]).as_matrix()
    return Camera(K, R, np.array([65.0, 133.0, 1160.0]), 1024, 1000, "16710", np.diag(np.arange(1.0, 12.0)))


def test_projection_is_that_of_the_matrix_and_keeps_shapes(camera):
    points = np.random.default_rng(0).normal(size=(4, 5, 3)) * 60
    pixels = camera.project(points)
    assert pixels.shape == (4, 5, 2)
    homogeneous = np.concatenate([points, np.ones((4, 5, 1))], axis=-1) @ camera.P.T
    assert np.allclose(pixels, homogeneous[..., :2] / homogeneous[..., 2:])
    assert np.allclose(camera.depth_mm(points), homogeneous[..., 2])


@pytest.mark.parametrize("scale", [1.0, -3.0, 1e-6])
def test_a_matrix_of_any_scale_gives_the_camera_back(camera, scale):
    again = Camera.from_P(scale * camera.P, 1024, 1000)
    assert np.allclose(again.K, camera.K, atol=1e-6)
    assert np.allclose(again.R, camera.R)
    assert np.allclose(again.t_mm, camera.t_mm)


@pytest.mark.parametrize("unit", ["mm", "m"])
def test_xmalab_files_keep_everything_but_the_covariance(camera, tmp_path, unit):
    path = tmp_path / "new" / "camera.txt"
    write_camera(camera, path, unit)
    again = read_camera(path, unit)
    assert np.allclose(again.P, camera.P, rtol=1e-12)
    assert (again.width, again.height, again.covariance) == (1024, 1000, None)
    titles = [line for line in path.read_text().splitlines() if line and line[0].isalpha()]
    assert titles == ["image size", "camera matrix", "rotation", "translation"]
    assert list(tmp_path.glob("new/.*")) == []  # nothing half-written is left


def test_yaml_files_go_to_opencv_and_back(camera, tmp_path):
    write_opencv_yaml(camera, tmp_path / "ours.yaml")
    file = cv2.FileStorage(str(tmp_path / "ours.yaml"), cv2.FILE_STORAGE_READ)
    assert np.allclose(file.getNode("camera_matrix").mat(), camera.K, rtol=1e-15)
    assert np.allclose(file.getNode("rotation_matrix").mat(), camera.R, rtol=1e-15)
    assert np.allclose(file.getNode("translation_vector").mat()[:, 0], camera.t_mm, rtol=1e-15)
    assert file.getNode("image_width").real() == camera.width
    file.release()
    file = cv2.FileStorage(str(tmp_path / "theirs.yaml"), cv2.FILE_STORAGE_WRITE)
    for name, value in (("K", camera.K), ("R", camera.R), ("t", camera.t_mm[:, None])):
        file.write(name, np.array(value))
    file.write("image_width", camera.width)
    file.write("image_height", camera.height)
    file.release()
    assert np.allclose(read_opencv_yaml(tmp_path / "theirs.yaml").P, camera.P, rtol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("rotation", "turning", r"camera\.txt: expected a section 'rotation', found sections: .*turning"),
        ("translation\r\n6.5", "translation\r\nsix", r"expected 3 x 1 numbers under 'translation', found 'six"),
        ("0,0,1\r\n", "0,0,2\r\n", "K should be upper triangular"),
        ("1024,1000", "1000000000,1000", r"camera\.txt: width must be less than or equal to 8192, got 1000000000"),
    ],
)
def test_a_malformed_file_is_named_with_what_was_expected(camera, tmp_path, old, new, message):
    write_camera(camera, tmp_path / "camera.txt")
    text = (tmp_path / "camera.txt").read_bytes().decode()
    assert old in text
    (tmp_path / "camera.txt").write_bytes(text.replace(old, new).encode())
    with pytest.raises(ValueError, match=message):
        read_camera(tmp_path / "camera.txt")


@pytest.mark.parametrize(("separator", "mark"), [(",", "utf-8-sig"), (";", "utf-16"), ("\t", "utf-8")])
def test_files_that_spreadsheets_saved_are_read(camera, tmp_path, separator, mark):
    write_camera(camera, tmp_path / "camera.txt")
    text = (tmp_path / "camera.txt").read_bytes().decode()
    if separator == ",":
        text = text.replace("\r\n\r\n", "\r\n,,\r\n").replace("rotation", "rotation,,")
    else:
        text = text.replace(",", separator).replace(".", ",")
    (tmp_path / "saved.txt").write_bytes(text.encode(mark))
    read = read_camera(tmp_path / "saved.txt")
    assert np.allclose(read.P, camera.P, rtol=1e-12)
    assert (read.width, read.height) == (camera.width, camera.height)
    write_opencv_yaml(camera, tmp_path / "camera.yaml")
    (tmp_path / "saved.yaml").write_bytes((tmp_path / "camera.yaml").read_text().encode(mark))
    assert np.allclose(read_opencv_yaml(tmp_path / "saved.yaml").P, camera.P, rtol=1e-12)


def test_missing_files_and_missing_parts_are_refused(camera, tmp_path):
    with pytest.raises(FileNotFoundError, match=r"gone\.txt is missing"):
        read_camera(tmp_path / "gone.txt")
    write_opencv_yaml(camera, tmp_path / "part.yaml")
    text = (tmp_path / "part.yaml").read_text()
    (tmp_path / "part.yaml").write_text(text.replace("translation_vector", "somewhere"))
    with pytest.raises(ValueError, match="translation_vector"):
        read_opencv_yaml(tmp_path / "part.yaml")


@pytest.mark.parametrize(("unit", "scale"), [("world_unit: cm  # centimetres", 10), ('Units: "M"', 1000), ("", 1)])
def test_the_unit_of_yaml_is_read_as_yaml_does(camera, tmp_path, unit, scale):
    write_opencv_yaml(camera, tmp_path / "camera.yaml")
    text = (tmp_path / "camera.yaml").read_text().replace('world_unit: "mm"', unit)
    (tmp_path / "camera.yaml").write_text(text)
    assert np.allclose(read_opencv_yaml(tmp_path / "camera.yaml").t_mm, camera.t_mm * scale)
    (tmp_path / "camera.yaml").write_text(text + "unit: inch\n" if not unit else text.replace(unit, "unit: inch"))
    with pytest.raises(ValueError, match=r"camera\.yaml: expected a unit among mm, cm, m, found 'inch'"):
        read_opencv_yaml(tmp_path / "camera.yaml")


@pytest.mark.parametrize("key", ["distCoeffs", "D1", "Distortion_Coefficients", "k1"])
@pytest.mark.parametrize(
    "value", ["!!opencv-matrix\n   rows: 1\n   cols: 2\n   dt: d\n   data: [ {}, 0. ]", "[{}]", "{}"]
)
def test_lens_distortion_is_refused_under_any_key(camera, tmp_path, key, value):
    write_opencv_yaml(camera, tmp_path / "lens.yaml")
    text = (tmp_path / "lens.yaml").read_text() + "source_distance: 1000\ndistortion_model: rational8\n"
    (tmp_path / "lens.yaml").write_text(f"{text}{key}: {value.format('0.')}\n")
    assert np.allclose(read_opencv_yaml(tmp_path / "lens.yaml").P, camera.P)
    (tmp_path / "lens.yaml").write_text(f"{text}{key}: {value.format('-0.4')}\nlast: 1\n")
    with pytest.raises(ValueError, match=rf"expected no lens distortion, found {key} \[-0.4"):
        read_opencv_yaml(tmp_path / "lens.yaml")


def test_a_camera_refuses_what_is_none(camera):
    with pytest.raises(ValueError, match="R should be a rotation"):
        Camera(camera.K, -camera.R, camera.t_mm, 10, 10)
    with pytest.raises(ValueError, match=r"t_mm should be \(3,\)"):
        Camera(camera.K, camera.R, np.zeros(2), 10, 10)
    for covariance in (-np.eye(11), np.triu(np.ones((11, 11)))):
        with pytest.raises(ValueError, match="covariance should be symmetric without a negative variance"):
            Camera(camera.K, camera.R, camera.t_mm, 10, 10, covariance=covariance)
    with pytest.raises(ValueError, match=r"expected points of shape \(\.\.\., 3\)"):
        camera.project(np.zeros((3, 2)))
    with pytest.raises(ValueError, match="expected a unit among mm, cm, m"):
        write_camera(camera, "never.txt", unit="inch")


def cameras_and_points(seed: int = 0, count: int = 40) -> tuple[Camera, Camera, np.ndarray]:
    rng = np.random.default_rng(seed)
    return *rig(rng), rng.uniform(-60.0, 60.0, (count, 3))


def test_images_of_one_point_satisfy_the_epipolar_constraint_and_give_it_back() -> None:
    a, b, X = cameras_and_points()
    F = fundamental_matrix(a, b)
    assert abs(np.linalg.det(F)) < 1e-12
    assert np.linalg.norm(F) == pytest.approx(1.0)
    lines = epilines(F, a.project(X))
    assert np.abs((lines[:, :2] * b.project(X)).sum(1) + lines[:, 2]).max() < 1e-7
    assert np.abs(EpipolarGeometry(a, b).signed_distance(a.project(X), b.project(X))).max() < 1e-9
    for method in (triangulate_linear, triangulate):
        assert np.abs(method(a, b, a.project(X), b.project(X)) - X).max() < 1e-6
    with pytest.raises(ValueError, match="two lists of as many points"):
        triangulate(a, b, np.zeros((3, 2)), np.zeros((2, 2)))


def test_refined_triangulation_leaves_less_in_the_images() -> None:
    a, b, X = cameras_and_points(3, 400)
    rng = np.random.default_rng(3)
    x_a, x_b = (camera.project(X) + rng.normal(0.0, 2.0, (len(X), 2)) for camera in (a, b))

    def left(points: np.ndarray) -> np.ndarray:
        return ((a.project(points) - x_a) ** 2).sum(1) + ((b.project(points) - x_b) ** 2).sum(1)

    linear, refined = triangulate_linear(a, b, x_a, x_b), triangulate(a, b, x_a, x_b)
    assert (left(refined) <= left(linear) + 1e-9).all()
    error = refined - X
    predicted = point_covariance(a, b, X, 2.0)
    squares = np.einsum("ni,nij,nj->n", error, np.linalg.inv(predicted), error)
    assert squares.mean() == pytest.approx(3.0, rel=0.15)


def test_the_cameras_covariance_moves_points_as_sampled_cameras_do() -> None:
    a, b, X = cameras_and_points(4, 3)
    sd = np.array([3.0, 3.0, 1.0, 4.0, 4.0, 5e-4, 5e-4, 5e-4, 0.3, 0.3, 0.5])
    uncertain = Camera(a.K, a.R, a.t_mm, a.width, a.height, "A", np.diag(sd**2))
    assert np.array_equal(calibration_covariance(a, b, X), np.zeros((3, 3, 3)))
    rng, moved = np.random.default_rng(0), []
    for _ in range(600):
        fx, fy, skew, cx, cy, *rest = rng.normal(0.0, sd)
        K = a.K + np.array([[fx, skew, cx], [0.0, fy, cy], [0.0, 0.0, 0.0]])
        R = Rotation.from_rotvec(rest[:3]).as_matrix() @ a.R
        other = Camera(K, R, a.t_mm + rest[3:], a.width, a.height)
        moved.append(triangulate(a, b, other.project(X), b.project(X)) - X)
    sampled = np.einsum("kni,knj->nij", moved, moved) / len(moved)
    predicted = calibration_covariance(uncertain, b, X)
    assert np.allclose(np.trace(sampled, axis1=1, axis2=2), np.trace(predicted, axis1=1, axis2=2), rtol=0.15)


def circle(radius: float, count: int = 60) -> np.ndarray:
    angle = np.linspace(0.0, 1.5 * np.pi, count)
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def test_spline_goes_through_its_points_by_chord_length() -> None:
    points = circle(100.0)
    curve = fit_bspline(points)
    assert np.allclose(curve.at(arc_length(points)), points, atol=1e-9)
    assert curve.domain == pytest.approx((0.0, arc_length(points)[-1]))
    between = np.linalg.norm(curve.sample(2000), axis=1)
    assert np.abs(between - 100.0).max() < 1e-3
    steps = np.linalg.norm(np.diff(curve.sample(2000), axis=0), axis=1)
    assert np.abs(steps * 1999 / np.ptp(curve.domain) - 1.0).max() < 2e-3  # chord length is nearly arc length


def test_the_public_layout_round_trips() -> None:
    curve = fit_bspline(circle(80.0))
    entry = curve.to_tck(u=[0.0, 1.0])
    assert set(entry) == {"tck", "u"}
    assert len(entry["tck"]["c"]) == 2
    assert entry["u"] == [0.0, 1.0]
    back = BSplineCurve.from_tck(entry)
    u = np.linspace(*curve.domain, 30)
    assert np.array_equal(back.at(u), curve.at(u))
    padded = {"t": entry["tck"]["t"], "c": [[*row, 0, 0, 0, 0] for row in entry["tck"]["c"]], "k": 3}
    assert np.array_equal(BSplineCurve.from_tck(padded).at(u), curve.at(u))
    with pytest.raises(ValueError, match=r"\['k'\] missing"):
        BSplineCurve.from_tck({"tck": {"t": [], "c": []}})
    with pytest.raises(ValueError, match=r"expected \(n, d\) coefficients and n"):
        BSplineCurve(np.arange(5.0), np.zeros((3, 2)))


LINE = np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0]])


def test_a_shifted_line_is_off_by_its_shift_everywhere() -> None:
    shifted = LINE + np.array([0.0, 2.0, 0.0])
    names = ("max_ed", "mete", "mers", "frechet", "chamfer")
    assert curve_metrics(LINE, shifted) == pytest.approx(dict.fromkeys(names, 2.0))
    assert curve_metrics(LINE, LINE) == pytest.approx(dict.fromkeys(names, 0.0))


def test_points_are_compared_at_equal_arc_length_up_to_the_shorter_length() -> None:
    bent = np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [4.0, 3.0, 0.0]])
    along = distances_along(LINE, bent)
    assert len(along) == 8
    assert along[4] == 0.0
    assert along[-1] == pytest.approx(3.0 * np.sqrt(2.0))
    longer = np.array([[0.0, 0.0, 0.0], [30.0, 0.0, 0.0]])
    assert max_ed(LINE, longer) == 0.0
    assert frechet(LINE, longer) == pytest.approx(20.0)
    assert chamfer(LINE, longer) == pytest.approx(np.maximum(np.arange(31) - 10, 0).mean() / 2)


def test_frechet_lies_between_the_ends_and_a_walk_over_the_corners() -> None:
    rng = np.random.default_rng(3)
    for _ in range(2):
        a, b = (np.cumsum(rng.normal(size=(count, 3)), axis=0) for count in (7, 9))
        # over the corners alone: no less than over all points between them
        distance = np.linalg.norm(a[:, None] - b[None], axis=2)
        best = np.full(distance.shape, np.inf)
        for i in range(len(a)):
            for j in range(len(b)):
                before = min(
                    (best[k, m] for k, m in ((i - 1, j), (i, j - 1), (i - 1, j - 1)) if k >= 0 and m >= 0), default=0.0
                )
                best[i, j] = max(before, distance[i, j])
        fine = frechet(a, b, spacing_mm=0.01)
        assert max(mete(a, b), np.linalg.norm(a[-1] - b[-1])) - 1e-9 <= fine <= best[-1, -1] + 0.02


SQUARE = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 4.0]])


def test_points_at_an_arc_length_and_even_resampling() -> None:
    assert arc_length(SQUARE).tolist() == [0.0, 3.0, 7.0]
    assert at_length(SQUARE, [1.5, 5.0, 99.0]).tolist() == [[1.5, 0.0], [3.0, 2.0], [3.0, 4.0]]
    by_spacing, by_count = resample(SQUARE, spacing=1.0), resample(SQUARE, count=8)
    assert np.allclose(by_spacing, by_count)
    assert np.array_equal(by_spacing[0], SQUARE[0])
    assert len(resample(SQUARE, spacing=2.0)) == 4  # the end, 1 further, is left out
    with pytest.raises(ValueError, match="either spacing or count"):
        resample(SQUARE)


def test_distance_to_a_polyline() -> None:
    line = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0]])
    assert distances_to(line, [[5.0, 2.0], [12.0, 5.0], [-3.0, 4.0]]).tolist() == [2.0, 2.0, 5.0]
