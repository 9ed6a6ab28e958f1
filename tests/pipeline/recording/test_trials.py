"""Trials, one log a held-out seed, none repeated after an interruption; replays of logs; films of a training."""

import dataclasses
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import enn
from cathsim import NavigateEnv, load_catheter
from cathsim.arch_variety import ArchVarietyEnv
from cathsim.goals.environment import NavigateGoalEnv
from pipeline.config import RunConfig
from pipeline.episodes import EpisodeReader
from pipeline.episodes.__main__ import main
from pipeline.execution import observation_of_trainings
from pipeline.jobs.engines.local import variables_set
from pipeline.recording.record import record_episode
from pipeline.recording.replay import ReplayError, recorded_catheter, replay
from pipeline.recording.training_films import training_films
from pipeline.recording.trials import Origin, run_trials, summary
from pipeline.seeds import held_out_seeds
from pipeline.stages.learning.task import LearningTask
from pipeline.task import Task

TASK = LearningTask("type_1", "bca", Task(max_steps=6))
ORIGIN = Origin("enn", "I+V+M", 3, "desk", {"training_force_penalty": 0.5})


class Draws:
    """A policy of random actions that counts the episodes it was made for."""

    def __init__(self) -> None:
        self.seeds: list[int] = []

    def __call__(self, seed: int):
        self.seeds.append(seed)
        generator = np.random.default_rng(seed)
        return lambda observation, info: generator.uniform(0, 1, 2).astype(np.float32)


def trials(folder: Path, draws: Draws, *, count: int = 3, **further):
    environment = TASK.environment("tip")
    return run_trials(
        environment, draws, folder, seeds=held_out_seeds(3, count), mode="stochastic", origin=ORIGIN, **further
    )


def test_each_seed_has_a_log_that_says_where_it_comes_from(tmp_path: Path) -> None:
    told: list[tuple[float, str]] = []
    metrics = trials(tmp_path, Draws(), report=lambda fraction, text: told.append((fraction, text)))
    assert told == [(1 / 3, "0/1"), (2 / 3, "0/2"), (1.0, "0/3")]
    assert [path.name for path in sorted(tmp_path.iterdir())] == ["000.mcap", "001.mcap", "002.mcap"]
    with EpisodeReader(tmp_path / "001.mcap") as log:
        assert log.info.seed == held_out_seeds(3, 3)[1]
        said = {key: log.info.configuration[key] for key in ("stage", "row", "mode", "training_seed", "variant")}
        assert said == {"stage": "enn", "row": "I+V+M", "mode": "stochastic", "training_seed": 3, "variant": "desk"}
        assert log.info.configuration["training_force_penalty"] == 0.5
        assert log.info.configuration["start_rotation"] == pytest.approx(np.pi)
        arrays = log.load_arrays()
        assert not [name for name in arrays if name.startswith("image")]
        # the thesis's reward, whatever the training's was
        np.testing.assert_allclose(arrays["reward"][1:], -arrays["extra/distance_m"][1:])
        assert metrics[1].force_max == arrays["resultant_force_norm"][1:].max()


def test_a_recorded_episode_is_not_repeated_and_an_unfinished_one_is(tmp_path: Path) -> None:
    whole, resumed = trials(tmp_path / "whole", Draws()), Draws()
    trials(tmp_path / "half", Draws(), count=2)
    (tmp_path / "half" / "001.mcap").write_bytes(b"torn")
    (tmp_path / "half" / "002.mcap.partial").write_bytes(b"killed")
    assert trials(tmp_path / "half", resumed) == whole
    assert resumed.seeds == [held_out_seeds(3, 3)[1], held_out_seeds(3, 3)[2]]
    assert not list((tmp_path / "half").glob("*.partial"))


def test_pictures_on_request_a_summary_and_refusals(tmp_path: Path) -> None:
    row = summary(trials(tmp_path, Draws(), pictures=True))
    assert row["n"] == 3
    assert row["episode_length_steps"] == 6
    assert row["success_pct"] == 0
    with EpisodeReader(tmp_path / "000.mcap") as log:
        assert log.load_arrays()["image/frontal"].shape == (7, 80, 80)
    with pytest.raises(ValueError, match="unknown mode 'best'"):
        run_trials(TASK.environment("tip"), Draws(), tmp_path, seeds=[0], mode="best", origin=ORIGIN)


ACTIONS = np.random.default_rng(3).uniform(-0.2, 1.0, (40, 2)).astype(np.float32)


def record(path: Path, *, pictures: bool, seed: int = 5, **arguments) -> Path:
    environment = NavigateEnv("type_1", "bca", observation="tip", max_steps=25, start_rotation=3.0, **arguments)
    steps = iter(ACTIONS)
    record_episode(environment, lambda *_: next(steps), path, seed=seed, operator="test", pictures=pictures)
    return path


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("replay") / "0.mcap", pictures=True, image_size=40)


