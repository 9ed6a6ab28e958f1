"""The check of the thesis's sizes: its table, the settings of all stages, and a run of those that train policies."""

import json
import time
from dataclasses import replace
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from pipeline import thesis_check
from pipeline.chain import concerns
from pipeline.config import CONFIG_DIRECTORY
from pipeline.stages import available_stages
from pipeline.store.costs import OWN_PROCESS, CostMeter, keep_cost
from pipeline.store.run_folder import Identity, RunFolder
from tests.conftest import PipelineProcess
from tests.pipeline.composed import Stages

pytestmark = pytest.mark.slow

# The stages that are run, without the rows that have the network of another one; others are composed alone.
RUN = ("phantoms", "expert", "baselines", "enn")
FEWER_ROWS = (
    "stage@phantoms.phantoms=[type_1]", "stage@phantoms.picture=false", "stage@expert.film=false",
    "stage@baselines.observations=[sequential]", "stage@enn.modalities=[]",
)  # fmt: skip


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
    changed = OmegaConf.load(CONFIG_DIRECTORY / "sizes" / "thesis-check.yaml")
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
        assert not {"task", *keys} & set(changed[stage]), stage
    real, check = Stages("budget=thesis"), Stages("budget=thesis", "experiment=thesis-check")
    for stage in ("enn", "baselines"):
        assert check[stage].decisions == 3
        assert check[stage].task == replace(real[stage].task, max_steps=6)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run of the check, in this process: every start of a stage would import what the last one did."""
    process = PipelineProcess(tmp_path_factory.mktemp("check"))

    def chain(words: list[str]) -> int:
        for stage in RUN:
            own = [word.replace(f"stage@{stage}.", "stage.", 1) for word in words[2:-1] if concerns(word, stage)]
            done = process.run_here(f"stage={stage}", *own)  # which says where, as the last word does
            assert done.returncode == 0, f"{done.stdout[-2000:]}{done.stderr}"
        return 0

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(thesis_check, "run_chain", chain)
        assert thesis_check.main([*FEWER_ROWS, f"runs_dir={process.runs}"]) == 1  # some were left out
    return process.runs / "thesis-check"


def test_every_job_succeeds_and_tells_what_it_took(run: Path) -> None:
    told = json.loads((run / "thesis_check.json").read_text())
    rows = [row for row in told["rows"] if row["stage"] in RUN]
    assert {row["result"] for row in rows} == {"ok"}
    jobs = {f"{row['stage']}/{row['job']}" for row in rows}
    assert jobs >= {
        *(f"baselines/type_1/bca/{name}/seed0" for name in ("ppo_sequential", "sac_sequential", "path_follower")),
        *(f"enn/type_1/bca/{sees}/seed0" for sees in ("I+V+M", "I+V+M safe 5")),
    }
    assert all(row["seconds"] > 0 and row["peak memory, MB"] > 10 for row in rows)
    assert told["command"].startswith("python -m pipeline.thesis_check")
    assert {"torch", "numpy"} <= set(told["versions"])


def test_policies_have_the_wire_images_and_actions_of_the_thesis(run: Path) -> None:
    from enn.policy import Policy
    from pipeline.task import TASK, Task, task_from

    def policy(path: str) -> Policy:
        return Policy.load(run / path / "policy.pt")

    expert = policy("enn/type_1/bca/I+V+M/seed0")
    shapes = {key: expert.observation_space[key].shape for key in expert.keys}  # type: ignore[index]
    assert shapes == {"joints": (336,), "image": (1, 80, 80), "mask": (1, 80, 80)}
    assert expert.action_space.shape == (2,)
    assert task_from(expert.metadata[TASK]) == Task(wire="thesis", start_rotation_deg=0.0, max_steps=6)
    for algorithm in ("ppo", "sac"):
        baseline = policy(f"baselines/type_1/bca/{algorithm}_sequential/seed0")
        assert baseline.observation_space["sequential"].shape == (3, 128, 128)  # type: ignore[index]
        assert baseline.action_space.shape == (21,)
        assert baseline.network.algorithm == algorithm
