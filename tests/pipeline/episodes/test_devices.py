"""Logs of a wire in a catheter: both devices of every step, in the reader, the check, a recovery and the viewers."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.episodes import DeviceRecord, EpisodeReader, EpisodeReadError
from pipeline.episodes.__main__ import main
from pipeline.episodes.checking import check
from pipeline.episodes.encoding.schema import CATHETER_TOPIC, DEVICES_TOPIC, WIRE_TOPIC, topic_messages
from pipeline.episodes.encoding.step_codec import decode_step, encode_devices, encode_step
from pipeline.episodes.recovery import recover
from tests.pipeline.episodes.conftest import compare_records


def draw_devices(step: int, rng: np.random.Generator) -> DeviceRecord:
    """Devices of a step whose every field is distinct."""
    return DeviceRecord(
        wire_points=rng.normal(size=(4 + step % 2, 3)),
        catheter_points=rng.normal(size=(3, 3)),
        insertions=rng.normal(size=2),
        hub_rotations=rng.normal(size=2),
        tip_rotations=rng.normal(size=2),
        lead=float(rng.normal()),
        feeder_forces=rng.normal(size=2),
        hub_torques=rng.normal(size=2),
    )


@pytest.fixture
def pair(episode: Any) -> Any:
    """The episode with a catheter."""
    rng = np.random.default_rng(7)
    configuration = {**episode.info.configuration, "catheter": {"length": 1.0}, "catheter_preset": "simmons2"}
    episode.info = replace(episode.info, configuration=configuration)
    episode.records = [
        replace(record, action=rng.normal(size=4), devices=draw_devices(record.step, rng)) for record in episode.records
    ]
    return episode


def test_both_devices_come_back(pair: Any, tmp_path: Path) -> None:
    path = pair.write(tmp_path / "pair.mcap")
    with EpisodeReader(path) as log:
        assert log.info.catheter_name == "simmons2"
        for found, given in zip(log, pair.records, strict=True):
            compare_records(found.devices, given.devices)
        compare_records(log.step(17).devices, pair.records[17].devices)
        arrays = log.load_arrays(pictures=False)
    assert arrays["action"].shape == (23, 4)
    np.testing.assert_array_equal(arrays["devices/wire_count"], [4 + i % 2 for i in range(23)])
    np.testing.assert_array_equal(arrays["devices/wire_points"][3, :5], pair.records[3].devices.wire_points)
    assert np.isnan(arrays["devices/wire_points"][2, 4:]).all()
    np.testing.assert_array_equal(arrays["devices/feeder_forces"][5], pair.records[5].devices.feeder_forces)
    assert arrays["devices/lead"].shape == (23,)
    assert not check(path).problems


def test_the_scene_shows_each_device(pair: Any, tmp_path: Path) -> None:
    from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

    shown = {WIRE_TOPIC: ("wire", "wire_points"), CATHETER_TOPIC: ("catheter", "catheter_points")}
    with EpisodeReader(pair.write(tmp_path / "pair.mcap")) as log:
        for topic, (name, points) in shown.items():
            lines = [SceneUpdate.FromString(payload).entities[0] for _, payload in log.payloads(topic)]
            assert [entity.id for entity in lines] == [name] * 23
            found = [[point.x, point.y, point.z] for point in lines[9].lines[0].points]
            np.testing.assert_array_equal(found, getattr(pair.records[9].devices, points))


def test_each_device_has_masks_of_its_own(pair: Any, tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    wires, catheters = (rng.random((23, *pair.masks[0].shape)) < 0.3 for _ in range(2))
    with pair.writer(tmp_path / "pair.mcap") as log:
        for record, image, wire, catheter in zip(pair.records, pair.images, wires, catheters, strict=True):
            masks = {"wire": {"frontal": wire}, "catheter": {"frontal": catheter}}
            log.step(record, images={"frontal": image}, masks={"frontal": wire | catheter}, device_masks=masks)
        log.finish(pair.outcome)
    with EpisodeReader(tmp_path / "pair.mcap") as log:
        np.testing.assert_array_equal(log.mask("frontal", 8, "catheter"), catheters[8])
        np.testing.assert_array_equal(np.stack(list(log.masks("frontal", "wire"))), wires)
        arrays = log.load_arrays()
    np.testing.assert_array_equal(arrays["mask_catheter/frontal"], catheters)
    np.testing.assert_array_equal(arrays["mask/frontal"], wires | catheters)
    report = check(tmp_path / "pair.mcap")
    assert (report.problems, report.notes, report.pictures) == ([], [], 4 * 23)


def test_the_wire_alone_has_no_topic_of_devices(log_path: Path) -> None:
    with EpisodeReader(log_path) as log:
        topics = {channel.topic for channel in log.summary.channels.values()}
        assert not log.info.has_catheter
        assert all(record.devices is None for record in log)
        assert not any(name.startswith("devices") for name in log.load_arrays(pictures=False))
    assert topics == set(topic_messages(("frontal",)))
    assert DEVICES_TOPIC not in topics


def test_devices_and_configuration_must_agree(episode: Any, pair: Any, tmp_path: Path) -> None:
    mask = {"frontal": episode.masks[0]}
    pictures = {"images": {"frontal": episode.images[0]}, "masks": mask}
    bare = replace(pair.records[0], devices=None)
    with pair.writer(tmp_path / "a.mcap") as log, pytest.raises(ValueError, match="names a catheter: got none in step"):
        log.step(bare, **pictures)
    pair.info = replace(pair.info, configuration={})
    with pair.writer(tmp_path / "b.mcap") as log:
        with pytest.raises(ValueError, match="a catheter: got devices in step 0"):
            log.step(pair.records[0], **pictures)
        with pytest.raises(ValueError, match="a log without a catheter has no mask_wire"):
            log.step(bare, **pictures, device_masks={"wire": mask})


def test_what_is_no_pair_is_refused(pair: Any) -> None:
    record, devices = pair.records[4], pair.records[4].devices
    with pytest.raises(ValueError, match=r"feeder_forces must have shape \(2,\), got \(3,\)"):
        replace(devices, feeder_forces=np.zeros(3))
    step, message = encode_step(record), encode_devices(4, devices)
    compare_records(decode_step(step, message).devices, devices)
    with pytest.raises(ValueError, match="no message"):
        decode_step(step, message[:-3])
    with pytest.raises(ValueError, match="the devices of step 4 are those of step 5"):
        decode_step(step, encode_devices(5, devices))


def test_a_partial_log_is_recovered_with_its_devices(pair: Any, tmp_path: Path) -> None:
    log = pair.writer(tmp_path / "pair.mcap")
    pair.record_steps(log, 0, 20)
    log.abandon()
    report = recover(log.partial, tmp_path / "saved.mcap")
    assert report.steps_kept == 20
    with EpisodeReader(tmp_path / "saved.mcap") as saved:
        for found, given in zip(saved, pair.records[:20], strict=True):
            compare_records(found.devices, given.devices)


def test_the_check_finds_what_is_not_finite(pair: Any, tmp_path: Path) -> None:
    devices = pair.records[2].devices
    absent = {"wire_points": np.zeros((0, 3)), "tip_rotations": np.array([np.nan, 0.1])}
    pair.records[1] = replace(pair.records[1], devices=replace(devices, **absent))  # a wire that there is not
    pair.records[2] = replace(pair.records[2], devices=replace(devices, lead=np.inf))
    assert check(pair.write(tmp_path / "pair.mcap")).problems == [
        "step 2 has a non-finite number in lead of its devices"
    ]


def test_a_log_that_only_claims_a_catheter_is_refused(pair: Any, tmp_path: Path, monkeypatch: Any) -> None:
    from pipeline.episodes import writer

    monkeypatch.setattr(writer, "encode_devices", lambda step, devices: b"\x12\x05hello")
    path = pair.write(tmp_path / "pair.mcap")
    with EpisodeReader(path) as log, pytest.raises(EpisodeReadError, match=r"pair\.mcap is damaged"):
        log.load_arrays(pictures=False)
    assert check(path).problems


def test_info_shows_both(pair: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = pair.write(tmp_path / "pair.mcap")
    assert main(["info", str(path)]) == 0
    assert "simmons2" in capsys.readouterr().out