def test_replay_gives_back_the_episode_with_other_observations(log: Path) -> None:
    trajectory = replay(log, ("joints", "image", "mask"))
    with EpisodeReader(log) as reader:
        arrays = reader.load_arrays()
    assert trajectory.observations["image"].shape == (26, 1, 40, 40)
    np.testing.assert_array_equal(trajectory.observations["image"][:, 0], arrays["image/frontal"])
    np.testing.assert_array_equal(trajectory.observations["mask"][:, 0] > 0, arrays["mask/frontal"])
    np.testing.assert_array_equal(trajectory.tips, arrays["tip"])
    np.testing.assert_array_equal(trajectory.actions, arrays["action"][1:])
    np.testing.assert_array_equal(trajectory.rewards, arrays["reward"][1:])
    np.testing.assert_array_equal(trajectory.forces, arrays["resultant_force_norm"][1:])
    joints = np.concatenate((arrays["joint_positions"], arrays["joint_velocities"]), axis=1)
    np.testing.assert_array_equal(trajectory.observations["joints"], joints.astype(np.float32))
    assert not any(name.startswith("devices/") for name in arrays)
    assert trajectory.metadata["target"] == "bca"


def test_an_episode_goes_on_from_a_replayed_state(log: Path) -> None:
    trajectory = replay(log)
    assert trajectory.simulation_states is not None
    environment = NavigateEnv("type_1", "bca", observation="tip", max_steps=25, start_rotation=3.0)
    environment.reset(seed=0, options={"start": trajectory.simulation_states[10]})
    np.testing.assert_array_equal(environment.simulation.tip, trajectory.tips[10])
    _, _, _, _, info = environment.step(ACTIONS[10])
    np.testing.assert_array_equal(info["tip"], trajectory.tips[11])


def test_the_reward_can_be_another(log: Path) -> None:
    geodesic = replay(log, reward="geodesic")
    penalised = replay(log, reward="geodesic", force_penalty=2.0)
    assert (geodesic.rewards != replay(log).rewards).all()
    np.testing.assert_allclose(penalised.rewards, geodesic.rewards - 2.0 * geodesic.forces, atol=1e-12)


def test_rewards_of_a_function_come_from_the_log(tmp_path: Path) -> None:
    log = record(tmp_path / "0.mcap", pictures=False, reward=lambda info: info["insertion"])
    with EpisodeReader(log) as reader:
        insertions = reader.load_arrays(pictures=False)["insertion"][1:]
        assert reader.info.configuration["reward"].startswith("own:")
    np.testing.assert_array_equal(replay(log).rewards, insertions)
    assert (replay(log, reward="distance").rewards < 0).all()


def test_an_episode_of_a_drawn_goal_is_replayed(tmp_path: Path) -> None:
    environment = NavigateGoalEnv("type_1", accuracy="fast", max_steps=6)
    log = tmp_path / "0.mcap"
    record_episode(environment, lambda seen, info: ACTIONS[0], log, seed=3, operator="test", pictures=False)
    assert (replay(log).rewards == -1.0).all()


def test_a_log_without_pictures_replays_too(tmp_path: Path) -> None:
    log = record(tmp_path / "0.mcap", pictures=False)
    with EpisodeReader(log) as reader:
        assert reader.cameras == ()
    assert replay(log, ("image",), image_size=30).observations["image"].shape == (26, 1, 30, 30)
    assert replay(log, ("image",)).observations["image"].shape == (26, 1, 80, 80)


def test_a_coarser_physics_and_a_pace_are_replayed_as_they_were(tmp_path: Path) -> None:
    log = record(tmp_path / "pace.mcap", pictures=False, pace="arch_variety", accuracy="fast")
    with EpisodeReader(log) as reader:
        assert reader.info.control_dt == pytest.approx(1 / 7.5)
    assert len(replay(log)) == 25


@pytest.mark.parametrize("entry", ["lsa_end", (0.0436, 0.0266, -0.032)])
def test_an_entry_of_ones_own_is_replayed(tmp_path: Path, entry: str | tuple[float, float, float]) -> None:
    log = record(tmp_path / "entry.mcap", pictures=False, entry=entry)
    with EpisodeReader(log) as reader:
        tips = reader.load_arrays()["tip"]
    np.testing.assert_array_equal(replay(log).tips, tips)


def test_what_does_not_repeat_is_refused(tmp_path: Path) -> None:
    other = record(tmp_path / "robot.mcap", pictures=False, drive="robot")
    with pytest.raises(ReplayError, match=r"robot.mcap does not repeat: at step \d+ the tip is"):
        replay(other)


