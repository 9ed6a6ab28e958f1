"""The table of the check of the thesis's sizes: finished, failed and missing stages; the experiment's settings."""

from __future__ import annotations

import json
import time
from pathlib import Path

import pytest

from pipeline import thesis_check
from pipeline.stages import available_stages
from pipeline.store.costs import OWN_PROCESS, CostMeter, keep_cost
from pipeline.store.run_folder import Identity, RunFolder
from tests.pipeline.test_task import stages_of


def finish(run: Path, stage: str, *jobs: str) -> None:
    folder = RunFolder(run / stage, Identity("c", {}, 1))
    with folder.locked():
        folder.prepare()
        for key in (*jobs, OWN_PROCESS):
            keep_cost(folder.path, key, CostMeter().read())
        folder.finish(stage=stage, run="r", budget="thesis", seed=0, config={}, started=time.monotonic())


def test_table_has_every_stage_and_job(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    run = tmp_path / "thesis-check"
    given = []
    monkeypatch.setattr(thesis_check, "run_chain", lambda words: given.append(words) or 0)
    assert thesis_check.main([f"runs_dir={tmp_path}"]) == 0  # nothing was run
    assert given == [["all", "--", "budget=thesis", "experiment=thesis-check", f"runs_dir={tmp_path}"]]
    finish(run, "phantoms")
    finish(run, "enn", "b", "a")
    keep_cost(run / "force", "V/16", CostMeter().read("the expert is gone: run stage=enn"))
    assert thesis_check.main([f"runs_dir={tmp_path}", "stage.device=cuda"]) == 1
    text = (run / "thesis_check.md").read_text()
    assert text in capsys.readouterr().out
    assert f"`python -m pipeline.thesis_check runs_dir={tmp_path} stage.device=cuda`, commit " in text
    told = json.loads((run / "thesis_check.json").read_text())
    found = [(row["stage"], row["job"], row["result"]) for row in told["rows"]]
    assert [stage for stage, job, _ in found if not job] == list(available_stages())
    assert found[:2] == [("phantoms", "", "ok"), ("expert", "", "did not finish")]
    assert [one for one in found if one[0] == "enn"] == [("enn", "", "ok"), ("enn", "a", "ok"), ("enn", "b", "ok")]
    assert ("force", "V/16", "the expert is gone: run stage=enn") in found
    assert told["machine"]["cores"] >= 1


def test_the_experiment_changes_counts_alone() -> None:
    """Networks, algorithms, images, wires and actions are those of the budget."""
    real, check = stages_of("budget=thesis"), stages_of("budget=thesis", "experiment=thesis-check")
    for stage, keys in {
        "baselines": ("variant", "algorithms", "observations", "reward", "path_follower", "device"),
        "enn": ("variant", "expert", "modalities", "reward"),
        "imitation": ("variant", "observations", "feature_matching"),
        "force": ("variant", "inputs"),
        "unseen": ("image", "hidden"),
        "guide3d": ("image_size_px", "distorted", "filling"),
        "shape": ("rows", "size", "device"),
        "segmentation": ("rows", "size"),
        "splineformer": ("variants", "size", "rival"),
        "navigation": ("splineformer", "cameras", "image_size_px", "hidden", "arch_hidden", "guided", "space",
                       "action_repeat", "pixel_cloning", "film"),
    }.items():  # fmt: skip
        for key in keys:
            assert getattr(check[stage], key) == getattr(real[stage], key), (stage, key)
    assert {check[stage].task.max_steps for stage in ("expert", "baselines", "enn", "unseen", "navigation")} == {6}
    for stage in ("expert", "baselines", "enn", "imitation", "force", "unseen", "navigation"):
        for part in ("wire", "wire_length_mm", "actions", "image_size_px", "success_radius_mm", "start_rotation_deg"):
            assert getattr(check[stage].task, part) == getattr(real[stage].task, part), (stage, part)
