"""Arches of the stage `unseen` that are not the usual ones: steep take-offs, and ArchVariety."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cathsim import load_phantom
from cathsim.planning import demonstration
from cathsim.planning.demonstration import demonstrate
from pipeline.anatomies.devices import set_back_mm
from pipeline.jobs.worker import Report
from pipeline.seeds import unseen_arches
from pipeline.stages.unseen import task as arches
from pipeline.stages.unseen.roadmap import AnatomiesJob, DemonstrationsJob, read_demonstrations, record_demonstrations
from pipeline.stages.unseen.stage import plan
from pipeline.stages.unseen.task import ROADMAP_KEYS, UnseenTask, training_arch
from pipeline.store.errors import ConfigurationError
from pipeline.task import Task
from tests.pipeline.stages.unseen.small_unseen import small_settings, variety


def test_arches_with_a_steep_take_off_are_chosen_in_order(monkeypatch: pytest.MonkeyPatch) -> None:
    backs = {seed: float(seed % 7) for seed in range(100)}
    monkeypatch.setattr("cathsim.load_phantom", lambda kind, seed, resolution: seed)
    monkeypatch.setattr(arches, "set_back_mm", lambda phantom, target: backs[phantom] if target == "lcca" else 0.0)
    assert arches.with_steep_take_off(range(100), ("bca", "lcca"), 5.0, 4) == [5, 6, 12, 13]
    with pytest.raises(ConfigurationError, match=r"only 2 of the arches have a target set back by 6 mm, 3 are wanted"):
        arches.with_steep_take_off(range(20), ("lcca",), 6.0, 3)


def test_steep_arches_are_trained_in_and_chosen_by(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def every_tenth(seeds: Iterable[int], targets: Sequence[str], least_mm: float, count: int, kind: str) -> list[int]:
        assert (list(targets), least_mm, kind) == (["bca", "lcca", "lsa"], 13.0, "random")
        return list(seeds)[::10][:count]

    monkeypatch.setattr("pipeline.stages.unseen.stage.with_steep_take_off", every_tenth)
    wanted = small_settings(least_set_back_mm=13.0, image=False, xray=False, curve=[], test_anatomies=5)
    jobs = {job.key: job.given for job in plan(wanted, tmp_path, 1, "desk")}
    assert jobs["roadmap"].anatomies == tuple(range(1000, 1080, 10))
    assert jobs["roadmap"].validated == tuple(range(32_000, 32_320, 20))
    assert jobs["roadmap tests"].tests[0].phantoms == tuple(unseen_arches(5))
    built = {seed for job in jobs.values() if isinstance(job, AnatomiesJob) for _, seed in job.arches}
    assert built >= {*jobs["roadmap"].anatomies, *jobs["roadmap"].validated}


def test_plan_in_arch_variety_has_all_types_and_points_of_each_arch(tmp_path: Path) -> None:
    jobs = {job.key: job for job in plan(variety(), tmp_path, 1, "smoke")}
    built = [arch for job in jobs.values() if isinstance(job.given, AnatomiesJob) for arch in job.given.arches]
    assert {kind for kind, seed in built if 32_000 <= seed < 32_006} == {
        f"arch_variety_{kind}" for kind in ("I", "II", "IV", "V", "VI", "VII")
    }
    assert {seed for _, seed in built} == {*range(1000, 1008), *range(32_000, 32_006), *unseen_arches(20)}
    assert not any(job.given.targets for job in jobs.values() if isinstance(job.given, AnatomiesJob))
    given = jobs["roadmap"].given
    assert given.task.targets == ("point_1", "point_2")
    assert (given.settings.action_repeat, given.settings.reset_bank_cases) == (2, 16)  # 0.3 s; arches times points


def test_arches_of_arch_variety_with_a_steep_point_are_found() -> None:
    chosen = arches.with_steep_take_off(range(40), ("point_1", "point_2"), 8.0, 2, "arch_variety")
    for seed in range(chosen[-1] + 1):
        kind, own = training_arch(seed, "arch_variety")
        phantom = load_phantom(kind, seed=own, resolution=1e-3)
        steep = max(set_back_mm(phantom, target) for target in ("point_1", "point_2")) >= 8.0
        assert steep == (seed in chosen)


def test_environments_of_arch_variety_have_its_pace_and_points() -> None:
    task = UnseenTask(("point_1", "point_2"), variety().task, arches="arch_variety")
    for environment in (
        task.test_environment(40_003, "point_2", "arch_variety", ("tip",)),
        task.training_environment((40_003,), ("tip",)),
    ):
        environment.reset(seed=0, options={"case": 1} if hasattr(environment, "case") else None)
        assert environment.phantom.name == "arch_variety_II_40003"
        assert environment.task.target_name == "point_2"
        assert environment.simulation.pace.interval == pytest.approx(1 / 7.5)
        assert environment.task.success_radius == pytest.approx(0.005)
        environment.close()


TASK = UnseenTask(("bca", "lcca"), Task(wire_length_mm=312.0, max_steps=24))


def test_what_is_demonstrated_is_what_the_training_reads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    environment = TASK.training_environment((0,), ROADMAP_KEYS)
    made = demonstrate(environment, 1, ROADMAP_KEYS, hold=4, seed=3)

    tries = []
    monkeypatch.setattr(
        demonstration, "demonstrate", lambda *_, **__: tries.append(1) or {**made, "terminated": np.array(True)}
    )
    job = DemonstrationsJob(tmp_path, TASK, (0,), (0,), "lcca", hold=4, seed=3)
    assert record_demonstrations(job, Report()) == {"shown": 1, "reached": 1}
    assert record_demonstrations(job, Report()) == {"shown": 1, "reached": 1}
    assert len(tries) == 1  # what is there is not made again
    (read,) = read_demonstrations(tmp_path, (0, 7))
    np.testing.assert_array_equal(read.observations["roadmap"], made["roadmap"])
    np.testing.assert_array_equal(read.simulation_states, made["states"])
    assert read_demonstrations(tmp_path, (7,)) == []


def test_failures_are_kept_but_not_learnt_from(tmp_path: Path) -> None:
    job = DemonstrationsJob(
        tmp_path, replace(TASK, task=replace(TASK.task, max_steps=8)), (0,), (0,), "bca", hold=4, seed=0
    )
    assert record_demonstrations(job, Report()) == {"shown": 1, "reached": 0}
    assert [path.name for path in tmp_path.iterdir()] == ["bca_0.npz"]
    assert read_demonstrations(tmp_path, (0,)) == []
