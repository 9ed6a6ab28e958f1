"""The command `endonav evaluate`: claims are checked, cases are kept and not mixed; and tables in documents."""

import contextlib
import hashlib
import itertools
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from multiprocessing import get_context
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pipeline import launch
from pipeline.data.sources import Source, SourceFile, Sources
from pipeline.protocol import navigation, rehearsal, run
from pipeline.protocol.claims import Protocol, Rehearsal, declared, read_protocol
from pipeline.protocol.command import main
from pipeline.protocol.pages import documents, render, rendered
from pipeline.protocol.run import KINDS, inputs, play, result_text, summary
from pipeline.store.errors import ConfigurationError
from pipeline.store.provenance import PROJECT_ROOT, hash_value

NO_VESSEL = hashlib.sha256(b"solid no vessel").hexdigest()
SCENES = """
version: 3
claims:
  wires:
    kind: reconstruction
    title: Wires
    limits: drawn
    first: 690000
    count: 3
    noise_px: 1.0
"""


@pytest.fixture
def protocol(tmp_path: Path) -> Path:
    path = tmp_path / "protocol.yaml"
    path.write_text(SCENES)
    return path


@pytest.fixture(scope="module", autouse=True)
def _forked_processes() -> Iterator[None]:
    """Cases are played where jobs are, which have most imports behind them; those that Ctrl-C ends, in a new Python."""
    context = get_context("forkserver")
    context.set_forkserver_preload([run.__name__])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "get_context", lambda _: context)
        yield


@pytest.fixture(scope="module")
def _played_once(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("played")
    (folder / "protocol.yaml").write_text(SCENES)
    assert _evaluate(folder / "protocol.yaml") == 0
    return folder


@pytest.fixture
def played(_played_once: Path, tmp_path: Path) -> Path:
    """A protocol whose results lie beside it."""
    return shutil.copytree(_played_once, tmp_path, dirs_exist_ok=True) / "protocol.yaml"


def _evaluate(protocol: Path, *words: str) -> int:
    return main(["--protocol", str(protocol), "--to", str(protocol.parent / "results"), "--workers", "1", *words])


def test_the_projects_protocol_names_shipped_policies_and_seeds_of_their_own() -> None:
    import enn

    claims = read_protocol().claims
    assert all(name in enn.models() for claim in claims.values() for name in getattr(claim, "policies", ()))
    ranges = sorted((claim.first, claim.count) for claim in claims.values() if hasattr(claim, "first"))
    assert all(a + count <= b for (a, count), (b, _) in itertools.pairwise(ranges))
    assert all(count <= 1000 for _, count in ranges), "the next seed's anatomies begin 1000 later"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("count: 3", "count: 0", "count: .*greater than 0"),
        ("reconstruction\n", "navigation\n    policies: [generalist]\n", "one of arches, phantoms and sources|noise"),
        ("noise_px: 1.0", "noise: 1.0", "noise"),
        ("first: 690000", "first: 7", "first: .*600000 and a multiple of 1000"),
        ("reconstruction", "reading", "reading"),
        ("version: 3", "", "version"),
        ("claims:", "claims: [", "no protocol"),
    ],
)
def test_an_entry_that_is_not_understood_is_refused(protocol: Path, old: str, new: str, message: str) -> None:
    protocol.write_text(SCENES.replace(old, new, 1))
    with pytest.raises(ConfigurationError, match=message):
        read_protocol(protocol)


