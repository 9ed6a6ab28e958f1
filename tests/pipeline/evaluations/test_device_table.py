"""The table of devices: one line a catheter beside the wire alone, from the logs of a run."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.evaluations.logs import read_evaluation
from pipeline.evaluations.tables import tables_from_logs
from pipeline.report.tables import report_tables
from tests.pipeline.evaluations.evaluation_logs import write_evaluation, write_row


def test_each_device_has_a_line_with_its_success_and_forces(tmp_path: Path) -> None:
    write_row(tmp_path, "enn", "I+V+M", successes=(True, False))
    for catheter, force in (("simmons2", -0.3), ("vertebral", 0.1)):
        for index, success in enumerate((True, True)):
            write_row(
                tmp_path,
                "enn",
                "I+V+M",
                successes=(success,),
                folder=f"enn@stage.catheter={catheter}",
                seed=index,
                catheter=catheter,
                feeder_forces=(0.2, force * (index + 1)),
            )
    tables = tables_from_logs(tmp_path)
    table = tables["devices"]
    assert list(table) == [f"type_1/bca/enn/I+V+M/{device}" for device in ("wire", "simmons2", "vertebral")]
    bare, simmons = table["type_1/bca/enn/I+V+M/wire"], table["type_1/bca/enn/I+V+M/simmons2"]
    assert (bare["n"], simmons["n"]) == (2, 2)
    assert (bare["success_pct"][0], simmons["success_pct"][0]) == (50, 100)
    assert not any("feeder" in column for column in bare)
    assert simmons["wire_feeder_n"] == pytest.approx([0.2, 0.0])
    assert simmons["catheter_feeder_n"] == pytest.approx([0.45, 0.15])
    assert simmons["catheter_feeder_max_n"] == pytest.approx(0.6)
    assert set(tables["enn"]) == {
        f"type_1/bca/I+V+M{catheter}" for catheter in ("", " (simmons2)", " (vertebral)")
    }  # never pooled
    shown = next(one for one in report_tables(tables) if one.key == "devices")
    assert [column.label for column in shown.columns][-1] == "Catheter's feeder, largest"


def test_the_experts_episodes_are_told_apart(tmp_path: Path) -> None:
    for index, catheter in enumerate((None, "jb2")):
        write_evaluation(
            tmp_path / f"expert/type_1/lcca/evaluation/{index:03d}.mcap",
            target="lcca",
            success=index == 1,
            operator="sampling_expert",
            catheter=catheter,
        )
    tables = tables_from_logs(tmp_path)
    assert {row: cells["n"] for row, cells in tables["expert"].items()} == {"type_1/lcca": 1, "type_1/lcca (jb2)": 1}
    assert list(tables["devices"]) == [f"type_1/lcca/expert/sampling_expert/{device}" for device in ("wire", "jb2")]


def test_the_wire_alone_needs_no_table_of_devices(tmp_path: Path) -> None:
    logs = write_row(tmp_path, "enn", "I+V+M")
    assert "devices" not in tables_from_logs(tmp_path)
    one = read_evaluation(logs[0], tmp_path)
    assert (one.device, one.feeder_forces) == ("wire", None)


def test_paths_of_different_devices_are_not_compared(tmp_path: Path) -> None:
    bare = read_evaluation(write_row(tmp_path, "enn", "V")[0], tmp_path)
    other = read_evaluation(write_row(tmp_path, "enn", "V", catheter="jb2")[0], tmp_path)
    assert bare.task != other.task
