"""The stages enn and baselines: plans, keys of sweeps, networks, and a tiny run each with everything it leaves."""

import json
from dataclasses import replace
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import torch

from cathsim import NavigateEnv
from enn.networks.network import build_network
from pipeline.evaluations.tables import tables_from_logs
from pipeline.jobs.worker import Report
from pipeline.recording.record import record_episode
from pipeline.recording.trials import Origin
from pipeline.stages import StageContext, baselines
from pipeline.stages.baselines import PathJob, follow, training_settings
from pipeline.stages.enn import architecture, check_enn, plan
from pipeline.stages.learning.aids import of_training
from pipeline.stages.learning.settings import BaselinesSettings, EnnSettings
from pipeline.stages.learning.task import LearningTask
from pipeline.stages.learning.training import training_seeds
from pipeline.store.errors import ConfigurationError, StageError
from pipeline.store.run_folder import Identity, RunFolder
from pipeline.task import Task
from tests.enn.event_scalars import scalars
from tests.pipeline.composed import composed
from tests.pipeline.stages.small_expert import context


def settings(**changed) -> EnnSettings:
    places = {"phantoms": ["type_1", "type_2"], "targets": ["bca", "lcca"], "ablation_phantoms": ["type_1"]}
    rows = {"modalities": ["I", "V"], "safe_weights": [0.5], "seeds": 3, "ablation_seeds": 2}
    return EnnSettings(**places | rows | changed)


@pytest.fixture
def place(tmp_path: Path) -> StageContext:
    return context(tmp_path, "enn", ("expert",))


def test_plan_has_the_expert_everywhere_and_the_ablation_where_asked(place: StageContext) -> None:
    jobs = plan(settings(decisions=500, safe_decisions=700), place)
    names = [job.name for job in jobs]
    assert len(set(names)) == len(names) == 2 * 2 * 3 + 3 * 2 * 2
    assert names[0] == "type_1/bca/I+V+M/seed0"
    assert not [name for name in names if name.startswith("type_2") and "I+V+M/" not in name]
    safe = [job for job in jobs if job.origin.row == "I+V+M safe 0.5"]
    assert {job.task.force_penalty for job in safe} == {0.5}
    assert {job.settings.decisions for job in safe} == {700}
    assert {job.settings.decisions for job in jobs if job not in safe} == {500}
    assert {job.task.force_penalty for job in jobs if job not in safe} == {0.0}
    recorded = [job.name for job in jobs if job.expert_episodes]
    assert recorded == [f"{p}/{t}/I+V+M/seed0" for p in ("type_1", "type_2") for t in ("bca", "lcca")]


def test_desk_sees_through_an_encoder_and_neither_the_thesis_nor_a_roadmap_does(place: StageContext) -> None:
    desk, thesis = (plan(settings(variant=variant), place)[0] for variant in ("desk", "thesis"))
    assert desk.encoder == place.path / "encoders/type_1/joints+image+mask.pt"
    assert desk.settings.keys == ()
    assert thesis.encoder is None
    assert thesis.settings.keys == desk.keys == ("joints", "image", "mask")
    assert thesis.settings.batch_size == 256
    task = Task(wire_length_mm=360.0, catheter="simmons2")
    job = plan(settings(modality="R", target="lcca", phantom="random_33009", task=task), place)[0]
    assert (job.name, job.encoder) == ("random_33009/lcca/R/seed0", None)
    assert job.keys == ("roadmap", "history")
    assert job.settings.extractor == "vectors"
    assert job.settings.normalise


@pytest.mark.parametrize(("algorithm", "accuracy"), [("sac", "fast"), ("ppo", "accurate")])
def test_ppo_trains_in_physics_of_its_own(place: StageContext, algorithm: str, accuracy: str) -> None:
    jobs = plan(settings(accuracy="fast", algorithm=algorithm), place)
    assert {job.task.accuracy for job in jobs} == {accuracy}


@pytest.mark.parametrize(
    ("changed", "episodes"),
    [
        ({"task": Task()}, 10),
        ({}, 20),
        ({"task": Task(catheter="vertebral", wire="none")}, 10),
        ({"evaluation_episodes": 1}, 1),
        ({"variant": "thesis"}, 10),
        ({"training": {"evaluation_episodes": 7}}, 7),
    ],
)
def test_policies_of_two_devices_are_chosen_by_more_episodes(place: StageContext, changed: dict, episodes: int) -> None:
    jobs = plan(settings(**{"task": Task(catheter="vertebral"), **changed}), place)
    assert {job.settings.evaluation_episodes for job in jobs} == {episodes}


