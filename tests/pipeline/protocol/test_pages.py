"""Tables of results in documents are what the files of results say, which are of the present policies and data."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from pipeline.protocol.claims import read_protocol
from pipeline.protocol.command import main
from pipeline.protocol.pages import documents, outdated, render, rendered
from pipeline.store.errors import ConfigurationError
from pipeline.store.provenance import PROJECT_ROOT
from tests.pipeline.protocol.test_evaluate import SCENES

RESULTS = PROJECT_ROOT / "results"
KEPT = sorted(RESULTS.glob("*.json"))


def test_tables_of_the_documents_are_those_of_the_results() -> None:
    for path in documents():
        text = path.read_text(encoding="utf-8")
        assert rendered(text, RESULTS) == text, f"{path}: run endonav evaluate --pages"


@pytest.mark.parametrize("path", KEPT, ids=[path.stem for path in KEPT])
def test_results_are_of_the_present_policies_data_and_protocol(path: Path) -> None:
    assert not outdated(json.loads(path.read_text(encoding="utf-8")), read_protocol())


def test_targets_and_variations_have_tables_of_their_own(tmp_path: Path) -> None:
    figure = {"mean": 50.0, "low": 10.0, "high": 90.0}
    summary = {"cases": 4, "anatomies": 2, "success_pct": figure, "straight_pct": figure, "force_max_n": 1.5}
    summary |= {"success_bca_pct": figure, "success_still_pct": figure, "success_moving_pct": figure | {"mean": 25.0}}
    declared = {"title": "Steer", "limits": "Drawn.", "targets": ["bca"], "variations": {"still": {}, "moving": {}}}
    made = {"seeds": 3, "protocol": 3, "made_by": {"commit": "abc"}, "claim": "steer"}
    (tmp_path / "steer.json").write_text(json.dumps(made | {"summary": summary, "declared": declared}))
    text = "<!-- navigation: steer -->\n<!-- end of results -->\n<!-- variations: steer -->\n<!-- end of results -->\n"
    text = rendered(text, tmp_path)
    assert "| Steer | 4; 2 | **50 (10 to 90)** | bca 50 | 50 | - | -; 1.5 |" in text
    assert "| moving | 25 (10 to 90) |" in text
    assert text.count("`endonav evaluate steer --seeds 3`, commit `abc`, version 3 of the protocol.") == 2
    assert "- Steer: Drawn." in text


@pytest.mark.parametrize("path", sorted((RESULTS / "board").glob("*.json")), ids=lambda path: path.stem)
def test_the_board_says_what_its_rows_do(path: Path) -> None:
    row = json.loads(path.read_text(encoding="utf-8"))
    reached = f"{sum(case['success'] for case in row['cases'])} of {len(row['cases'])}"
    page = (PROJECT_ROOT / "docs" / "results" / "board.md").read_text(encoding="utf-8")
    assert reached in page
    assert f"results/board/{path.name}" in page
    assert not row["made_by"]["changes"]


def test_a_table_is_made_from_results_and_a_change_of_them_is_seen(tmp_path: Path) -> None:
    protocol, results = tmp_path / "protocol.yaml", tmp_path / "results"
    protocol.write_text(SCENES)
    assert main(["wires", "--protocol", str(protocol), "--to", str(results), "--workers", "1"]) == 0
    (tmp_path / "docs").mkdir()
    page = tmp_path / "docs" / "wires.md"
    page.write_text("# Wires\n\n<!-- results: wires -->\nold\n<!-- end of results -->\n\nmore\n")
    (tmp_path / "README.md").write_text("<!-- results: wires wires -->\n<!-- end of results -->\n")
    assert len(render(results, tmp_path)) == 2
    assert not render(results, tmp_path)
    result = json.loads((results / "wires.json").read_text())
    text = page.read_text()
    mean = result["summary"]["mean_mm_mean"]
    assert f"| distance along the wire, mm | {mean['mean']:.3g} | {mean['low']:.3g} to {mean['high']:.3g} |" in text
    assert "Wires: 6 cases in 6 anatomies or scenes." in text
    assert "`endonav evaluate wires`, commit `" in text
    assert text.endswith("\n\nmore\n")
    assert f"| Wires | {mean['mean']:.3g} mm (" in (tmp_path / "README.md").read_text()
    mean["mean"] += 1
    (results / "wires.json").write_text(json.dumps(result))
    assert rendered(text, results) != text
    assert not outdated(result, read_protocol(protocol))
    protocol.write_text(SCENES.replace("count: 6", "count: 7"))
    assert "entry" in outdated(result, read_protocol(protocol))
    for damaged in (json.dumps(result)[:90], "[]", "{}"):
        (results / "wires.json").write_text(damaged)
        with pytest.raises(
            ConfigurationError, match=r"wires\.json is damaged: remove it, and `endonav evaluate wires`"
        ):
            rendered(text, results)
    result["made_by"]["inputs"] = {"a policy": "of other weights"}
    protocol.write_text(SCENES)
    assert "policies" in outdated(result, read_protocol(protocol))
    (results / "wires.json").unlink()
    with pytest.raises(ConfigurationError, match="endonav evaluate wires"):
        rendered(text, results)
