"""The enn stage: its plan, its sweep keys, and one tiny run with everything it leaves behind."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from pipeline.evaluations.tables import tables_from_logs
from pipeline.stages import StageContext
from pipeline.stages.enn import architecture, check_enn, plan, sizes
from pipeline.stages.learning.settings import EnnSettings
from pipeline.stages.learning.training import training_seeds
from pipeline.store.errors import ConfigurationError
from pipeline.task import Task
from tests.enn.event_scalars import scalars
from tests.pipeline.stages.small_expert import context


def settings(**changed) -> EnnSettings:
    values = {
        "phantoms": ["type_1", "type_2"],
        "targets": ["bca", "lcca"],
        "modalities": ["I", "V"],
        "ablation_phantoms": ["type_1"],
        "safe_weights": [0.5],
        "seeds": 3,
        "ablation_seeds": 2,
    }
    return EnnSettings(**{**values, **changed})


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


def test_desk_sees_through_an_encoder_and_the_thesis_does_not(place: StageContext) -> None:
    desk, thesis = (plan(settings(variant=variant), place)[0] for variant in ("desk", "thesis"))
    assert desk.encoder == place.path / "encoders/type_1/joints+image+mask.pt"
    assert desk.settings.keys == ()
    assert thesis.encoder is None
    assert thesis.settings.keys == desk.keys == ("joints", "image", "mask")
    assert thesis.settings.batch_size == 256


@pytest.mark.parametrize(("algorithm", "accuracy"), [("sac", "fast"), ("ppo", "accurate")])
def test_ppo_trains_in_physics_of_its_own(place: StageContext, algorithm: str, accuracy: str) -> None:
    jobs = plan(settings(accuracy="fast", algorithm=algorithm), place)
    assert {job.task.accuracy for job in jobs} == {accuracy}


@pytest.mark.parametrize(
    ("changed", "episodes"),
    [
        ({}, 10),
        ({"catheter": "vertebral"}, 20),
        ({"catheter": "vertebral", "wire": "none"}, 10),
        ({"catheter": "vertebral", "evaluation_episodes": 1}, 1),
        ({"catheter": "vertebral", "variant": "thesis"}, 10),
        ({"catheter": "vertebral", "training": {"evaluation_episodes": 7}}, 7),
    ],
)
def test_policies_of_two_devices_are_chosen_by_more_episodes(place: StageContext, changed: dict, episodes: int) -> None:
    jobs = plan(settings(**changed), place)
    assert {job.settings.evaluation_episodes for job in jobs} == {episodes}


def test_a_roadmap_needs_no_encoder(place: StageContext) -> None:
    task = Task(wire_length_mm=360.0, catheter="simmons2")
    job = plan(settings(modality="R", target="lcca", phantom="random_33009", task=task), place)[0]
    assert (job.name, job.encoder) == ("random_33009/lcca/R/seed0", None)
    assert job.keys == ("roadmap", "history")
    assert job.settings.extractor == "vectors"
    assert job.settings.normalise


def test_sizes_of_policies_stand_beside_the_thesis(place: StageContext) -> None:
    assert sizes(settings(evaluation_episodes=7))["evaluation_episodes"] == {"value": 7}


def test_run_seeds_share_no_training(place: StageContext) -> None:
    seeds = [seed for run in range(4) for seed in training_seeds(run, 2, 3)]
    assert len(set(seeds)) == len(seeds)
    assert plan(settings(seeds=1, ablation_seeds=1), replace(place, seed=7))[0].origin.training_seed == 7


def test_keys_of_a_sweep_leave_one_of_each(place: StageContext) -> None:
    chosen = settings(target="lcca", modality="V", phantom="type_2")
    assert [job.name for job in plan(chosen, place)] == [f"type_2/lcca/V/seed{k}" for k in range(3)]
    expert = settings(target="lcca", modality="I+V+M")
    assert {job.origin.row for job in plan(expert, place)} == {"I+V+M"}
    assert len(plan(expert, place)) == 2 * 3


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"modality": "Q"}, "unknown modality set 'Q'; there are I, V, M"),
        ({"target": "aorta"}, "unknown target 'aorta' in phantom 'type_1'; choose from bca, "),
        ({"phantom": "type_9"}, "unknown phantom 'type_9': choose from type_1"),
        ({"task": Task(wire="rope")}, "unknown wire 'rope': choose from default"),
    ],
)
def test_unknown_names_are_one_sentence(changed: dict, sentence: str) -> None:
    with pytest.raises(ConfigurationError, match=sentence):
        check_enn(settings(**changed))


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"variant": "fast"}, "stage.variant has no 'fast': choose from desk, thesis"),
        ({"seeds": 0}, "stage.seeds must be 1 or more, got 0"),
        ({"safe_weights": [-1.0]}, "stage.safe_weights must be greater than 0"),
        ({"ablation_phantoms": []}, "stage.ablation_phantoms is empty"),
    ],
)
def test_wrong_values_are_one_sentence(changed: dict, sentence: str) -> None:
    with pytest.raises(ConfigurationError, match=sentence):
        settings(**changed)


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
    finish_expert(run)
    return run


def finish_expert(run: Path) -> None:
    import numpy as np

    from cathsim import NavigateEnv
    from pipeline.recording.record import record_episode
    from pipeline.store.run_folder import Identity, RunFolder

    folder = RunFolder(run / "expert", Identity("c", {}, 1))
    with folder.locked():
        folder.prepare()
        environment = NavigateEnv("type_1", "bca", observation="tip", max_steps=12, success="straight")
        record_episode(
            environment, lambda observation, info: np.array([1.0, 0.1], np.float32),
            folder.path / "type_1/bca/000.mcap", seed=0, operator="sampling_expert", pictures=False,
        )  # fmt: skip
        folder.finish(stage="expert", run="run", budget="smoke", seed=0, config={}, started=0.0)


def test_a_tiny_run_leaves_policy_curve_logs_and_tables(pipeline_process, expert_run: Path) -> None:
    done = pipeline_process.run_here(*TINY)
    assert done.returncode == 0, done.stderr + done.stdout
    assert "enn trainings 2/2" in done.stdout
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
    tables = tables_from_logs(folder)
    assert tables["ablation"]["bca/I+V+M"]["n"] == 1
    assert tables["enn"]["type_1/bca/I+V+M"]["stochastic_success_pct"] is not None
    assert "type_1/bca/I+V+M: success" in done.stdout
    assert results["training_time_h"]["enn"]["bca"] > 0
    assert results["sac_hyperparameters"]["gamma"] == {"value": 0.99}
    assert "up to date" in pipeline_process.run_here(*TINY).stdout