def test_keys_of_a_sweep_leave_one_of_each_and_run_seeds_share_none(place: StageContext) -> None:
    chosen = settings(target="lcca", modality="V", phantom="type_2")
    assert [job.name for job in plan(chosen, place)] == [f"type_2/lcca/V/seed{k}" for k in range(3)]
    expert = settings(target="lcca", modality="I+V+M")
    assert {job.origin.row for job in plan(expert, place)} == {"I+V+M"}
    assert len(plan(expert, place)) == 2 * 3
    seeds = [seed for run in range(4) for seed in training_seeds(run, 2, 3)]
    assert len(set(seeds)) == len(seeds)
    assert plan(settings(seeds=1, ablation_seeds=1), replace(place, seed=7))[0].origin.training_seed == 7


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"modality": "Q"}, "unknown modality set 'Q'"),
        ({"target": "aorta"}, "unknown target 'aorta' in phantom 'type_1'"),
        ({"phantom": "type_9"}, "unknown phantom 'type_9'"),
        ({"ablation_phantoms": []}, "stage.ablation_phantoms is empty"),
    ],
)
def test_what_there_is_not_is_refused_by_name(changed: dict, sentence: str) -> None:
    with pytest.raises(ConfigurationError, match=sentence):
        check_enn(settings(**changed))


def test_architecture_is_that_of_the_thesis() -> None:
    table = architecture()
    assert [table[f"cnn/{name}"]["parameters"] for name in ("conv_1", "conv_2", "conv_3", "linear_1", "linear_2")] == [
        2080, 32832, 36928, 590080, 32896,
    ]  # fmt: skip
    assert [table[f"mlp/{name}"]["parameters"] for name in ("linear_1", "linear_2")] == [86272, 32896]


TINY = ("stage=enn", "budget=smoke", "name=run", "modality=I+V+M", "stage.decisions=48", "stage.encoder_samples=150",
        "stage.task.max_steps=30", "stage.expert_episodes=1")  # fmt: skip


@pytest.fixture
def expert_run(pipeline_process) -> Path:
    """A run whose stage expert has finished; its one log is a short scripted episode."""
    run = pipeline_process.runs / "run"
    folder = RunFolder(run / "expert", Identity("c", {}, 1))
    with folder.locked():
        folder.prepare()
        environment = NavigateEnv("type_1", "bca", observation="tip", max_steps=12, success="straight")
        record_episode(
            environment, lambda observation, info: np.array([1.0, 0.1], np.float32),
            folder.path / "type_1/bca/000.mcap", seed=0, operator="sampling_expert", pictures=False,
        )  # fmt: skip
        folder.finish(stage="expert", run="run", budget="smoke", seed=0, config={}, started=0.0)
    return run


def test_a_tiny_run_leaves_policy_curve_logs_and_tables(pipeline_process, expert_run: Path) -> None:
    done = pipeline_process.run_here(*TINY)
    assert done.returncode == 0, done.stderr + done.stdout
    folder = expert_run / "enn"
    training = folder / "type_1/bca/I+V+M/seed0"
    assert (folder / "encoders/type_1/joints+image+mask.pt").is_file()
    for name in ("policy.pt", "training.csv", "training.json", "evaluation/deterministic/000.mcap",
                 "evaluation/stochastic/000.mcap", "expert/000.mcap"):  # fmt: skip
        assert (training / name).is_file(), name
    assert scalars(training)["curve/reward"]
    assert "train/loss" in scalars(folder / "encoders/type_1/joints+image+mask")
    assert not (training / "checkpoint").exists()
    results = json.loads((folder / "results.json").read_text())
    assert results["task"]["evaluation_episodes"]["value"] == 1
    tables = tables_from_logs(expert_run)
    assert tables["ablation"]["bca/I+V+M"]["n"] == 1
    assert tables["enn"]["type_1/bca/I+V+M"]["stochastic_success_pct"] is not None
    assert results["training_time_h"]["enn"]["bca"] > 0
    assert results["sac_hyperparameters"]["gamma"] == {"value": 0.99}
    assert "up to date" in pipeline_process.run_here(*TINY).stdout


