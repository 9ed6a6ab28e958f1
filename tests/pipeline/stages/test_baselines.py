"""The baselines stage: the cells of the thesis's table, the path follower, and one tiny run."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import torch

from pipeline.evaluations.tables import tables_from_logs
from pipeline.jobs.worker import Report
from pipeline.recording.trials import Origin
from pipeline.stages.baselines import PathJob, follow, plan, training_settings
from pipeline.stages.learning.aids import of_training
from pipeline.stages.learning.expert_episodes import read_episode, readable
from pipeline.stages.learning.settings import BaselinesSettings
from pipeline.stages.learning.task import LearningTask
from pipeline.store.errors import ConfigurationError, StageError
from pipeline.task import Task
from tests.enn.event_scalars import scalars
from tests.pipeline.composed import composed
from tests.pipeline.stages.small_expert import context
from tests.pipeline.stages.test_enn import expert_run  # noqa: F401 - a fixture


def settings(**changed) -> BaselinesSettings:
    return BaselinesSettings(**{"phantoms": ["type_1", "type_2"], "targets": ["bca", "lcca"], **changed})


def test_plan_is_the_table_of_the_thesis(tmp_path: Path) -> None:
    jobs = plan(settings(), context(tmp_path, "baselines", ("expert",)))
    assert len({job.name for job in jobs}) == 24
    assert {job.origin.row for job in jobs} == {
        f"{a}_{o}" for a in ("ppo", "sac") for o in ("internal", "image", "sequential")
    }
    budgets = {(job.settings.algorithm, job.settings.decisions) for job in jobs}
    assert budgets == {("ppo", 20_000), ("sac", 4_000)}
    assert {job.encoder.name for job in jobs} == {"internal.pt", "image.pt", "sequential.pt"}


def test_the_physics_of_training_is_ppos_own(tmp_path: Path) -> None:
    jobs = plan(settings(accuracy="fast", ppo_accuracy="reference"), context(tmp_path, "baselines", ("expert",)))
    physics = {(job.settings.algorithm, job.task.accuracy) for job in jobs}
    assert physics == {("ppo", "reference"), ("sac", "fast")}


def test_thesis_has_its_own_networks_and_actions(tmp_path: Path) -> None:
    thesis = settings(variant="thesis", task=Task(actions="tip_motors"), decisions=600_000, ppo_decisions=600_000)
    jobs = {job.origin.row: job for job in plan(thesis, context(tmp_path, "baselines", ("expert",)))}
    internal, image = jobs["sac_internal"].settings, jobs["ppo_sequential"].settings
    assert (internal.variant, internal.hidden, internal.activation) == ("baselines", (64, 64), "tanh")
    assert (image.variant, image.hidden, image.keys) == ("baselines", (), ("sequential",))
    assert image.learning_rate == internal.learning_rate == 3e-4
    assert internal.target_entropy is None
    assert jobs["sac_internal"].task.environment("internal").action_space.shape == (21,)
    assert jobs["sac_internal"].encoder is None


@pytest.mark.parametrize(("words", "actions"), [((), 21), (("stage.task.actions=feeder",), 2)])
def test_baselines_as_written_have_no_aids(words: tuple[str, ...], actions: int, tmp_path: Path) -> None:
    stage = composed("stage=baselines", "budget=thesis", "experiment=as_written", *words).stage
    jobs = plan(stage, context(tmp_path, "baselines", ("expert",)))
    assert len({job.name for job in jobs}) == 2 * 2 * 2 * 3  # algorithms, arches, targets, seeds
    for job in jobs:
        assert of_training(job) == [f"{actions} actions", "600,000 decisions"]
        assert (job.keys, job.task.reward, job.task.path_penalty) == (("internal",), "distance", 0.0)
        assert (job.task.task.entry, job.task.task.max_steps, job.settings.stop_after) == ("ascending", 2000, 0)
        assert not job.demonstrations


@pytest.mark.parametrize("observation", ["internal", "image", "sequential"])
@pytest.mark.parametrize("algorithm", ["ppo", "sac"])
def test_thesis_networks_are_those_of_the_chapter(algorithm: str, observation: str) -> None:
    from enn.networks.network import build_network

    thesis = settings(variant="thesis", decisions=600_000, ppo_decisions=600_000)
    box = gymnasium.spaces.Box
    spaces = {
        "internal": box(-np.inf, np.inf, (30,), np.float32),
        "image": box(0, 255, (1, 64, 64), np.uint8),
        "sequential": box(0, 255, (3, 64, 64), np.uint8),
    }
    space = gymnasium.spaces.Dict({observation: spaces[observation]})
    network = build_network(
        training_settings(thesis, algorithm, observation).network, space, box(-1, 1, (21,), np.float32)
    )
    actor = network.actor if algorithm == "sac" else network
    head = actor.mu if algorithm == "sac" else actor.action_net
    assert (head.in_features, head.out_features) == (64 if observation == "internal" else 512, 21)
    hidden = actor.latent_pi if algorithm == "sac" else actor.mlp_extractor.policy_net
    sizes = [layer.out_features for layer in hidden if isinstance(layer, torch.nn.Linear)]
    assert sizes == ([64, 64] if observation == "internal" else [])
    assert any(isinstance(layer, torch.nn.Tanh) for layer in hidden) == (observation == "internal")
    convolutions = [layer for layer in actor.modules() if isinstance(layer, torch.nn.Conv2d)]
    assert bool(convolutions) == (observation != "internal")


def test_unknown_observations_are_one_sentence() -> None:
    with pytest.raises(
        ConfigurationError, match=r"stage\.observations has no 'sound': choose from internal, image, seq"
    ):
        settings(observations=["sound"])
    with pytest.raises(ConfigurationError, match=r"stage\.algorithms has no 'dqn': choose from ppo, sac"):
        settings(algorithms=["dqn"])


def path_job(folder: Path, logs: tuple[Path, ...]) -> PathJob:
    return PathJob(folder, Origin("baselines", "path_follower", 0, "desk"), LearningTask("type_1", "bca"), logs, 1)


def test_a_path_follower_without_episodes_says_what_to_do(tmp_path) -> None:
    with pytest.raises(StageError, match="the path follower of type_1/bca has no expert episodes: run stage expert"):
        follow(path_job(tmp_path, ()), Report())


def test_a_path_follower_leaves_damaged_logs_out_by_name(expert_run, tmp_path, caplog) -> None:  # noqa: F811
    intact = min((expert_run / "expert/type_1/bca").glob("*.mcap"))
    broken = tmp_path / "001.mcap"
    broken.write_bytes(intact.read_bytes()[:2000])
    read = partial(read_episode, pictures=False)
    assert [episode.label for episode in readable([broken, intact], read)] == [str(intact)]
    assert "001.mcap is left out" in caplog.text
    with pytest.raises(StageError, match="has no expert episodes: run stage expert"):
        follow(path_job(tmp_path, (broken,)), Report())


def test_a_tiny_run_fills_the_table(pipeline_process, expert_run) -> None:  # noqa: F811
    done = pipeline_process.run_here(
        "stage=baselines", "budget=smoke", "name=run", "stage.observations=[image]", "stage.decisions=48",
        "stage.ppo_decisions=256", "stage.encoder_samples=150", "stage.task.max_steps=30",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr + done.stdout
    folder = expert_run / "baselines"
    table = tables_from_logs(folder)["cathsim_results"]
    assert set(table) == {"type_1/ppo_image", "type_1/sac_image", "type_1/path_follower"}
    for row in table.values():
        assert row["reward_bca"][0] < 0  # the thesis's reward, not the training's
        assert row["success_bca_pct"] in (0, 100)
    assert (folder / "type_1/bca/path_follower/seed0/follower.pt").is_file()
    for row, name in (("sac_image", "curve/reward"), ("ppo_image", "curve/reward"), ("path_follower", "train/loss")):
        assert scalars(folder / "type_1/bca" / row / "seed0")[name]
