"""The navigation: scenes, failure modes, a tiny run of the stage with everything it leaves, and bad settings."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import torch
from PIL import Image

from cathsim import NavigateEnv, load_phantom
from cathsim.metrics.failure_modes import MODES, STUCK
from cathsim.observations.c_arm_view import CArms
from enn.imitation.advised_rounds import read_episodes
from enn.imitation.sequence_cloning import AdvisedEpisode
from pipeline.episodes import EpisodeReader
from pipeline.jobs.worker import Report
from pipeline.recording.trials import Origin
from pipeline.stages.navigation import stage as navigation
from pipeline.stages.navigation.jobs import NAVIGATOR, Course, cases_in_view, load_navigator, navigate, success_of
from pipeline.stages.navigation.perception import PerceptionJob, frames_in, load_perception
from pipeline.stages.navigation.scene import (
    NAMED,
    TrialSet,
    count_failures,
    episode_of_log,
    run_tests,
    scene_of,
    space_of,
    vessels_of,
)
from pipeline.stages.navigation.settings import NavigationSettings
from pipeline.stages.navigation.tables import NavigationFilm
from pipeline.store.errors import ConfigurationError, StageError
from pipeline.task import TASK as KEY
from pipeline.task import Task
from splineformer.build import build, size_of
from splineformer.navigation.navigator_perception import NavigatorPerception, NavigatorPerceptionSettings
from splineformer.navigation.perception import SIDE_PX, PerceptionNetwork
from splineformer.predictor import Predictor
from tests.pipeline.stages.small_expert import TASK, context, run_here, write_expert

READS = ("expert", "enn", "unseen", "splineformer")
ROUNDS = ("dagger_rounds", "dagger_episodes", "dagger_epochs", "arches", "arch_rounds", "arch_episodes", "arch_epochs")
FITS = {"episodes": [1, 3], "epochs": 2, "updates": 0, "trials": 1, **dict.fromkeys(ROUNDS, 1)}
NETWORKS = {"perception_arches": 0, "perception_frames": 4, "perception_epochs": 1, "hidden": 8, "arch_hidden": 12}
PLACES = {"cameras": ["a", "b"], "image_size_px": 256, "transfer_phantoms": [], "targets": ["bca"], "test_arches": 1}
TASKS = {"task": TASK.task, "arch_task": Task(wire_length_mm=312.0, max_steps=13)}
SETTINGS = NavigationSettings(**FITS | NETWORKS | PLACES | TASKS)
ARMS = CArms(("a",), 256)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run whose earlier stages left an expert, a teacher and a SplineFormer, none of them trained."""
    from enn.networks.network import NetworkSettings, build_network
    from enn.policy import Policy

    folder = tmp_path_factory.mktemp("run")
    write_expert(folder / "enn", episodes=2)
    (folder / "expert").mkdir()
    torch.manual_seed(0)
    predictor = Predictor(build(size_of("ordered", "smoke")))
    predictor.save(folder / "splineformer" / "ordered" / "predictor.pt")
    environment = NavigateEnv("type_1", "bca", observation=("roadmap",))
    settings, actions = NetworkSettings(keys=("roadmap",), hidden=(8,)), environment.action_space
    assert isinstance(actions, gymnasium.spaces.Box)
    network = build_network(settings, environment.observation_space, actions)
    metadata = {KEY: asdict(SETTINGS.arch_task)}
    teacher = Policy(settings, network, environment.observation_space, actions, metadata=metadata)
    teacher.save(folder / "unseen" / "roadmap" / "seed0" / "policy.pt")
    return folder


@pytest.fixture(scope="module")
def results(run: Path) -> dict:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(navigation, "training_arch", lambda seed: ("random", 3))
        patch.setattr(navigation, "unseen_arches", lambda count: range(3, 3 + count))
        return run_here(SETTINGS, run, navigation, READS)


