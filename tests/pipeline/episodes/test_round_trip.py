"""Writing and reading a log: fields, pictures and bytes, in order, at random, by other programs; the codec of steps."""

import io
from dataclasses import replace

import numpy as np
import pytest
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from PIL import Image

from pipeline.episodes import (
    EpisodeOutcome,
    EpisodeReader,
    EpisodeReadError,
    EpisodeWriteError,
    EpisodeWriter,
    PhantomMesh,
)
from pipeline.episodes.checking import check
from pipeline.episodes.encoding.png import decode_image, decode_mask, encode_image, encode_mask
from pipeline.episodes.encoding.scene import encode_wire_line, encode_wire_points
from pipeline.episodes.encoding.schema import STEP_FIELDS, Step
from pipeline.episodes.encoding.step_codec import decode_step, encode_step
from pipeline.episodes.records import StepRecord


@pytest.mark.parametrize("flush_every", [1, 10])
def test_every_field_comes_back(episode, assert_same, tmp_path, flush_every):
    path = episode.write(tmp_path / "episode.mcap", flush_every=flush_every)
    with EpisodeReader(path) as log:
        assert log.info == episode.info
        assert log.outcome == episode.outcome
        assert len(log) == 23
        for found, given in zip(log, episode.records, strict=True):
            assert_same(found, given)
        np.testing.assert_array_equal(np.stack(list(log.images("frontal"))), episode.images)
        np.testing.assert_array_equal(np.stack(list(log.masks("frontal"))), episode.masks)
        for name in ("P", "K", "R", "t"):
            assert getattr(log.camera("frontal"), name).tobytes() == getattr(episode.cameras["frontal"], name).tobytes()
        for name in ("vertices", "faces", "target", "entry"):
            assert getattr(log.phantom_mesh(), name).tobytes() == getattr(episode.mesh, name).tobytes()


def test_random_access_equals_streaming(log_path, episode, assert_same):
    with EpisodeReader(log_path) as log:
        for step in np.random.default_rng(3).permutation(23):
            assert_same(log.step(int(step)), episode.records[step])
            np.testing.assert_array_equal(log.image("frontal", int(step)), episode.images[step])
            np.testing.assert_array_equal(log.mask("frontal", int(step)), episode.masks[step])


def test_stock_decoder_reads_all_topics(log_path, episode):
    found: dict[str, list] = {}
    with log_path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            assert schema is not None
            found.setdefault(channel.topic, []).append((message.log_time, decoded))
        assert reader.get_summary().statistics.message_count == sum(map(len, found.values()))
    steps = found["/step"]
    assert [time for time, _ in steps] == [1_731_000_000_123_456_789 + 100_000_000 * i for i in range(23)]
    for (_, message), record in zip(steps, episode.records, strict=True):
        np.testing.assert_array_equal(np.reshape(message.wire_points, (-1, 3)), record.wire_points)
        assert message.resultant_force_norm == record.resultant_force_norm
        assert dict(message.extra) == dict(record.extra)
    counts = {topic: len(messages) for topic, messages in found.items()}
    every_step = ("/step", "/wire", "/wire/points", "/camera/frontal/image", "/camera/frontal/mask")
    once = ("/phantom", "/tf", "/camera/frontal/calibration")
    assert counts == dict.fromkeys(every_step, 23) | dict.fromkeys(once, 1)
    image = found["/camera/frontal/image"][4][1]
    assert (image.format, image.frame_id) == ("png", "camera/frontal")


def test_arrays_are_stacked_and_padded(log_path, episode):
    with EpisodeReader(log_path) as log:
        arrays = log.load_arrays()
        without = log.load_arrays(pictures=False)
    np.testing.assert_array_equal(arrays["action"], [record.action for record in episode.records])
    np.testing.assert_array_equal(arrays["contact_count"], [i % 4 for i in range(23)])
    assert arrays["contact_forces"].shape == (23, 3, 3)
    np.testing.assert_array_equal(arrays["contact_forces"][2, :2], episode.records[2].contact_forces)
    assert np.isnan(arrays["contact_forces"][2, 2:]).all()
    np.testing.assert_allclose(arrays["time_s"], 0.1 * np.arange(23))
    np.testing.assert_array_equal(arrays["image/frontal"], episode.images)
    np.testing.assert_array_equal(arrays["mask/frontal"], episode.masks)
    np.testing.assert_array_equal(arrays["extra/distance_m"], [r.extra["distance_m"] for r in episode.records])
    assert not any(key.startswith(("image", "mask")) for key in without)


