"""PNG pictures, the camera and the scene of a log."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from PIL import Image

from pipeline.episodes import Camera, PhantomMesh
from pipeline.episodes.encoding.png import decode_image, decode_mask, encode_image, encode_mask
from pipeline.episodes.encoding.scene import decode_phantom, encode_wire_line, encode_wire_points


@pytest.mark.parametrize("shape", [(1, 1), (80, 80), (7, 300), (255, 256), (1, 65535), (400, 401)])
def test_pictures_round_trip(shape):
    rng = np.random.default_rng(1)
    image = rng.integers(0, 256, shape, dtype=np.uint8)
    mask = rng.random(shape) < 0.5
    np.testing.assert_array_equal(decode_image(encode_image(image), *image.shape), image)
    np.testing.assert_array_equal(decode_mask(encode_mask(mask), *shape), mask)
    np.testing.assert_array_equal(decode_mask(encode_mask(mask * np.uint8(7)), *shape), mask)


def test_other_programs_read_the_pictures():
    image = np.arange(80 * 60, dtype=np.uint16).astype(np.uint8).reshape(60, 80)
    picture = Image.open(io.BytesIO(encode_image(image)))
    assert (picture.mode, picture.size) == ("L", (80, 60))
    picture.verify()  # compares the checksum of every chunk
    assert Image.open(io.BytesIO(encode_mask(image > 9))).mode == "1"


def test_non_contiguous_pictures_are_written():
    image = np.arange(600, dtype=np.uint16).astype(np.uint8).reshape(20, 30)[::2, ::3]
    np.testing.assert_array_equal(decode_image(encode_image(image), *image.shape), image)


def test_other_arrays_are_refused():
    with pytest.raises(ValueError, match=r"must be \(H, W\) uint8, got \(3, 3\) float64"):
        encode_image(np.zeros((3, 3)))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="bool or uint8"):
        encode_mask(np.zeros((3, 3, 3), bool))
    with pytest.raises(ValueError, match="not a readable PNG"):
        decode_image(encode_image(np.zeros((9, 9), np.uint8))[:-30], 9, 9)


def test_camera_refuses_what_does_not_fit(episode):
    camera = episode.cameras["frontal"]
    with pytest.raises(ValueError, match="up to scale"):
        replace(camera, t=camera.t + 0.1)
    with pytest.raises(ValueError, match="orthonormal"):
        replace(camera, R=camera.R * 1.1)


def test_messages_of_a_camera_project_as_its_matrix(episode):
    camera = episode.cameras["frontal"]
    point = np.array([0.03, -0.02, 0.05])
    u, v, w = camera.P @ np.append(point, 1)
    pose = camera.transform("frontal", 5)
    q = np.array([pose.rotation.x, pose.rotation.y, pose.rotation.z])
    # world -> camera: the inverse of the unit quaternion turns p - centre
    moved = point - np.array([pose.translation.x, pose.translation.y, pose.translation.z])
    moved = moved + 2 * np.cross(-q, np.cross(-q, moved) + pose.rotation.w * moved)
    calibration = CameraCalibration.FromString(camera.calibration("frontal", 5))
    x, y, z = np.reshape(calibration.P, (3, 4)) @ np.append(moved, 1)
    np.testing.assert_allclose([x / z, y / z], [u / w, v / w], atol=1e-9)
    assert (calibration.width, calibration.height) == (camera.width, camera.height)


def test_camera_keeps_every_bit_as_json(episode):
    camera = episode.cameras["frontal"]
    found = Camera.from_json(camera.to_json())
    for name in ("P", "K", "R", "t"):
        assert getattr(found, name).tobytes() == getattr(camera, name).tobytes()


def test_phantom_round_trips(episode):
    found = decode_phantom(episode.mesh.scene(77))
    for name in ("vertices", "faces", "target", "entry"):
        assert getattr(found, name).tobytes() == getattr(episode.mesh, name).tobytes()
    entity = SceneUpdate.FromString(episode.mesh.scene(1_500_000_007)).entities[0]
    assert (entity.frame_id, entity.timestamp.seconds, entity.timestamp.nanos) == ("world", 1, 500_000_007)


def test_phantom_refuses_faces_without_vertices():
    with pytest.raises(ValueError, match="must index 2 vertices, got 0 to 2"):
        PhantomMesh(vertices=np.zeros((2, 3)), faces=np.array([[0, 1, 2]]), target=np.zeros(3), entry=np.zeros(3))


@pytest.mark.parametrize("count", [0, 1, 29, 200])
def test_wire_messages_hold_the_wire(count):
    points = np.random.default_rng(2).normal(size=(count, 3))
    entity = SceneUpdate.FromString(encode_wire_line(points, 3_000_000_001)).entities[0]
    assert (entity.id, entity.frame_id, entity.timestamp.nanos) == ("wire", "world", 1)
    np.testing.assert_array_equal(np.reshape([(p.x, p.y, p.z) for p in entity.lines[0].points], (-1, 3)), points)
    assert entity.lines[0].scale_invariant
    cloud = PointCloud.FromString(encode_wire_points(points, 3_000_000_001))
    assert [field.name for field in cloud.fields] == ["x", "y", "z"]
    np.testing.assert_array_equal(
        np.frombuffer(cloud.data, "<f4").reshape(-1, cloud.point_stride // 4), points.astype(np.float32)
    )
