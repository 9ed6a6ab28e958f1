"""Trainings of a rehearsal: hyperparameters, demonstrations of policies and of the expert, and further trainings."""

import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from enn.device_trials import TrialStatistics
from enn.policy import Policy
from enn.reinforcement.evaluation import EpisodeOutcome, EvaluationResult, LatestPolicy
from enn.reinforcement.rehearsal_rules import RehearsalRules, in_share
from enn.reinforcement.training.result import TrainingResult
from enn.reinforcement.training.settings import TrainingSettings
from enn.trajectory import Trajectory
from pipeline.jobs.worker import Report
from pipeline.stages.rehearsal.copies import RehearsalJob, copies_environment, training_settings
from pipeline.stages.rehearsal.settings import RehearsalSettings
from pipeline.stages.rehearsal.stage import plan
from pipeline.stages.rehearsal.start import advising_policies
from pipeline.stages.rehearsal.training import (
    demonstrate,
    demonstration_file,
    first_turn,
    read_demonstrations,
    train,
)
from pipeline.store.atomic_files import write_arrays
from pipeline.task import Task
from tests.pipeline.stages.rehearsal.small_rehearsal import GENERALIST, TINY, job_of
from tests.pipeline.stages.small_expert import context


@pytest.mark.parametrize(
    ("shares", "further"),
    [((None, 0.2, 0.88), True), ((0.2, 0.9), False), ((0.95, 0.5, None), True), ((0.5, 0.0), False), ((None,), False)],
)
def test_a_training_that_sometimes_arrives_is_worth_another(shares: tuple[float | None, ...], further: bool) -> None:
    curve = [{"success": share} for share in shares]
    result = TrainingResult(policy=None, curve=curve, timings={}, evaluation=None)  # type: ignore[arg-type]
    assert RehearsalRules().sometimes_arrives(result) == further


def test_a_further_training_goes_on_from_the_one_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(RehearsalRules, "sometimes_arrives", lambda self, result: True)
    job = replace(job_of(tmp_path, share_of_decisions=0.5, further_trainings=2), start=GENERALIST)
    told: list[float] = []
    cost = train(job, Report(lambda message: told.append(message.fraction)))
    assert cost["further_trainings"] == 2
    assert cost["decisions"] == 48 + 24 + 24
    seed = tmp_path / "seed0"
    last = (seed / "further2/policy.pt").read_bytes()
    assert (seed / "policy.pt").read_bytes() == last
    settings = [json.loads((seed / name / "training.json").read_text())["settings"] for name in ("", "further1")]
    assert settings[1]["learning_rate"] == pytest.approx(2 * settings[0]["learning_rate"])
    assert told
    assert all(0 <= share <= 1 for share in told)

    (seed / "further2/training.json").unlink()  # as where it was interrupted
    assert train(job, Report())["decisions"] == cost["decisions"]
    assert (seed / "further2/policy.pt").read_bytes() == (seed / "policy.pt").read_bytes()


def test_what_was_played_to_choose_the_length_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    outcomes, counts = list[bool](), {"play": 0, "evaluate": 0}

    def mostly_arrives(self: RehearsalRules, *given: Any) -> bool:
        elsewhere: Callable[[], Sequence[bool]] = given[-1]
        outcomes.extend(elsewhere())
        return True

    def count(name: str) -> None:
        method = getattr(LatestPolicy, name)

        def counted(self: LatestPolicy, *given: Any, **named: Any) -> Any:
            counts[name] += 1
            return method(self, *given, **named)

        monkeypatch.setattr(LatestPolicy, name, counted)

    for name in counts:
        count(name)
    monkeypatch.setattr(RehearsalRules, "mostly_arrives", mostly_arrives)
    job = replace(job_of(tmp_path, share_of_decisions=0.5), start=GENERALIST)
    assert train(job, Report())["decisions"] == 24
    assert len(outcomes) == 2  # the scan and a copy
    assert counts["play"] == counts["evaluate"] > 1  # one of them before the training, which does not play it again


