"""Seeds of the fuzz that found something, and a few of every target: the tool works, and what it found stays mended."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.fuzz.__main__ import main, targets

FOUND = json.loads(Path(__file__).with_name("reproductions.json").read_text(encoding="utf-8"))
FEW = 4
SLOW = ("meshes", "settings")  # seconds a seed


@pytest.mark.parametrize("name", sorted(FOUND))
def test_what_was_found_stays_mended(name: str, tmp_path: Path) -> None:
    target = targets()[name](tmp_path)
    seeds = [*FOUND[name], *(range(FEW) if name not in SLOW else ())]
    for seed in seeds:
        target.run(seed)
    if seeds:
        assert sum(target.counts.values()) >= len(seeds)


def test_the_summary_counts_and_a_failure_says_how_to_repeat_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "fuzz.json"
    assert main(["--seconds", "5", "--only", "checkpoints", "--output", str(output)]) == 0
    summary = json.loads(output.read_text())
    tally = summary["targets"]["checkpoints"]
    assert summary["cases"] == tally["cases"] == tally["refused"] + tally["equal"] > 10
    assert tally["failures"] == []
    with pytest.raises(SystemExit):
        main(["--only", "nothing"])
    assert "choose from logs, models" in capsys.readouterr().err


def test_what_fails_hangs_or_dies_is_found(tmp_path: Path) -> None:
    from tests.fuzz.broken_target import BrokenTarget
    from tests.fuzz.runner import run_target

    tally = run_target(BrokenTarget, 0, seconds=30, seeds=[0, 1, 2, 3, 4])
    problems = [(failure["seed"], failure["problem"]) for failure in tally.failures]
    assert [seed for seed, _ in problems] == [1, 2, 3, 4]
    assert problems[0][1].startswith("KeyError")
    assert problems[1][1] == "its process died"
    assert problems[2][1].startswith("over 3 s")
    assert problems[3][1].startswith("WrongError: a refusal is no sentence")
    assert tally.failures[0]["reproduce"] == "python -m tests.fuzz --only broken --case 1"
    assert tally.seeds == 5
