"""Logs in viewers: Rerun's own MCAP loader, and the layout for Foxglove and Lichtblick."""

import json
import re
from collections import defaultdict
from pathlib import Path
from typing import Any

import pytest

from pipeline.episodes import EpisodeReader
from pipeline.episodes.encoding.schema import DEVICES_TOPIC, STEP_TOPIC, Devices, Step, topic_messages

LAYOUT = Path(__file__).resolve().parents[3] / "docs/foxglove/endonav_layout.json"


def test_rerun_opens_the_log_itself(episode: Any, log_path: Path) -> None:
    chunk = pytest.importorskip("rerun.chunk", reason="rerun-sdk is not installed")
    rows: dict[str, int] = defaultdict(int)
    timelines: set[str] = set()
    components: set[str] = set()
    for part in chunk.McapReader(log_path).stream():
        timelines |= set(part.timeline_names)
        components |= {f"{part.entity_path} {name}" for name in part.to_record_batch().schema.names}
        if not part.is_static:
            rows[part.entity_path] += part.num_rows
    for topic in ("/step", "/wire", "/wire/points", "/camera/frontal/image", "/camera/frontal/mask"):
        assert rows[topic] == len(episode.records), topic
    assert rows["/phantom"] == rows["/tf"] == 1
    for shown in (
        "/camera/frontal/image EncodedImage:blob",
        "/camera/frontal/calibration Pinhole:image_from_camera",
        "/tf Transform3D:translation",
        "/wire/points Points3D:positions",
    ):
        assert shown in components
    assert "message_log_time" in timelines


def test_layout_names_every_panel_once() -> None:
    layout = json.loads(LAYOUT.read_text())
    panels = re.findall(r'"((?:3D|Image|Plot|RawMessages)![a-z]+)"', json.dumps(layout["layout"]))
    assert sorted(panels) == sorted(layout["configById"])


def test_layout_asks_only_for_what_a_log_holds(log_path: Path) -> None:
    configurations = json.loads(LAYOUT.read_text())["configById"]
    with EpisodeReader(log_path) as log:
        assert log.cameras == ("frontal",)
    known = topic_messages(("frontal",), devices=True)
    fields = {
        topic: {field.name: field for field in message.DESCRIPTOR.fields}
        for topic, message in ((STEP_TOPIC, Step), (DEVICES_TOPIC, Devices))
    }
    for panel, settings in configurations.items():
        for topic in settings.get("topics", {}):
            assert topic in known, (panel, topic)
        for path in settings.get("paths", []):
            topic, _, name = path["value"].partition(".")
            name, index = re.fullmatch(r"(\w+)(\[[01]\])?", name).groups()  # type: ignore[union-attr]
            assert path["enabled"] is True
            assert name in fields[topic], (panel, name)
            assert fields[topic][name].is_repeated == (index is not None), "a curve is one number a step"
        if "imageMode" in settings:
            mode = settings["imageMode"]
            assert known[mode["imageTopic"]].DESCRIPTOR.full_name == "foxglove.CompressedImage"
            assert known[mode["calibrationTopic"]].DESCRIPTOR.full_name == "foxglove.CameraCalibration"
    scene = configurations["3D!scene"]
    assert all(scene["topics"][name]["visible"] for name in ("/wire", "/phantom"))
    # an aorta is some 0.25 m long: with the apps' own near plane of 0.5 m it would be cut away
    assert scene["cameraState"]["near"] < 0.1 < scene["cameraState"]["distance"] < scene["cameraState"]["far"]