def of_baselines(**changed) -> BaselinesSettings:
    return BaselinesSettings(**{"phantoms": ["type_1", "type_2"], "targets": ["bca", "lcca"], **changed})


def test_plan_of_baselines_is_the_table_of_the_thesis_and_ppo_has_physics_of_its_own(tmp_path: Path) -> None:
    jobs = baselines.plan(
        of_baselines(accuracy="fast", ppo_accuracy="reference"), context(tmp_path, "baselines", ("expert",))
    )
    assert len({job.name for job in jobs}) == 24
    assert {job.origin.row for job in jobs} == {
        f"{a}_{o}" for a in ("ppo", "sac") for o in ("internal", "image", "sequential")
    }
    trained = {(job.settings.algorithm, job.settings.decisions, job.task.accuracy) for job in jobs}
    assert trained == {("ppo", 20_000, "reference"), ("sac", 4_000, "fast")}
    assert {job.encoder.name for job in jobs} == {"internal.pt", "image.pt", "sequential.pt"}


def test_thesis_has_its_own_networks_and_actions(tmp_path: Path) -> None:
    thesis = of_baselines(variant="thesis", task=Task(actions="tip_motors"), decisions=600_000, ppo_decisions=600_000)
    jobs = {job.origin.row: job for job in baselines.plan(thesis, context(tmp_path, "baselines", ("expert",)))}
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
    jobs = baselines.plan(stage, context(tmp_path, "baselines", ("expert",)))
    assert len({job.name for job in jobs}) == 2 * 2 * 2 * 3  # algorithms, arches, targets, seeds
    for job in jobs:
        assert of_training(job) == [f"{actions} actions", "600,000 decisions"]
        assert (job.keys, job.task.reward, job.task.path_penalty) == (("internal",), "distance", 0.0)
        assert (job.task.task.entry, job.task.task.max_steps, job.settings.stop_after) == ("ascending", 2000, 0)
        assert not job.demonstrations


@pytest.mark.parametrize("observation", ["internal", "sequential"])
@pytest.mark.parametrize("algorithm", ["ppo", "sac"])
def test_thesis_networks_are_those_of_the_chapter(algorithm: str, observation: str) -> None:
    thesis = of_baselines(variant="thesis", decisions=600_000, ppo_decisions=600_000)
    box = gymnasium.spaces.Box
    spaces = {"internal": box(-np.inf, np.inf, (30,), np.float32), "sequential": box(0, 255, (3, 64, 64), np.uint8)}
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


def test_a_path_follower_without_readable_episodes_says_what_to_do(expert_run, tmp_path) -> None:
    broken = tmp_path / "001.mcap"
    broken.write_bytes(min((expert_run / "expert/type_1/bca").glob("*.mcap")).read_bytes()[:2000])
    origin = Origin("baselines", "path_follower", 0, "desk")
    for logs in ((), (broken,)):
        with pytest.raises(StageError, match="type_1/bca has no expert episodes"):
            follow(PathJob(tmp_path, origin, LearningTask("type_1", "bca"), logs, 1), Report())


def test_a_tiny_run_fills_the_table(pipeline_process, expert_run) -> None:
    done = pipeline_process.run_here(
        "stage=baselines", "budget=smoke", "name=run", "stage.observations=[image]", "stage.decisions=48",
        "stage.ppo_decisions=256", "stage.encoder_samples=150", "stage.task.max_steps=30",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr + done.stdout
    folder = expert_run / "baselines"
    table = tables_from_logs(expert_run)["cathsim_results"]
    assert set(table) == {"type_1/ppo_image", "type_1/sac_image", "type_1/path_follower"}
    for row in table.values():
        assert row["reward_bca"][0] < 0  # the thesis's reward, not the training's
        assert row["success_bca_pct"] in (0, 100)
    assert (folder / "type_1/bca/path_follower/seed0/follower.pt").is_file()
    for row, name in (("sac_image", "curve/reward"), ("ppo_image", "curve/reward"), ("path_follower", "train/loss")):
        assert scalars(folder / "type_1/bca" / row / "seed0")[name]
