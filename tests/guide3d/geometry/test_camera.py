"""Cameras: projection, decomposition, and the files that hold them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from guide3d.geometry.camera import Camera, read_camera, read_opencv_yaml, write_camera, write_opencv_yaml
from guide3d.geometry.distortion import Distortion
from guide3d.opencv import cv2


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


def test_rays_pass_through_their_points(camera):
    points = np.random.default_rng(1).normal(size=(7, 3)) * 60
    away = points - camera.centre_mm
    assert np.allclose(camera.rays(camera.project(points)), away / np.linalg.norm(away, axis=1, keepdims=True))


def test_contains_counts_from_the_pixel_centres(camera):
    inside = camera.contains([[-0.5, 0.0], [1023.5, 999.5], [-0.6, 0.0], [0.0, 999.6]])
    assert inside.tolist() == [True, True, False, False]


@pytest.mark.parametrize("scale", [1.0, -3.0, 1e-6])
def test_a_matrix_of_any_scale_gives_the_camera_back(camera, scale):
    again = Camera.from_P(scale * camera.P, 1024, 1000)
    assert np.allclose(again.K, camera.K, atol=1e-6)
    assert np.allclose(again.R, camera.R)
    assert np.allclose(again.t_mm, camera.t_mm)


def test_arrays_of_a_camera_are_its_own(camera):
    with pytest.raises(ValueError, match="read-only"):
        camera.K[0, 0] = 1.0


@pytest.mark.parametrize("unit", ["mm", "cm", "m"])
def test_xmalab_files_keep_everything_but_the_covariance(camera, tmp_path, unit):
    path = tmp_path / "new" / "camera.txt"
    write_camera(camera, path, unit)
    again = read_camera(path, unit)
    assert np.allclose(again.P, camera.P, rtol=1e-12)
    assert (again.width, again.height, again.covariance) == (1024, 1000, None)
    lines = path.read_text().splitlines()
    assert [line for line in lines if line and line[0].isalpha()] == [
        "image size",
        "camera matrix",
        "rotation",
        "translation",
    ]
    assert list(tmp_path.glob("new/.*")) == []  # nothing half-written is left


def test_yaml_files_keep_everything(camera, tmp_path):
    write_opencv_yaml(camera, tmp_path / "camera.yaml", unit="m")
    again = read_opencv_yaml(tmp_path / "camera.yaml")
    assert np.allclose(again.P, camera.P, rtol=1e-12)
    assert np.allclose(again.covariance, camera.covariance)
    assert again.name == "16710"
    assert (tmp_path / "camera.yaml").read_text().startswith("%YAML:1.0\n---\n")


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
        ("1024,1000", "1024", "expected 1 x 2 numbers under 'image size', found '1024'"),
        ("0,0,1\r\n", "0,0,2\r\n", "K should be upper triangular"),
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


def test_missing_binary_and_distorted_files_are_refused(camera, tmp_path):
    with pytest.raises(FileNotFoundError, match=r"gone\.txt is missing"):
        read_camera(tmp_path / "gone.txt")
    (tmp_path / "binary.txt").write_bytes(bytes(range(256)))
    with pytest.raises(ValueError, match="expected a text file, a camera file, found binary data"):
        read_camera(tmp_path / "binary.txt")
    write_opencv_yaml(camera, tmp_path / "lens.yaml")
    text = (tmp_path / "lens.yaml").read_text()
    (tmp_path / "lens.yaml").write_text(text.replace("[ 0., 0., 0.", "[ 0.1, 0., 0."))
    with pytest.raises(ValueError, match="expected no lens distortion, found"):
        read_opencv_yaml(tmp_path / "lens.yaml")
    (tmp_path / "lens.yaml").write_text(text.replace("translation_vector", "somewhere"))
    with pytest.raises(ValueError, match="expected an !!opencv-matrix translation_vector"):
        read_opencv_yaml(tmp_path / "lens.yaml")


def test_a_camera_refuses_what_is_none(camera):
    with pytest.raises(ValueError, match="R should be a rotation"):
        Camera(camera.K, -camera.R, camera.t_mm, 10, 10)
    with pytest.raises(ValueError, match=r"t_mm should be \(3,\)"):
        Camera(camera.K, camera.R, np.zeros(2), 10, 10)
    with pytest.raises(ValueError, match=r"expected points of shape \(\.\.\., 3\)"):
        camera.project(np.zeros((3, 2)))
    with pytest.raises(ValueError, match="expected a unit among mm, cm, m"):
        write_camera(camera, "never.txt", unit="inch")


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_arrays_of_cameras_and_distortions_are_finite(camera, value):
    for name in ("K", "R", "t_mm"):
        with pytest.raises(ValueError, match=f"{name} should be .* of finite numbers"):
            dataclasses.replace(camera, **{name: np.full_like(getattr(camera, name), value)})
    with pytest.raises(ValueError, match="control points must be finite"):
        Distortion(np.zeros((4, 2)), np.full((4, 2), value), 64, 64)
    assert isinstance(Camera(camera.K.tolist(), camera.R, camera.t_mm, 64, 64).K, np.ndarray)