def leave(job: RehearsalJob, name: str, turn: int, arrivals: Sequence[bool]) -> None:
    """Leaves the episodes of a policy's turn, in the first copies, of which only is known where they arrived."""
    for copy, arrives in zip(job.training_cases, arrivals, strict=False):
        write_arrays(demonstration_file(job, name, copy, turn), {"terminated": np.array(arrives)})


@pytest.mark.parametrize(("cores", "setting", "threads"), [(1, 0, 1), (2, 0, 2), (16, 0, 4), (2, 3, 3)])
def test_a_training_has_a_thread_for_each_core_within_reason(
    cores: int, setting: int, threads: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pipeline.stages.rehearsal.copies.available_workers", lambda: cores)
    assert training_settings(job_of(tmp_path, threads=setting), "cpu").threads == threads


@pytest.mark.parametrize(
    ("arrivals", "others", "trials", "decisions"),
    [
        ((True, True, True, False), (True, True), 0, 24),
        ((True, True, True, False), (True, True), 1, 24),
        ((True, True, True, False), (True, True), 2, 48),  # but in one of two trials
        ((True, True, True, False), (True, False), 0, 48),  # but not elsewhere
        ((True, True, True, True), None, 0, 48),
        ((True, True, False, False), None, 0, 48),
        ((True, True, True), None, 0, 48),  # one copy was not played
        ((), None, 0, 48),
    ],
)
def test_a_policy_that_mostly_arrives_is_trained_for_fewer_decisions(
    tmp_path: Path, arrivals: tuple[bool, ...], others: tuple[bool, ...] | None, trials: int, decisions: int
) -> None:
    trial_statistics = TrialStatistics(1, trials, 100.0, 0.1) if trials else None
    job = replace(job_of(tmp_path, copies=3, share_of_decisions=0.5), trial_statistics=trial_statistics)
    leave(job, "generalist", 0, arrivals)
    leave(job, "navigator", 0, [True] * len(arrivals))

    def elsewhere() -> Sequence[bool]:
        assert others is not None  # it is not played where the first round says enough
        return others

    assert not job.rules.mostly_arrives(first_turn(job), trial_statistics, elsewhere)  # of nothing
    fewer = job.rules.mostly_arrives(first_turn(replace(job, start=GENERALIST)), trial_statistics, elsewhere)
    training = training_settings(job, "cpu", fewer=fewer)
    assert (training.decisions, training.evaluate_every) == (decisions, decisions // 3)
    assert training.learning_rate * decisions == pytest.approx(48 * training_settings(job, "cpu").learning_rate)
    assert training_settings(job_of(tmp_path, algorithm="ppo"), "cpu", fewer=True).decisions == 48


def test_a_policy_that_always_arrives_is_trained_until_the_last_evaluation_but_one(tmp_path: Path) -> None:
    def always_arrives(job: RehearsalJob) -> bool:
        return in_share(first_turn(job), job.trial_statistics, 1.0)

    job = replace(job_of(tmp_path, copies=3), start=GENERALIST)
    assert not always_arrives(job)  # nothing was played
    leave(job, "generalist", 0, [True] * 4)
    assert always_arrives(job)
    assert always_arrives(replace(job, trial_statistics=TrialStatistics(8, 8, 100.0, 0.1)))
    assert not always_arrives(replace(job, trial_statistics=TrialStatistics(7, 8, 100.0, 0.1)))
    assert not always_arrives(replace(job, start=None))
    leave(job, "generalist", 0, [True, True, True, False])
    assert not always_arrives(job)
    usual = training_settings(job, "cpu")
    shorter = training_settings(job, "cpu", evaluations=job.rules.fewer_evaluations)
    assert (usual.decisions, shorter.decisions) == (48, 32)
    assert usual.evaluate_every == shorter.evaluate_every == 16
    assert usual.learning_rate == shorter.learning_rate


@pytest.mark.parametrize(
    ("force", "share", "elsewhere", "decisions"),
    [(0.2, 0.5, True, 0), (0.4, 0.5, True, 32), (0.2, 0.5, False, 32), (0.2, 1.0, True, 48)],
    ids=["gentle", "presses", "not elsewhere", "whole trainings"],
)
def test_a_policy_that_always_arrives_and_presses_gently_is_not_trained(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, force: float, share: float, elsewhere: bool, decisions: int
) -> None:
    job = replace(job_of(tmp_path, share_of_decisions=share), start=GENERALIST)
    shown = Trajectory({}, np.zeros((2, 2)), np.zeros(2), True, np.full(2, force), np.zeros((3, 3)), None, {})
    played = EvaluationResult((EpisodeOutcome(True, 9, 0.0, 9.0, 0.1, 0.1), EpisodeOutcome(elsewhere, 9, 0, 9, 0.1, 0)))

    def rehearse(*given: Any, settings: TrainingSettings, **named: Any) -> TrainingResult:
        return TrainingResult(None, [], {"decisions": settings.decisions, "wall_s": 1.0}, None)  # type: ignore[arg-type]

    monkeypatch.setattr("pipeline.stages.rehearsal.training.first_turn", lambda job: [True, True])
    monkeypatch.setattr("pipeline.stages.rehearsal.training.read_demonstrations", lambda folder: [shown])
    monkeypatch.setattr("pipeline.stages.rehearsal.training._inserted_start_states", lambda *given: [])
    monkeypatch.setattr("enn.reinforcement.rehearsal.first_evaluation", lambda *given, **named: played)
    monkeypatch.setattr("enn.reinforcement.rehearsal.rehearse", rehearse)
    assert train(job, Report())["decisions"] == decisions
    kept = job.own_folder / "policy.pt"
    assert kept.is_file() == (decisions == 0)
    if kept.is_file():
        policy, start = Policy.load(kept), Policy.load(GENERALIST)
        assert policy.critics
        assert policy.metadata["stage"] == "rehearsal"
        mine, its = policy.module.state_dict(), start.module.state_dict()
        assert all((mine[name] == its[name]).all() for name in its)


def test_other_policies_are_asked_where_its_own_seldom_arrives(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    task = Task(start_rotation_deg=180.0, max_steps=200)
    demonstrators = advising_policies(tmp_path, 0, task, GENERALIST)
    assert [file.stem for file in demonstrators] == ["generalist", "navigator", "navigator_seed1"]
    job = job_of(tmp_path, copies=2, demonstrations=4, task=task)
    job = replace(job, start=GENERALIST, demonstrators=tuple(demonstrators))
    # it arrives nearly always, so nobody else is asked
    assert demonstrate(job, Report()) == {"generalist": [3, 3]}
    shown = read_demonstrations(tmp_path)
    assert len(shown) == 3
    assert all(episode.terminated and episode.observations["roadmap"].shape[1] == 64 for episode in shown)
    assert {int(episode.simulation_states[0, -1]) for episode in shown} == {0, 1, 2}  # type: ignore[index]
    assert max(np.abs(episode.actions).max() for episode in shown) <= 1.0
    monkeypatch.setattr("enn.reinforcement.rehearsal.demonstrated", None)  # nothing is played again
    assert demonstrate(job, Report()) == {"generalist": [3, 3]}


@pytest.mark.parametrize(("reached", "others"), [(None, False), (4, False), (1, False), (0, True)])
def test_trials_of_the_devices_count_when_others_are_asked(tmp_path: Path, reached: int | None, others: bool) -> None:
    """It arrives in both of two copies that one thread plays, in three of four altogether: all of them count."""
    demonstrators = tuple(advising_policies(tmp_path, 0, Task(), GENERALIST))[:2]
    job = job_of(tmp_path, copies=3, demonstrations=12)
    job = replace(job, start=GENERALIST, demonstrators=demonstrators)
    job = replace(job, trial_statistics=None if reached is None else TrialStatistics(reached, 4, 100.0, 0.1))
    leave(job, "generalist", 0, [True, True, True, False])
    for name, turn in (("navigator", 0), ("generalist", 1)):
        leave(job, name, turn, [False] * 4)
    told = {"generalist": [8, 3], "navigator": [4, 0]} if others else {"generalist": [4, 3]}
    assert demonstrate(job, Report()) == told


def test_images_show_the_way_and_the_best_is_asked_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    played: list[tuple[str, int, int]] = []
    last = 9  # turn in which anybody arrives

    class Steered:
        def __init__(self, job: RehearsalJob, path: Path, copies: Any) -> None:
            self.path, self.environment = path, copies_environment(job, (0,))

        def episode(self, case: int, number: int) -> Trajectory:
            played.append((self.path.stem, case, number))
            arrives = self.path.stem == "navigator" and case == 2 and number <= last
            seen = {"roadmap": np.zeros((2, 64)), "history": np.zeros((2, 3))}
            states = np.full((2, 5), float(case))
            return Trajectory(seen, np.zeros((1, 2)), np.zeros(1), arrives, np.zeros(1), np.zeros((2, 3)), states)

    monkeypatch.setattr("pipeline.stages.rehearsal.training._Steered", Steered)
    demonstrators = tuple(advising_policies(tmp_path, 0, Task(), GENERALIST))
    job = replace(job_of(tmp_path, copies=2, demonstrations=3), start=GENERALIST, demonstrators=demonstrators)
    assert demonstrate(job, Report()) == {"generalist": [3, 0], "navigator": [9, 3], "navigator_seed1": [3, 0]}
    turns = [("generalist", 0), ("navigator", 0), ("navigator_seed1", 0), ("navigator", 1), ("navigator", 2)]
    assert list(dict.fromkeys((name, number) for name, _, number in played)) == turns
    assert sorted(played) == sorted((name, case, number) for name, number in turns for case in range(3))
    assert len(read_demonstrations(tmp_path)) == 3
    fewer = replace(job, settings=replace(job.settings, demonstrations=1))
    played.clear()
    assert demonstrate(fewer, Report()) == {"generalist": [3, 0], "navigator": [3, 1]}  # enough, so no third
    assert not played  # all of them were there
    last = 0
    alone = replace(job, folder=tmp_path / "alone")
    # a turn in which nobody arrives is the last one
    assert demonstrate(alone, Report()) == {"generalist": [3, 0], "navigator": [6, 1], "navigator_seed1": [3, 0]}


def waiting(
    settings: RehearsalSettings, folder: Path, start: Path | None, *demonstrators: Path
) -> dict[str, tuple[str, ...]]:
    """By job of a plan, those that it waits for."""
    jobs = plan(settings, context(folder, "rehearsal"), settings.task, "bca", start, demonstrators)
    return {one.key: one.after for one in jobs}


def test_the_training_follows_the_demonstrations(tmp_path: Path) -> None:
    demonstrators = advising_policies(tmp_path, 0, Task(), GENERALIST)
    settings = job_of(tmp_path, demonstrations=6).settings
    after = waiting(settings, tmp_path, GENERALIST, *demonstrators)
    assert after["training"] == ("demonstrations",)
    none = replace(settings, demonstrations=0)
    assert waiting(none, tmp_path, GENERALIST, *demonstrators)["training"] == ()


def test_policies_whose_files_have_one_name_are_told_apart(tmp_path: Path) -> None:
    same = [tmp_path / folder / "policy.pt" for folder in ("a", "b")]
    for file in same:
        file.parent.mkdir()
        shutil.copy(GENERALIST.with_name("generalist_simmons2.pt"), file)
    job = replace(
        job_of(tmp_path, copies=1, task=replace(TINY["task"], catheter="simmons2")), demonstrators=tuple(same)
    )
    assert demonstrate(job, Report()) == {"policy": [2, 0], "policy2": [2, 0]}  # after twelve steps
    assert len(list((tmp_path / "demonstrations").iterdir())) == 4


def test_a_navigator_by_images_plays_in_the_copies(tmp_path: Path) -> None:
    navigator = GENERALIST.with_name("navigator.pt")
    job = replace(job_of(tmp_path, copies=1, demonstrations=1), demonstrators=(navigator,))
    assert demonstrate(job, Report()) == {"navigator": [2, 0]}  # twelve steps do not lead there
    files = sorted(file.name for file in (tmp_path / "demonstrations").iterdir())
    assert files == ["navigator_0_0.npz", f"navigator_{job.training_cases[1]}_0.npz"]
    assert read_demonstrations(tmp_path) == []


def test_the_sampling_expert_shows_the_way_where_none_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    task = Task(start_rotation_deg=180.0, max_steps=300, success_radius_mm=50.0)  # half way is enough
    job = job_of(tmp_path, copies=1, demonstrations=2, expert="needed", task=task)
    assert demonstrate(job, Report()) == {"expert": [2, 2]}
    shown = read_demonstrations(tmp_path)[0]
    assert shown.terminated
    assert len(shown.actions) == len(shown.rewards) == len(shown.simulation_states) - 1
    assert shown.simulation_states[0, -1] == 0  # the case
    monkeypatch.setattr("cathsim.planning.demonstration.demonstrate", None)  # nothing is played again
    assert demonstrate(job, Report()) == {"expert": [2, 2]}
    # enough is shown, so that no policy is asked
    always = replace(job.settings, expert="always", demonstrations=1)
    beginning = replace(job, settings=always, start=GENERALIST, demonstrators=(GENERALIST,))
    assert demonstrate(beginning, Report()) == {"expert": [2, 2]}
    assert train(job, Report())["decisions"] == 48  # which takes them up
    record = json.loads((tmp_path / "seed0" / "training.json").read_text())
    assert record["settings"]["demonstrations_in_replay"] == 0.25
    assert waiting(job.settings, tmp_path, None)["training"] == ("demonstrations",)
    assert waiting(replace(job.settings, expert="never"), tmp_path, None)["training"] == ()


@pytest.mark.parametrize(("arriving", "expert"), [(0, True), (1, True), (2, False)])
def test_the_expert_is_asked_where_policies_show_next_to_nothing(
    tmp_path: Path, arriving: int, expert: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of six episodes that are wanted a third is enough."""
    failed = {"terminated": np.array(False)}
    monkeypatch.setattr("cathsim.planning.demonstration.demonstrate", lambda *_, **__: failed)
    job = job_of(tmp_path, copies=5, demonstrations=6, expert="needed")
    job = replace(job, start=GENERALIST, demonstrators=(GENERALIST,))
    leave(job, "generalist", 0, [place < arriving for place in range(6)])
    leave(job, "generalist", 1, [False] * 6)
    # a turn in which nobody arrives is the last one of policies
    told = {"generalist": [12 if arriving else 6, arriving], **({"expert": [10, 0]} if expert else {})}
    assert demonstrate(job, Report()) == told


def test_the_expert_gives_up_where_it_does_not_arrive(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    failed, gentle = {"terminated": np.array(False), "actions": np.zeros((3, 2))}, list[bool]()

    def fail(*_: object, **given: Any) -> dict[str, np.ndarray]:
        gentle.append(given["gentle"])
        return failed

    monkeypatch.setattr("cathsim.planning.demonstration.demonstrate", fail)
    job = job_of(tmp_path, copies=13, demonstrations=4, expert="needed")
    assert demonstrate(job, Report()) == {"expert": [10, 0]}  # in two parts
    assert sorted(gentle) == [False] * 4 + [True] * 6
    assert read_demonstrations(tmp_path) == []


@pytest.mark.parametrize(("arriving", "told", "usual"), [(1, [29, 14], True), (3, [15, 6], False)])
def test_it_plays_as_usual_where_few_gentle_episodes_arrive(
    tmp_path: Path, arriving: int, told: list[int], usual: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of each part's copies the gentle one arrives in the first so many, the usual one in all but the first."""

    def play(_: object, case: int, *__: object, gentle: bool, **___: object) -> dict[str, np.ndarray]:
        number = case // 2  # of its part
        return {"terminated": np.array(number < arriving if gentle else number > 0)}

    monkeypatch.setattr("cathsim.planning.demonstration.demonstrate", play)
    job = job_of(tmp_path, copies=14, demonstrations=20, expert="needed")
    assert demonstrate(job, Report()) == {"expert": told}
    assert bool(list((tmp_path / "demonstrations").glob("expert_*_1.npz"))) == usual