def test_large_pictures_close_chunks_early(episode, tmp_path):
    camera = replace(episode.cameras["frontal"], width=500, height=400)
    image = np.random.default_rng(4).integers(0, 256, (400, 500), dtype=np.uint8)
    path = tmp_path / "large.mcap"
    with EpisodeWriter(path, episode.info, cameras={"big": camera}, flush_every=10) as log:
        for record in episode.records:
            log.step(record, images={"big": image})
    with EpisodeReader(path) as log:
        sizes = [index.uncompressed_size for index in log.summary.chunk_indexes]
        np.testing.assert_array_equal(log.image("big", 22), image)
        assert not log.has("big", "mask")
        with pytest.raises(EpisodeReadError, match="holds nothing on /camera/big/mask"):
            log.mask("big", 0)
    assert max(sizes) <= 256 * 1024
    assert not check(path).problems


def test_log_without_cameras_and_mesh(episode, tmp_path):
    path = tmp_path / "bare.mcap"
    with EpisodeWriter(path, episode.info) as log:
        log.step(episode.records[0])
    with EpisodeReader(path) as log:
        assert log.phantom_mesh() is None
        assert log.cameras == ()
        assert log.outcome == EpisodeOutcome(success=None, steps=0)
    assert check(path).notes == ["no phantom mesh"]


def test_finish_is_idempotent_and_final(episode, tmp_path):
    log = episode.writer(tmp_path / "episode.mcap")
    episode.record_steps(log)
    first = log.finish(episode.outcome).read_bytes()
    assert log.finish(episode.outcome).read_bytes() == first
    assert not log.partial.exists()
    with pytest.raises(EpisodeWriteError, match="is finished: start a new writer"):
        log.step(replace(episode.records[0], step=23))


def test_exception_leaves_the_partial_file(episode, tmp_path):
    path = tmp_path / "episode.mcap"
    log = episode.writer(path)

    def run() -> None:
        with log:
            episode.record_steps(log, 0, 7)
            raise RuntimeError("the policy failed")

    with pytest.raises(RuntimeError, match="the policy failed"):
        run()
    assert not path.exists()
    assert log.partial.exists()
    assert log.steps_safe == 7
    with pytest.raises(EpisodeWriteError, match=r"abandoned: run 'python -m pipeline\.episodes recover"):
        log.finish()


def test_nothing_is_overwritten_unasked(log_path, episode):
    before = log_path.read_bytes()
    with pytest.raises(EpisodeWriteError, match=r"episode\.mcap exists already"):
        episode.writer(log_path)
    partial = log_path.with_name("other.mcap.partial")
    partial.write_bytes(b"steps of another writer")
    with pytest.raises(EpisodeWriteError, match="at work or was killed: run"):
        episode.writer(log_path.with_name("other.mcap"))
    assert log_path.read_bytes() == before
    assert partial.read_bytes() == b"steps of another writer"
    assert episode.write(log_path, overwrite=True).read_bytes() == before


def test_wrong_steps_are_refused_and_not_recorded(episode, tmp_path):
    with episode.writer(tmp_path / "episode.mcap") as log:
        episode.record_steps(log, 0, 1)
        one = episode.records[1]
        pictures = {"images": {"frontal": episode.images[1]}, "masks": {"frontal": episode.masks[1]}}
        with pytest.raises(ValueError, match="expected step 1, got 2"):
            log.step(episode.records[2], **pictures)
        with pytest.raises(ValueError, match="'side' was not declared; the cameras of this log are: frontal"):
            log.step(one, images={"side": episode.images[1]})
        with pytest.raises(ValueError, match=r"must be uint8 of shape \(20, 33\), got uint8 of shape \(3, 3\)"):
            log.step(one, images={"frontal": np.zeros((3, 3), np.uint8)}, masks=pictures["masks"])
        with pytest.raises(ValueError, match="every step needs the images and masks of step 0"):
            log.step(one)
        with pytest.raises(ValueError, match="of the shapes of step 0"):
            log.step(replace(one, action=np.zeros(21)), **pictures)
        with pytest.raises(ValueError, match=r"must be uint8 of shape .*, got float64"):
            log.step(one, images={"frontal": episode.images[1] / 255.0}, masks=pictures["masks"])
        assert log.steps_recorded == 1
        episode.record_steps(log, 1)
        with pytest.raises(ValueError, match="must count 22 steps"):
            log.finish(EpisodeOutcome(success=True, steps=23))
        log.finish(episode.outcome)
    assert not check(log.path).problems


