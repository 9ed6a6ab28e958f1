"""Logs in viewers: the Rerun recording, Rerun's own MCAP loader, and the layout for Foxglove and Lichtblick."""

import builtins
import io
import json
import re
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from pipeline.episodes import EpisodeReader, ViewerError
from pipeline.episodes.__main__ import main
from pipeline.episodes.encoding.schema import DEVICES_TOPIC, STEP_TOPIC, Devices, Step, topic_messages
from tests.pipeline.episodes.conftest import Episode, draw_episode

LAYOUT = Path(__file__).resolve().parents[3] / "docs/foxglove/endonav_layout.json"
NO_RERUN = "the extra rerun is not installed"


@pytest.fixture(scope="module")
def shown() -> Episode:
    return draw_episode(23)


@pytest.fixture(scope="module")
def rrd_path(shown: Episode, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The episode as a Rerun recording, made by the command line, its log beside it."""
    pytest.importorskip("rerun", reason=NO_RERUN)
    log = shown.write(tmp_path_factory.mktemp("rerun") / "episode.mcap")
    assert main(["view", str(log), "--save", str(log.with_name("out") / "episode.rrd")]) == 0
    return log.with_name("out") / "episode.rrd"


def columns(path: Path) -> dict[str, dict[str, list[Any]]]:
    """Entity -> column -> values of all rows, as Rerun reads them back; static rows have no index columns."""
    from rerun.chunk import RrdReader

    found: dict[str, dict[str, list[Any]]] = defaultdict(lambda: defaultdict(list))
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        for name in batch.schema.names:
            found[chunk.entity_path][name] += batch.column(name).to_pylist()
    return found


def by_step(entity: dict[str, list[Any]], column: str) -> dict[int, Any]:
    """Step -> the value logged there."""
    return dict(zip(entity["step"], entity[column], strict=True))


@pytest.fixture(scope="module")
def found(rrd_path: Path) -> dict[str, dict[str, list[Any]]]:
    """What the recording holds."""
    return columns(rrd_path)


def test_every_step_of_a_log_is_in_the_recording(shown: Episode, found: dict[str, dict[str, list[Any]]]) -> None:
    wire = by_step(found["/world/wire"], "LineStrips3D:strips")
    arrows = by_step(found["/world/contacts"], "Arrows3D:vectors")
    tips = by_step(found["/world/tip"], "Points3D:positions")
    assert sorted(wire) == list(range(len(shown.records)))
    for record in shown.records:
        assert np.array(wire[record.step][0]) == pytest.approx(record.wire_points, rel=1e-6)
        assert np.array(tips[record.step][0]) == pytest.approx(record.tip, rel=1e-6)
        vectors = np.array(arrows[record.step], dtype=float).reshape(-1, 3)
        assert vectors == pytest.approx(0.05 * record.contact_forces, rel=1e-5)
    expected = {
        "force_n": [record.resultant_force_norm for record in shown.records],
        "insertion_m": [record.insertion for record in shown.records],
        "rotation_rad": [record.rotation for record in shown.records],
        "reward": [record.reward for record in shown.records],
        "distance_m": [record.extra["distance_m"] for record in shown.records],
    }
    for name, values in expected.items():
        curve = by_step(found[f"/curves/{name}"], "Scalars:scalars")
        assert [curve[step][0] for step in range(len(values))] == pytest.approx(values), name
    times = by_step(found["/world/wire"], "time")
    seconds = {step: t.total_seconds() if hasattr(t, "total_seconds") else t / 1e9 for step, t in times.items()}
    assert seconds == pytest.approx({record.step: 0.1 * record.step for record in shown.records})


def test_pictures_scene_and_outcome(shown: Episode, found: dict[str, dict[str, list[Any]]]) -> None:
    images = by_step(found["/world/camera/frontal/image"], "EncodedImage:blob")
    masks = by_step(found["/world/camera/frontal/mask"], "SegmentationImage:buffer")
    for step in (0, len(shown.records) - 1):
        png = bytes(np.array(images[step][0], np.uint8))
        assert np.array_equal(np.array(Image.open(io.BytesIO(png))), shown.images[step])
        mask = np.array(masks[step][0], np.uint8).reshape(shown.masks[step].shape)
        assert np.array_equal(mask, shown.masks[step])
    mesh = found["/world/phantom"]
    assert np.array(mesh["Mesh3D:vertex_positions"][0]) == pytest.approx(shown.mesh.vertices, rel=1e-6)
    assert np.array_equal(np.array(mesh["Mesh3D:triangle_indices"][0]), shown.mesh.faces)
    assert np.array(found["/world/target"]["Points3D:positions"][0][0]) == pytest.approx(shown.mesh.target)
    camera = shown.cameras["frontal"]
    source = found["/world/camera/frontal"]["Transform3D:translation"]
    assert np.array(next(row for row in source if row)[0]) == pytest.approx(-camera.R.T @ camera.t, rel=1e-5)
    text = found["/episode"]["TextDocument:text"][0][0]
    assert re.search(r"type_1, descending_aorta to bca(.|\n)*22 steps(.|\n)*target reached", text)


def test_a_recording_has_its_arrangement_of_views_and_its_identity(rrd_path: Path) -> None:
    from rerun.chunk import RrdReader

    from pipeline.episodes.rerun import save_recording

    log = rrd_path.parent.with_name("episode.mcap")
    reader, again = RrdReader(rrd_path), RrdReader(save_recording(log, rrd_path.with_name("again.rrd")))
    assert len(reader.blueprints()) == 1
    assert reader.recordings()[0].application_id == "endonav"
    assert reader.recordings()[0].recording_id == again.recordings()[0].recording_id
    assert not list(rrd_path.parent.glob("*.partial"))


def test_scalars_that_come_late_keep_their_step(make_episode: Callable[..., Any], tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason=NO_RERUN)
    from pipeline.episodes.rerun import save_recording

    episode = make_episode(6)
    object.__setattr__(episode.records[4], "extra", {"late_m": 0.25})
    found = columns(save_recording(episode.write(tmp_path / "e.mcap"), tmp_path / "e.rrd"))
    late = by_step(found["/curves/late_m"], "Scalars:scalars")
    assert late[4][0] == 0.25
    assert all(np.isnan(late[step][0]) for step in (0, 3, 5))
    assert np.isnan(by_step(found["/curves/distance_m"], "Scalars:scalars")[4][0])


def test_rerun_opens_the_log_itself(episode: Any, log_path: Path) -> None:
    chunk = pytest.importorskip("rerun.chunk", reason=NO_RERUN)
    rows: dict[str, int] = defaultdict(int)
    timelines: set[str] = set()
    for part in chunk.McapReader(log_path).stream():
        timelines |= set(part.timeline_names)
        if not part.is_static:
            rows[part.entity_path] += part.num_rows
    for topic in ("/step", "/wire", "/wire/points", "/camera/frontal/image", "/camera/frontal/mask"):
        assert rows[topic] == len(episode.records), topic
    assert rows["/phantom"] == rows["/tf"] == 1
    assert "message_log_time" in timelines


def test_bad_input_is_one_sentence(log_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("rerun", reason=NO_RERUN)
    assert main(["view", str(tmp_path / "none.mcap"), "--save", str(tmp_path / "o.rrd")]) == 2
    assert "is no file" in capsys.readouterr().err
    (tmp_path / "file").write_text("in the way")
    assert main(["view", str(log_path), "--save", str(tmp_path / "file" / "o.rrd")]) == 2
    assert re.search(r"cannot write .*; choose another file", capsys.readouterr().err)
    broken = bytearray(log_path.read_bytes())
    broken[len(broken) // 2] ^= 0xFF
    (tmp_path / "broken.mcap").write_bytes(broken)
    assert main(["view", str(tmp_path / "broken.mcap"), "--save", str(tmp_path / "o.rrd")]) == 1
    assert "is damaged" in capsys.readouterr().err
    assert not list(tmp_path.glob("o.rrd*")), "nothing half-written is left"


def test_without_the_extra_it_says_what_to_install(
    log_path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from pipeline.episodes.rerun import save_recording

    load = builtins.__import__

    def refuse(name: str, *arguments: Any, **keywords: Any) -> Any:
        if name == "rerun":
            raise ModuleNotFoundError("No module named 'rerun'", name="rerun")
        return load(name, *arguments, **keywords)

    monkeypatch.setattr(builtins, "__import__", refuse)
    with pytest.raises(ViewerError, match=r"needs the extra rerun.*pip install .*'\.\[rerun\]'"):
        save_recording(log_path, tmp_path / "o.rrd")
    assert main(["view", str(log_path)]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1


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
