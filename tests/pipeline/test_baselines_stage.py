"""The baselines stage: the cells of the thesis's table, the path follower, and one tiny run."""

from __future__ import annotations

import json

import pytest

from pipeline.config import BaselinesSettings
from pipeline.errors import ConfigurationError, StageError
from pipeline.job_worker import Report
from pipeline.learning_task import LearningTask
from pipeline.path_job import PathJob, follow
from pipeline.stages.baselines import plan
from pipeline.trials import Origin
from tests.pipeline.test_enn_stage import expert_run  # noqa: F401 - a fixture


def settings(**changed) -> BaselinesSettings:
    return BaselinesSettings(**{"phantoms": ["type_1", "type_2"], "targets": ["bca", "lcca"], **changed})


def test_plan_is_the_table_of_the_thesis() -> None:
    cells = plan(settings(), run_seed=0)
    assert len({cell.name for cell in cells}) == 24
    assert {cell.row for cell in cells} == {
        f"{a}_{o}" for a in ("ppo", "sac") for o in ("internal", "image", "sequential")
    }
    budgets = {(cell.settings.algorithm, cell.settings.decisions) for cell in cells}
    assert budgets == {("ppo", 60_000), ("sac", 6_000)}
    assert all(cell.encoded for cell in cells)


def test_thesis_has_its_own_networks_and_actions() -> None:
    thesis = settings(variant="thesis", actions="tip_motors", decisions=600_000, ppo_decisions=600_000)
    cells = {cell.row: cell for cell in plan(thesis, run_seed=0)}
    internal, image = cells["sac_internal"].settings, cells["ppo_sequential"].settings
    assert (internal.variant, internal.hidden, internal.activation) == ("baselines", (64, 64), "tanh")
    assert (image.variant, image.hidden, image.keys) == ("baselines", (), ("sequential",))
    assert image.learning_rate == internal.learning_rate == 3e-4
    assert internal.target_entropy is None
    assert cells["sac_internal"].task.environment("internal").action_space.shape == (21,)
    assert not cells["sac_internal"].encoded


def test_unknown_observations_are_one_sentence() -> None:
    with pytest.raises(
        ConfigurationError, match=r"stage\.observations has no 'sound': choose from internal, image, seq"
    ):
        settings(observations=["sound"])
    with pytest.raises(ConfigurationError, match=r"stage\.algorithms has no 'dqn': choose from ppo, sac"):
        settings(algorithms=["dqn"])


def test_a_path_follower_without_episodes_says_what_to_do(tmp_path) -> None:
    job = PathJob(tmp_path, LearningTask("type_1", "bca"), 0, Origin("baselines", "path_follower", 0, "desk"), (), 1)
    with pytest.raises(StageError, match="the path follower of type_1/bca has no expert episodes: run stage expert"):
        follow(job, Report())


def test_a_tiny_run_fills_the_table(pipeline_process, expert_run) -> None:  # noqa: F811
    done = pipeline_process.run(
        "stage=baselines", "budget=smoke", "name=run", "stage.observations=[image]", "stage.decisions=48",
        "stage.ppo_decisions=256", "stage.encoder_samples=150", "stage.max_steps=30",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr + done.stdout
    folder = expert_run / "baselines"
    results = json.loads((folder / "results.json").read_text())
    assert set(results["cathsim_results"]) == {"type_1/ppo_image", "type_1/sac_image", "type_1/path_follower"}
    for row in results["cathsim_results"].values():
        assert row["reward_bca"][0] < 0  # the thesis's reward, not the training's
        assert row["success_bca_pct"] in (0, 100)
    assert (folder / "type_1/bca/path_follower/seed0/follower.pt").is_file()
    assert not list(folder.rglob("tensorboard"))