@pytest.mark.parametrize(
    "devices", [{"catheter": "vertebral_6f", "torsion": "rigid"}, {"catheter": "vertebral", "wire": None}]
)
def test_two_devices_are_replayed_as_they_were(tmp_path: Path, devices: dict[str, Any]) -> None:
    steps = np.random.default_rng(4).uniform(-0.3, 1.0, (30, 2 if "wire" in devices else 4)).astype(np.float32)
    environment = NavigateEnv("type_1", "bca", observation="feeder", max_steps=15, start_rotation=3.0, **devices)
    seen, actions = [], iter(steps)

    def policy(observation: Any, info: Any) -> Any:
        seen.append(observation)
        return next(actions)

    record_episode(environment, policy, tmp_path / "0.mcap", seed=5, operator="test", pictures=False)
    trajectory = replay(tmp_path / "0.mcap", ("feeder", "devices"))
    np.testing.assert_array_equal(trajectory.observations["feeder"][:-1], seen)
    with EpisodeReader(tmp_path / "0.mcap") as log:
        arrays, info = log.load_arrays(pictures=False), log.info
    assert info.catheter_name == devices["catheter"]
    assert info.configuration["torsion"] == devices.get("torsion", "elastic")
    names = ("insertions", "hub_rotations", "tip_rotations", "feeder_forces", "hub_torques")
    both = np.stack([arrays[f"devices/{name}"] for name in names], axis=2)
    there = np.array([devices.get("wire", "default") is not None, True])
    np.testing.assert_allclose(trajectory.observations["devices"][:, there], both[:, there], rtol=1e-6, atol=1e-9)
    assert (arrays["devices/wire_count"] > 0).all() == there[0]


def test_a_log_keeps_the_catheter_and_not_its_name_alone(tmp_path: Path) -> None:
    own = dataclasses.replace(load_catheter("vertebral"), friction=0.11)
    environment = NavigateEnv("type_1", "bca", observation="tip", max_steps=3, catheter=own)
    record_episode(environment, lambda *_: np.ones(4), tmp_path / "0.mcap", seed=1, operator="test", pictures=False)
    with EpisodeReader(tmp_path / "0.mcap") as log:
        assert log.info.catheter_name.startswith("own catheter ")
        assert recorded_catheter(log.info) == own
    assert len(replay(tmp_path / "0.mcap")) == 3


def test_a_log_is_filmed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    environment = NavigateEnv("type_1", "bca", observation="tip", max_steps=6, catheter="vertebral", image_size=40)
    record_episode(environment, lambda *_: np.full(4, 0.9), tmp_path / "0.mcap", seed=1, operator="test")
    with EpisodeReader(tmp_path / "0.mcap") as log:
        masks = [log.mask("frontal", 6, device) for device in ("wire", "catheter")]
        np.testing.assert_array_equal(log.mask("frontal", 6), masks[0] | masks[1])
        assert all(mask.any() for mask in masks)
    assert main(["film", str(tmp_path / "0.mcap")]) == 0
    with Image.open(tmp_path / "0.gif") as film:
        assert film.n_frames == 4
        assert film.size[1] == 400
    capsys.readouterr()
    assert main(["film", str(tmp_path / "0.mcap"), str(tmp_path / "0.mp4")]) != 0
    assert "let it end in .gif" in capsys.readouterr().err
    assert not (tmp_path / "0.mp4").exists()


def test_every_second_evaluation_is_filmed(tmp_path: Path) -> None:
    policy = enn.load("arch_variety")
    make = partial(ArchVarietyEnv, ("I",), (3,), observation=policy.keys, max_steps=6)
    assert training_films(tmp_path, make, 5) is None
    with variables_set(observation_of_trainings(RunConfig(stage=None, name="a", films=2))):
        films = training_films(tmp_path, make, 5)
    assert films is not None
    for decisions in (100, 200, 300):
        films(policy, decisions)
    assert sorted(path.name for path in (tmp_path / "films").iterdir()) == ["00000100.gif", "00000300.gif"]
    with Image.open(tmp_path / "films" / "00000100.gif") as film:
        assert film.n_frames >= 4
        assert film.size == (700, 400)


def test_what_a_run_was_told_ends_with_it(monkeypatch: pytest.MonkeyPatch) -> None:
    from enn.curves import chosen_logger

    monkeypatch.delenv("ENN_LOGGER", raising=False)
    with variables_set(observation_of_trainings(RunConfig(stage=None, name="a", logger="none"))):
        assert chosen_logger() == "none"
    assert chosen_logger() == "tensorboard"