def test_perception_learns_from_laid_and_from_steered_wires(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pipeline.stages.navigation.perception.BETWEEN", 3)
    settings = replace(SETTINGS, perception_frames=5, arch_task=replace(SETTINGS.arch_task, max_steps=30))
    job = navigation.plan(SETTINGS, context(run, "navigation", reads=READS))[0].given
    assert isinstance(job, PerceptionJob)
    assert job.teacher is not None

    def frames_of(teacher: Path | None) -> list:
        return frames_in(("type_1", NAMED), settings, 0, teacher, 64)

    frames = frames_of(job.teacher)
    assert len(frames) == 5  # two laid ones first
    for pictures, curves in frames:
        assert pictures.shape == (2, 64, 64)
        assert ((curves > -1e-9) & (curves < 1 + 1e-9)).all()  # cut at the border, but for rounding
        places = np.clip((curves * 64).astype(int), 0, 63)
        on_wire = [picture[place[:, 1], place[:, 0]].mean() for picture, place in zip(pictures, places, strict=True)]
        beside = [picture[place[:, 1] - 4, place[:, 0]].mean() for picture, place in zip(pictures, places, strict=True)]
        assert np.mean(on_wire) < np.mean(beside)
    again = frames_of(job.teacher)
    assert all(np.array_equal(a[0], b[0]) for a, b in zip(frames, again, strict=True))
    untaught = frames_of(None)
    assert len(untaught) == 5
    assert np.array_equal(untaught[0][0], frames[0][0])
    assert not np.array_equal(untaught[3][0], frames[3][0])


def test_map_in_space_leads_through_the_lumen() -> None:
    arms = CArms(("a", "b"), 256)
    scene = scene_of(Task(), ("type_1", NAMED), "lcca", arms, ("tip",))
    phantom = scene.environment.phantom
    scene.environment.reset(seed=3)
    tip = scene.environment.simulation.tip
    space = space_of(phantom, "lcca", scene.arms)
    assert np.allclose(space.target, 1e3 * phantom.target("lcca").position, atol=1e-3)
    way = space.way(1e3 * tip)
    assert np.allclose(way[[0, -1]], (1e3 * tip, space.target), atol=1e-6)
    depth = 1e3 * phantom.grid.sample(way / 1e3)  # mm inside the wall
    assert np.quantile(depth, 0.1) > -2.0
    assert np.median(depth) > 2.0
    for name, vessels in vessels_of(phantom, "lcca", scene.arms).items():
        assert vessels.sample(scene.marks[name]) > 0.5
    scene.environment.close()


def test_every_second_wire_is_learnt_among_clutter() -> None:
    def frames_of(clutter: float) -> list:
        settings = replace(SETTINGS, perception_frames=8, clutter=clutter)
        return frames_in(("type_1", NAMED), settings, 0, None, 64)

    clean, among, again = frames_of(0.0), frames_of(2.0), frames_of(2.0)
    assert len(clean) == len(among) == 8
    assert all(np.array_equal(a[0], b[0]) for a, b in zip(among, again, strict=True))
    same = [np.array_equal(a[0], b[0]) for a, b in zip(clean, among, strict=True)]
    assert same[0]  # the first wire has none in its way
    assert not all(same)


def test_clutter_is_the_anatomys_own_and_stands_still() -> None:
    arms = CArms(("a", "b"), 256)
    names = ("type_1", "type_1", "type_2")
    scenes = [scene_of(Task(), (name, NAMED), "bca", arms, ("tip",), clutter=1.0) for name in names]
    clutter = [scene.arms.clutter for scene in scenes]
    assert clutter[0] is clutter[1] is not None
    assert clutter[2] is not None
    assert not np.array_equal(clutter[0].attenuation[0], clutter[2].attenuation[0])
    assert not np.array_equal(clutter[0].attenuation[0], clutter[0].attenuation[1])
    for scene in scenes:
        scene.environment.close()
    assert scene_of(Task(), ("type_1", NAMED), "bca", arms, ("tip",)).arms.clutter is None


def test_trials_among_clutter_are_those_of_the_navigator_of_random_arches(run: Path) -> None:
    settings = replace(SETTINGS, clutter=0.5, test_arches=3, clutter_arches=2)
    jobs = {job.key: job.given for job in navigation.plan(settings, context(run, "navigation", reads=READS))}
    (among,) = [test for test in jobs["splineformer_arches"].tests if test.clutter]
    (usual,) = [test for test in jobs["splineformer_arches"].tests if test.name == navigation.UNSEEN]
    assert (among.name, among.clutter, among.anatomies) == (navigation.CLUTTERED, 0.5, usual.anatomies[:2])
    assert jobs["splineformer_arches"].courses[0].clutter == 0.5
    for row in ("splineformer", "splineformer_dagger"):
        assert not any(one.clutter for one in (*jobs[row].tests, *jobs[row].courses))
    clean = navigation.plan(SETTINGS, context(run, "navigation", reads=READS))[1].given
    assert not any(test.clutter for test in clean.tests)


def test_tables(results: dict) -> None:
    table = results["navigation"]
    rows = ["splineformer", "splineformer_3", "splineformer_dagger", "splineformer_arches"]
    assert set(table) == {*rows, "behaviour_cloning", "enn_expert"}
    for row in (*rows, "behaviour_cloning"):
        assert 0 <= table[row]["bca_success_pct"] <= 100
        assert table[row]["setup"] == "autonomous"
        counted = {"n"} if row in rows else set()  # episodes of the cloned policy are counted in its own stage
        assert set(table[row]) == {"setup", "explainable", "bca_success_pct", "bca_time_s"} | counted
    assert set(results["navigation_trials"]) == {
        *(f"{row}/type_1" for row in rows),
        *(f"{row}/unseen_arches" for row in rows[2:]),
    }
    for cells in results["navigation_trials"].values():
        failed = sum(cells[f"bca_{mode}"] for mode in MODES)
        assert failed == cells["n"] - round(cells["bca_success_pct"] / 100 * cells["n"])
        assert cells["bca_out_of_view"] == 0
    assert list(results["navigation_episodes"]) == ["1 trials", "3 trials"]
    assert results["navigation_perception"]["images"]["value"] == 8  # of two cameras


def test_what_a_run_leaves_is_not_made_again(run: Path, results: dict) -> None:
    folder = run / "navigation"
    titles = [figure["file"] for figure in json.loads((folder / "figures.json").read_text())]
    assert titles == ["films/failure.gif"]
    assert len(read_episodes(folder / "episodes" / "type_1" / "bca.npz")) == 3  # one more than there are logs
    record = json.loads((folder / "splineformer_dagger" / "training.json").read_text())
    assert record["episodes"] == 2
    assert not (folder / "splineformer_dagger" / "advised_episodes").exists()
    logs = sorted((folder / "splineformer" / "evaluation").glob("type_1/bca/type_1/*.mcap"))
    assert len(logs) == 1
    with EpisodeReader(logs[0]) as episode:
        assert episode.info.configuration["row"] == "splineformer"
        actions = episode.load_arrays(pictures=False)["action"][1:]
    assert np.array_equal(actions[0], actions[2])
    assert count_failures(logs, load_phantom("type_1"))[STUCK] == 1
    jobs = {job.key: job for job in navigation.plan(SETTINGS, context(run, "navigation", reads=READS))}
    job = jobs["splineformer"].given
    before = (job.own_folder / NAVIGATOR).stat().st_mtime_ns
    outcome = navigate(replace(job, tests=()), Report())
    assert (job.own_folder / NAVIGATOR).stat().st_mtime_ns == before
    assert outcome["tests"] == []


def test_episode_of_a_log_has_features_a_decision(run: Path, results: dict) -> None:
    network = load_perception(run / "navigation")
    log = sorted((run / "enn" / TASK.name / "I+V+M" / "seed0" / "expert").glob("*.mcap"))[0]
    settings = NavigatorPerceptionSettings(tokens=network.tokens, encoded=network.encoded)
    perception = NavigatorPerception(settings, network)
    episode = episode_of_log(log, ARMS, perception, 3)
    with EpisodeReader(log) as logged:
        actions = logged.load_arrays(pictures=False)["action"][1:]
    assert episode.features.shape == (-(-len(actions) // 3), settings.size)
    assert np.allclose(episode.actions[1], actions[3:6].mean(axis=0), atol=1e-6)
    assert np.allclose(episode.features[1, -4:-2], episode.actions[0], atol=1e-6)  # what was done before is seen
    assert np.array_equal(episode.features, episode_of_log(log, ARMS, perception, 3).features)


def test_success_is_counted_by_target() -> None:
    ends = [("bca", False), ("lcca", True), ("bca", False), ("bca", True)]
    row = np.zeros((1, 2), np.float32)
    episodes = [AdvisedEpisode(row, row, row[:, :0], success, target) for target, success in ends]
    assert success_of(episodes) == {"bca": pytest.approx(100 / 3), "lcca": 100.0}


def test_targets_that_a_camera_does_not_see_are_left_out() -> None:
    arms = CArms(("a", "b"), 256)
    course = Course(Path("teacher.pt"), (("random_scan", 1053), ("type_1", NAMED)), ("bca", "lcca"), TASK.task)
    cases = cases_in_view(course, 7, arms, np.random.default_rng(0))
    assert len(cases) == 7
    assert set(cases) == {(("random_scan", 1053), "bca"), (("type_1", NAMED), "bca"), (("type_1", NAMED), "lcca")}
    unseen = replace(course, anatomies=course.anatomies[:1], targets=("lcca",))
    with pytest.raises(StageError, match="see no target"):
        cases_in_view(unseen, 1, arms, np.random.default_rng(0))


@pytest.mark.usefixtures("results")
def test_a_trial_needs_a_target_in_view(run: Path, tmp_path: Path) -> None:
    network = load_perception(run / "navigation", "cpu")
    policy, perception = load_navigator(run / "navigation" / "splineformer" / NAVIGATOR, network)
    tests = TrialSet("large", (("random_scan", 1053),), 1, TASK.task)
    settings, origin = replace(SETTINGS, targets=["lcca"]), Origin("navigation", "splineformer", 0, "desk")
    with pytest.raises(StageError, match="see the lcca in none of large"):
        run_tests(policy, perception, [tests], settings, tmp_path, origin, report=lambda share, text: None)
    both = replace(tests, anatomies=(*tests.anatomies, ("type_1", NAMED)))
    (row,) = run_tests(policy, perception, [both], settings, tmp_path, origin, report=lambda share, text: None)
    assert (row["n"], row["out_of_view"]) == (1, 1)


def test_a_film_shows_every_camera(run: Path) -> None:
    scene = scene_of(Task(), ("type_1", NAMED), "bca", CArms(("a", "b"), 256), ("tip",))
    scene.environment.reset(seed=0)
    predictor = Predictor.load(run / "splineformer" / "ordered" / "predictor.pt")
    film = NavigationFilm(scene, PerceptionNetwork(predictor))
    film.add(scene.environment)
    film.write(run / "both.gif")
    scene.environment.close()
    with Image.open(run / "both.gif") as picture:
        assert picture.size == (2 * SIDE_PX, 2 * SIDE_PX)
        halves = np.asarray(picture.convert("RGB")).astype(int)
    assert np.abs(halves[:SIDE_PX, :SIDE_PX] - halves[SIDE_PX:, :SIDE_PX]).mean() > 1  # two views, not one twice


@pytest.mark.parametrize("stage", ["unseen", "enn"])
def test_missing_teacher_is_refused_before_any_work(run: Path, tmp_path: Path, stage: str) -> None:
    given = context(run, "navigation", reads=READS)
    given.inputs[stage] = tmp_path
    with pytest.raises(StageError, match=f"run stage={stage}"):
        navigation.plan(SETTINGS, given)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"episodes": [100, 20]}, "must rise"),
        ({"transfer_phantoms": ["type_1"]}, "which is learnt in"),
        ({"clutter": 1.0, "image_size_px": 1025}, "images of at most 1024 px"),
        ({"targets": ["aorta"]}, "choose from bca"),
    ],
)
def test_bad_settings_are_refused(changed: dict, words: str) -> None:
    with pytest.raises(ConfigurationError, match=words):
        navigation.check_navigation(replace(SETTINGS, **changed))