def test_wrong_arguments_are_refused(episode, tmp_path):
    camera = episode.cameras["frontal"]
    for message, make in {
        "flush_every must be 1 to 10": lambda: episode.writer(tmp_path / "a.mcap", flush_every=11),
        "control_dt": lambda: replace(episode.info, control_dt=0.0),
        "finished, interrupted, got 'lost'": lambda: replace(episode.outcome, status="lost"),
        "No such file": lambda: EpisodeReader(tmp_path / "none.mcap"),
        "up to scale": lambda: replace(camera, t=camera.t + 0.1),
        "orthonormal": lambda: replace(camera, R=camera.R * 1.1),
        "must index 2 vertices, got 0 to 2": lambda: PhantomMesh(
            vertices=np.zeros((2, 3)), faces=np.array([[0, 1, 2]]), target=np.zeros(3), entry=np.zeros(3)
        ),
        r"must be \(H, W\) uint8, got \(3, 3\) float64": lambda: encode_image(np.zeros((3, 3))),
        "bool or uint8": lambda: encode_mask(np.zeros((3, 3, 3), bool)),
        "not a readable PNG": lambda: decode_image(encode_image(np.zeros((9, 9), np.uint8))[:-30], 9, 9),
    }.items():
        with pytest.raises((ValueError, EpisodeReadError), match=message):
            make()


def test_non_finite_metrics_become_none(episode):
    outcome = replace(episode.outcome, metrics={"a": np.float64("nan"), "b": [np.inf, np.int64(3)]})
    assert outcome.metrics == {"a": None, "b": [None, 3]}


def test_asking_for_what_is_not_there(log_path):
    with EpisodeReader(log_path) as log:
        with pytest.raises(EpisodeReadError, match="no step 23 on /step; it holds steps 0 to 22"):
            log.step(23)
        with pytest.raises(EpisodeReadError, match="no step -1"):
            log.step(-1)
        with pytest.raises(EpisodeReadError, match="no camera 'side'; its cameras are: frontal"):
            log.image("side", 0)


@pytest.mark.parametrize("shape", [(1, 1), (7, 300), (255, 256), (1, 65535)])
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
    part = image[::2, ::3]  # not contiguous
    np.testing.assert_array_equal(decode_image(encode_image(part), *part.shape), part)


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


def test_phantom_lies_in_the_world(episode):
    entity = SceneUpdate.FromString(episode.mesh.scene(1_500_000_007)).entities[0]
    assert (entity.frame_id, entity.timestamp.seconds, entity.timestamp.nanos) == ("world", 1, 500_000_007)


@pytest.mark.parametrize("count", [0, 29])
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


def as_message(record: StepRecord):
    message = Step()
    for name, field in STEP_FIELDS.items():
        value = getattr(record, name)
        if field.shape:
            getattr(message, name).extend(np.ravel(value).tolist())
        else:
            setattr(message, name, value)
    for key, value in record.extra.items():
        message.extra[key] = value
    return message


@pytest.mark.parametrize("index", [0, 3])  # without contacts, and with three
def test_codec_and_library_read_each_other(episode, assert_same, index):
    record = episode.records[index]
    assert Step.FromString(encode_step(record)) == as_message(record)
    assert_same(decode_step(as_message(record).SerializeToString()), record)


def test_round_trip_keeps_special_numbers(episode, assert_same):
    record = replace(
        episode.records[4],
        step=999_999,
        joint_positions=np.array([np.nan, np.inf, -np.inf, -0.0, 5e-324, 1.7e308, 0.1]),
        reward=-0.0,
        extra={"größe_m": 1e-300, "": 0.0},
    )
    assert_same(decode_step(encode_step(record)), record)


def test_fields_of_later_versions_are_skipped_and_unpacked_doubles_read(episode, assert_same):
    data = encode_step(episode.records[3]) + b"\xfa\x01\x03abc" + b"\x80\x02\x05"
    assert_same(decode_step(data), episode.records[3])
    data = encode_step(replace(episode.records[3], action=np.zeros(0)))
    unpacked = b"\x11" + np.float64(1.5).tobytes() + b"\x11" + np.float64(-2.5).tobytes()
    np.testing.assert_array_equal(decode_step(data + unpacked).action, [1.5, -2.5])


@pytest.mark.parametrize("cut", [1, 5, 100])
def test_cut_message_is_refused(episode, cut):
    with pytest.raises(ValueError, match=r"message|multiple|bytes"):
        decode_step(encode_step(episode.records[3])[:-cut] if cut < 100 else b"\x12\x05hello")


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("tip", np.zeros(2), r"tip must have shape \(3,\)"),
        ("wire_points", np.zeros(6), r"wire_points must have shape \(n, 3\)"),
        ("contact_forces", np.zeros((9, 3)), "3 positions and 9 forces"),
        ("step", -1, "step must lie in 0 to 1000000"),
    ],
)
def test_record_refuses_wrong_shapes(episode, name, value, message):
    with pytest.raises(ValueError, match=message):
        replace(episode.records[3], **{name: value})


def test_force_norm_is_that_of_its_vector(episode):
    assert replace(episode.records[0], resultant_force=np.array([2.0, -3.0, 6.0])).resultant_force_norm == 7.0
