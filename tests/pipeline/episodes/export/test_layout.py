"""Fields of exported data sets: what each log gives, units and frames, and logs that do not fit together."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from pipeline.episodes import EpisodeReader
from pipeline.episodes.export.layout import ExportError, common_layout, layout_of


def test_fields_of_a_wire(wire_logs: Path) -> None:
    with EpisodeReader(wire_logs / "0.mcap") as log:
        layout = layout_of(log, masks=True)
    assert layout.fps == 10
    assert type(layout.fps) is int
    assert layout.action.parts == ("translation", "rotation")
    assert layout.observations["tip"].frame == "world"
    assert layout.observations["tip"].parts == ("tip_x_m", "tip_y_m", "tip_z_m")
    assert {"tip", "feeder", "force", "goal", "joint_positions", "joint_velocities"} == set(layout.observations)
    assert {name: one.shape for name, one in layout.pictures.items()} == {"frontal": (48, 48), "frontal_mask": (48, 48)}
    assert "distance_m" in layout.infos
    assert layout.describe()["observations"]["force"]["unit"] == "N"


def test_fields_of_two_devices(dual_logs: Path) -> None:
    layout = common_layout(sorted(dual_logs.glob("*.mcap")), pictures=False)
    assert layout.action.parts == ("wire_translation", "wire_rotation", "catheter_translation", "catheter_rotation")
    assert layout.observations["feeder"].parts[3:] == (
        "catheter_insertion_m",
        "catheter_rotation_cos",
        "catheter_rotation_sin",
        "lead_m",
    )
    assert layout.infos["device_feeder_forces"].shape == (2,)
    assert not layout.pictures


def test_logs_that_differ_are_refused_by_name(
    wire_logs: Path, dual_logs: Path, record_logs: Callable[..., Path], tmp_path: Path
) -> None:
    shutil.copy(wire_logs / "0.mcap", tmp_path / "a.mcap")
    shutil.copy(dual_logs / "0.mcap", tmp_path / "b.mcap")
    with pytest.raises(
        ExportError, match=r"a.mcap and .*b.mcap differ in action \(2 and 4\), feeder \(3 and 7\)"
    ) as caught:
        common_layout([tmp_path / "a.mcap", tmp_path / "b.mcap"])
    assert "\n" not in str(caught.value)
    assert "device_lead (none and one number)" in str(caught.value)
    other = record_logs(tmp_path / "other", image_size=32)
    with pytest.raises(
        ExportError, match=r"differ in pictures of frontal \(48x48 and 32x32\): export logs of one kind"
    ):
        common_layout([tmp_path / "a.mcap", other / "0.mcap"])
    common_layout([tmp_path / "a.mcap", other / "0.mcap"], pictures=False)