def test_wrong_words_end_in_a_sentence(protocol: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert _evaluate(protocol, "curves") == 2
    assert "no claim 'curves': choose from wires" in capsys.readouterr().err
    assert _evaluate(protocol, "wires", "--seeds", "0") == 2
    assert main(["--protocol", str(protocol.parent / "none.yaml")]) == 2
    capsys.readouterr()
    assert _evaluate(protocol, "wires", "--to", str(protocol)) == 2
    assert "a file lies where a folder is needed" in capsys.readouterr().err
    for words in (["--board", "arch_variety"], ["--episodes", "3"], ["--row", "row.json"]):  # all claims take hours
        assert _evaluate(protocol, *words) == 2
        assert "--policy" in capsys.readouterr().err


def test_reasons_keep_names_of_files_and_no_folders(monkeypatch: pytest.MonkeyPatch) -> None:
    reason = "no branch; see the picture /home/me/.cache/a/b-1.png, m/s, of /data/x.stl: 4.5 N/mm"
    monkeypatch.setitem(KINDS, "forces", SimpleNamespace(play=lambda *given: {"success": False, "reason": reason}))
    claim = SimpleNamespace(kind="forces")
    assert play(claim, {})["reason"] == "no branch; see the picture b-1.png, m/s, of x.stl: 4.5 N/mm"


def test_a_result_is_written_a_case_a_line() -> None:
    result = {"claim": "a", "cases": [{"seed": 1, "success": True}, {"seed": 2, "success": False}], "summary": {"n": 2}}
    text = result_text(result)
    assert json.loads(text) == result
    assert [json.loads(line.rstrip(",")) for line in text.splitlines()[-3:-1]] == result["cases"]
    with pytest.raises(ValueError, match="JSON compliant"):
        result_text({"cases": [{"force": float("nan")}]})


def test_every_case_is_written_and_none_is_played_twice_unless_the_claim_changes(played: Path) -> None:
    results, journal = (played.parent / "results" / name for name in ("wires.json", "wires.jsonl"))
    first = json.loads(results.read_text())
    assert (first["protocol"], first["claim"], len(first["cases"])) == (3, "wires", 3)
    assert {"commit", "changes", "inputs", "claim"} == set(first["made_by"])
    assert all(case["success"] and case["mean_mm"] < 5 for case in first["cases"])
    lines = journal.read_text().splitlines()
    journal.write_text("\n".join(lines[:3]) + '\n{"case": {"a": {}}\n{"case": {"anat')  # killed within lines
    assert _evaluate(played) == 0
    again = journal.read_text().splitlines()
    assert (again[:3], len(again)) == (lines[:3], 4)
    assert first["summary"]["cpu_min"] >= 0
    first_cases = [case | {"played_cpu_s": 0} for case in first["cases"]]
    assert [case | {"played_cpu_s": 0} for case in json.loads(results.read_text())["cases"]] == first_cases
    assert _evaluate(played, "--seeds", "2") == 0
    second = json.loads(results.read_text())
    assert [case | {"played_cpu_s": 0} for case in second["cases"][:3]] == first_cases
    assert second["summary"]["anatomies"] == 6
    played.write_text(SCENES.replace("noise_px: 1.0", "noise_px: 0.0"))
    assert _evaluate(played) == 0
    (old,) = journal.parent.glob("wires.old-*.jsonl")
    assert len(old.read_text().splitlines()) == 7
    assert json.loads(results.read_text())["summary"]["mean_mm_mean"]["mean"] < first["summary"]["mean_mm_mean"]["mean"]


def test_ctrl_c_ends_it_at_once_and_other_libraries_begin_anew(protocol: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    protocol.write_text(SCENES.replace("count: 3", "count: 900"))
    journal = protocol.parent / "results" / "wires.jsonl"
    words = ["--protocol", str(protocol), "--to", str(journal.parent), "--workers", "1"]
    command = [sys.executable, "-c", f"from pipeline.protocol.command import main; main({words!r})"]
    with subprocess.Popen(
        command, stderr=subprocess.PIPE, text=True, start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),  # background jobs ignore it
    ) as process:  # fmt: skip
        deadline = time.monotonic() + 120
        while not journal.is_file() or len(journal.read_text().splitlines()) < 3:
            assert time.monotonic() < deadline
            time.sleep(0.05)
        os.killpg(process.pid, signal.SIGINT)
        _, said = process.communicate(timeout=30)
    assert "stopped; the cases that were played are kept" in said
    kept = journal.read_text().splitlines()[1:]
    assert 2 <= len(kept) < 800
    protocol.write_text(SCENES.replace("count: 3", "count: 1"))
    for versions, aside in ({"mujoco": "98"}, 1), ({"mujoco": "99"}, 2), ({"mujoco": "99"}, 2):
        monkeypatch.setattr(run, "software_versions", lambda versions=versions: versions)
        assert _evaluate(protocol) == 0
        assert len(list(journal.parent.glob("wires.old-*.jsonl"))) == aside


def test_a_damaged_journal_and_an_unknown_policy_are_told(protocol: Path, capsys: pytest.CaptureFixture[str]) -> None:
    protocol.write_text(SCENES.replace("count: 3", "count: 1"))
    journal = protocol.parent / "results" / "wires.jsonl"
    journal.parent.mkdir()
    journal.write_text('{"commit": "ab')
    assert _evaluate(protocol) == 0
    assert "wires: 1 of 1 cases" in capsys.readouterr().err
    (old,) = journal.parent.glob("wires.old-*.jsonl")
    assert old.read_text() == '{"commit": "ab'
    steer(protocol, "arches: random, count: 1", "nobody")
    assert _evaluate(protocol) == 2
    assert "there is no model 'nobody'" in capsys.readouterr().err


def test_cases_of_one_anatomy_belong_together() -> None:
    apart = summary([{"anatomy": f"arch_{k}", "success": k % 2 == 0} for k in range(40)])["success_pct"]
    together = summary([{"anatomy": f"arch_{k // 10}", "success": k < 20} for k in range(40)])["success_pct"]
    assert together["high"] - together["low"] > 2 * (apart["high"] - apart["low"])
    whole = summary([{"anatomy": f"arch_{k}", "success": True} for k in range(40)])["success_pct"]
    assert whole["mean"] == whole["high"] == 100
    assert 90 < whole["low"] < 93
    alike = summary([{"anatomy": f"arch_{k // 20}", "success": True} for k in range(40)])["success_pct"]
    assert alike["low"] < 40  # of two anatomies, not of forty


def test_data_that_are_not_here_and_files_that_are_refused_are_said(
    protocol: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    sources = Sources("", {"box": _source("box.stl"), "tube": _source("tube.stl")}, tmp_path)
    monkeypatch.setattr("pipeline.protocol.navigation.read_sources", lambda: sources)
    steer(protocol, "sources: open, count: 2", "generalist")
    claim = read_protocol(protocol).claims["steer"]
    assert _evaluate(protocol) == 2
    said = capsys.readouterr().err
    assert "measuring all claims" in said
    assert "data are missing: `endonav data fetch box tube`" in said
    for name in sources.entries:
        sources.anatomy(name).parent.mkdir()
        sources.anatomy(name).write_bytes(b"solid no vessel")
    cases = list(navigation.cases(claim, 0))
    assert [case["anatomy"] for case in cases] == ["box", "box", "tube", "tube"]
    assert len({case["seed"] for case in cases}) == 4
    outcome = navigation.play(claim, cases[0])
    assert not outcome["success"]
    assert "box.stl" in outcome["reason"] or "triangle" in outcome["reason"]
    assert summary([case | outcome for case in cases])["success_pct"]["mean"] == 0
    assert navigation.files(claim) == dict.fromkeys(("box/box.stl", "tube/tube.stl"), NO_VESSEL)


def test_data_that_a_later_claim_lacks_are_told_before_the_first_is_played(
    protocol: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    protocol.write_text(f"{SCENES}  pairs: {{kind: real_xray, title: T, limits: L, sizes: [1]}}\n")
    assert _evaluate(protocol) == 2
    assert "stereo_pairs.json is missing: it is not public" in capsys.readouterr().err
    assert not (protocol.parent / "results").exists()


def steer(protocol: Path, where: str, *policies: str) -> None:
    """Makes a protocol one of policies that navigate."""
    claim = f"kind: navigation, title: T, limits: L, first: 690000, targets: [bca], {where}"
    protocol.write_text(f"version: 1\nclaims: {{steer: {{{claim}, policies: [{', '.join(policies)}]}}}}")


def _source(name: str) -> Source:
    file = SourceFile(name, 15, NO_VESSEL)
    return Source(use="open", vessels="arch", repository="a/b", commit="ab", licence="MIT", files=(file,))


FORCES = "forces, first: 690000, count: 1, accuracy: accurate, noise_mm: 0.5, members: 4, pieces: 2"
SPEED = "speed, phantoms: [type_1], steps: 60"


@pytest.mark.parametrize(
    ("entry", "figure", "low", "high"),
    [(FORCES, "resultant_error_pct_median", 0, 60), (SPEED, "steps_per_s_mean", 1, 5000)],
)
def test_other_kinds_are_measured(protocol: Path, entry: str, figure: str, low: float, high: float) -> None:
    protocol.write_text(f"version: 1\nclaims: {{one: {{title: T, limits: L, kind: {entry}}}}}")
    assert _evaluate(protocol) == 0
    result = json.loads((protocol.parent / "results" / "one.json").read_text())
    assert low < result["summary"][figure]["mean"] < high


@pytest.mark.slow
def test_a_rehearsal_is_read_from_the_stages_tables(monkeypatch: pytest.MonkeyPatch) -> None:
    claim = Rehearsal(kind="rehearsal", title="T", limits="L", arches="random", first=690000, count=1, target="bca")
    (case,) = rehearsal.cases(claim, 0)
    small = ("stage.decisions=48", "stage.hidden=16", "stage.task.max_steps=20")
    words = ("stage.choose_catheter=false", "stage.demonstrations=0", *small)
    with pytest.raises(ValueError, match="seed"):
        rehearsal.play(claim, case | {"arch": -1}, budget="smoke")

    @contextlib.contextmanager
    def here(command: list[str], **_: Any) -> Iterator[SimpleNamespace]:
        assert launch.main(command[3:]) == 0
        yield SimpleNamespace(communicate=lambda: ("", ""))

    monkeypatch.setattr(rehearsal, "subprocess", SimpleNamespace(Popen=here, DEVNULL=None, PIPE=None))
    outcome = rehearsal.play(claim, case, *words, budget="smoke")
    assert outcome["success"] == (outcome["after_pct"] >= 90)
    assert outcome["decisions"] > 0
    assert outcome["played_cpu_s"] > outcome["cpu_s"] > 0  # tests, too, each in a process of its own


@pytest.mark.slow
def test_shipped_policies_steer_in_a_drawn_arch(protocol: Path) -> None:
    bad_day = "{shift_mm: 2, turn_deg: 3, stiffness: 1.5, friction: 0.5, breathing_mm: 3, wall_n_mm: 1}"
    where = f"arches: random, count: 1, variations: {{bad day: {bad_day}}}"
    steer(protocol, where, "generalist", "generalist_jb2")
    assert _evaluate(protocol) == 0
    (case,) = json.loads((protocol.parent / "results" / "steer.json").read_text())["cases"]
    assert case["success"]
    assert case["branch"] == "bca"
    assert case["depth_mm"] > 10
    assert case["policy"] in ("generalist", "generalist_jb2")
    assert 0 < case["force_p95_n"] <= case["force_max_n"]


RESULTS = PROJECT_ROOT / "results"
KEPT = sorted(RESULTS.glob("*.json"))


def test_tables_of_the_documents_are_those_of_the_results() -> None:
    for path in documents():
        text = path.read_text(encoding="utf-8")
        assert rendered(text, RESULTS) == text, f"{path}: run endonav evaluate --pages"


def outdated(result: dict, protocol: Protocol) -> str:
    """Why a result is older than what it depends on; "" if it is not."""
    claim = protocol.claims[result["claim"]]
    if result["made_by"]["claim"] != hash_value(declared(claim, words=False)):
        return "the protocol's entry is another one"
    return "" if result["made_by"]["inputs"] == inputs(claim) else "policies or data are others"


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
    assert text.count("`endonav evaluate steer --seeds 3`, commit `abc`") == 2


@pytest.mark.parametrize("path", sorted((RESULTS / "board").glob("*.json")), ids=lambda path: path.stem)
def test_the_board_says_what_its_rows_do(path: Path) -> None:
    row = json.loads(path.read_text(encoding="utf-8"))
    reached = f"{sum(case['success'] for case in row['cases'])} of {len(row['cases'])}"
    page = (PROJECT_ROOT / "docs" / "results" / "board.md").read_text(encoding="utf-8")
    share = row["summary"]["success_pct"]
    assert reached in page
    assert f"{share['low']:.0f} to {share['high']:.0f}" in page
    assert f"results/board/{path.name}" in page
    assert not row["made_by"]["changes"]


def test_a_table_is_made_from_results_and_a_change_of_them_is_seen(played: Path, tmp_path: Path) -> None:
    results = tmp_path / "results"
    (tmp_path / "docs").mkdir()
    page = tmp_path / "docs" / "wires.md"
    page.write_text("# Wires\n\n<!-- results: wires -->\nold\n<!-- end of results -->\n\nmore\n")
    (tmp_path / "README.md").write_text("<!-- results: wires wires -->\n<!-- end of results -->\n")
    assert len(render(results, tmp_path)) == 2
    assert not render(results, tmp_path)
    result = json.loads((results / "wires.json").read_text())
    text = page.read_text()
    mean = result["summary"]["mean_mm_mean"]
    assert (
        f"| mean distance at equal arc length, mm | {mean['mean']:.3g} | {mean['low']:.3g} to {mean['high']:.3g} |"
        in text
    )
    assert text.endswith("\n\nmore\n")
    assert f"| Wires | {mean['mean']:.3g} mm (" in (tmp_path / "README.md").read_text()
    mean["mean"] += 1
    (results / "wires.json").write_text(json.dumps(result))
    assert rendered(text, results) != text
    assert not outdated(result, read_protocol(played))
    played.write_text(SCENES.replace("count: 3", "count: 4"))
    assert "entry" in outdated(result, read_protocol(played))
    for damaged in (json.dumps(result)[:90], "[]", "{}"):
        (results / "wires.json").write_text(damaged)
        with pytest.raises(ConfigurationError, match=r"wires\.json is damaged"):
            rendered(text, results)
    result["made_by"]["inputs"] = {"a policy": "of other weights"}
    played.write_text(SCENES)
    assert "policies" in outdated(result, read_protocol(played))
    (results / "wires.json").unlink()
    with pytest.raises(ConfigurationError, match="endonav evaluate wires"):
        rendered(text, results)
