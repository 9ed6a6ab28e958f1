"""The jobs of the stage `unseen`: anatomies, starts and demonstrations in them, policies and their tests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

from pipeline.jobs.pool import Job
from pipeline.recording.trials import Origin
from pipeline.seeds import training_arches, unseen_arches, validation_arches
from pipeline.stages.job_memory import policy_gb
from pipeline.stages.unseen.demonstrations import (
    DEMONSTRATIONS,
    STARTS,
    DemonstrationsJob,
    StartsJob,
    lay_starts,
    record_demonstrations,
)
from pipeline.stages.unseen.image_policy import ImagePolicyJob, train_image_policy
from pipeline.stages.unseen.roadmap import (
    EVALUATIONS,
    AnatomiesJob,
    RoadmapJob,
    build_anatomies,
    policy_to_start_from,
    train_roadmap,
    training_settings,
)
from pipeline.stages.unseen.settings import UnseenSettings
from pipeline.stages.unseen.task import (
    IMAGE,
    ROADMAP,
    VARIETY,
    XRAY,
    UnseenTask,
    arch_of_test,
    training_arch,
    with_steep_take_off,
)
from pipeline.stages.unseen.trials import HeldOutSet, cluttered, misregistered, test_sets
from pipeline.task import decision_steps

_Part = TypeVar("_Part")
ROADMAP_TESTS = "roadmap tests"
DEMONSTRATED = "lcca"  # the target that is hard to find without
OF_THE_CURVE = 2  # evaluations of its trainings; policies of few anatomies fail, which takes longest
_ANATOMIES_A_JOB = 16
_PARTS = 2  # jobs that demonstrate beside each other
# guesses
_SECONDS = {"anatomy": 0.8, "starts": 1.2, "decision": 10e-3, "demonstration": 10.0, "advised": 0.6, "test": 0.4,
            "xray": 1.5}  # fmt: skip


_MOST_TRIED = 1_000  # arches, to find those with a steep take-off


@dataclass(frozen=True)
class _Run:
    """What all jobs of a run share."""

    settings: UnseenSettings
    folder: Path
    seed: int
    variant: str
    task: UnseenTask
    arches: tuple[int, ...]  # trained in
    validated: tuple[int, ...]

    def origin(self, row: str) -> Origin:
        return Origin("unseen", row, self.seed, self.variant)


def plan(settings: UnseenSettings, folder: Path, run_seed: int, variant: str) -> list[Job]:
    """The jobs in their order: anatomies, roadmap policies, and the image policies' teacher before the others."""
    task = UnseenTask(settings.learnt_targets(), settings.task, settings.accuracy, settings.arches)
    images = [XRAY] * settings.xray + [IMAGE] * settings.image
    curve = sorted({*settings.curve, settings.anatomies}) if settings.curve else []
    most = max([settings.anatomies, *curve])
    arches, validated = arches_of(settings, run_seed, max(most, settings.image_anatomies if images else 0))
    run = _Run(settings, folder, run_seed, variant, task, tuple(arches), tuple(validated))
    built = _anatomies(run)
    trains = bool(settings.decisions or curve)
    laid = _starts(run, most) if trains else []
    shown = _demonstrations(run, after=_keys(built)) if trains and DEMONSTRATED in task.targets else []
    prepared = [*built, *laid, *shown]
    teacher, tests = _roadmap(run, _keys(prepared), demonstrated=bool(shown))
    # policies by images are the longest chain of jobs: next after their teacher
    jobs = [*prepared, teacher, *(_by_images(run, row) for row in images), tests]
    for count in curve:  # the one with most arches never beside another that keeps as many in memory
        after = _keys(prepared) + ((ROADMAP, *images) if count == most else ())
        jobs.append(_of_the_curve(run, count, after, demonstrated=bool(shown)))
    return jobs


def arches_of(settings: UnseenSettings, run_seed: int, count: int) -> tuple[list[int], list[int]]:
    """The arches that are trained in, so many, and those that choose the best policy."""
    least, chosen_by = settings.least_set_back_mm, settings.validation_anatomies
    every = 1 if settings.arches == VARIETY else 2
    if not least:
        return list(training_arches(run_seed, count)), list(validation_arches(chosen_by, every))
    targets, tried = settings.learnt_targets(), _MOST_TRIED
    return (
        with_steep_take_off(training_arches(run_seed, tried), targets, least, count, settings.arches),
        with_steep_take_off(validation_arches(tried // 2, every), targets, least, chosen_by, settings.arches),
    )


def _keys(jobs: Sequence[Job]) -> tuple[str, ...]:
    return tuple(job.key for job in jobs)


def _anatomies(run: _Run) -> list[Job]:
    jobs = []
    for name, kinds in (
        ("training", [training_arch(seed, run.task.arches) for seed in run.arches]),
        ("validation", [training_arch(seed, run.task.arches) for seed in run.validated]),
        ("test", [arch_of_test(seed, run.task.arches) for seed in unseen_arches(run.settings.test_anatomies)]),
    ):
        for part in _parts(kinds):
            building = AnatomiesJob(tuple(part), run.task.kept_targets())
            weight = len(part) * _SECONDS["anatomy"]
            jobs.append(Job(f"{name}/{part[0][1]}", build_anatomies, building, weight=weight))
    return jobs


def _starts(run: _Run, arches: int) -> list[Job]:
    """Those in the first arches of the training."""
    jobs = []
    for part in _parts(run.arches[:arches]):
        given = StartsJob(run.folder / STARTS, run.task, tuple(part), run.seed)
        weight = len(part) * _SECONDS["starts"]
        jobs.append(Job(f"{STARTS}/{part[0]}", lay_starts, given, after=(f"training/{part[0]}",), weight=weight))
    return jobs


def _demonstrations(run: _Run, after: tuple[str, ...]) -> list[Job]:
    """The jobs that demonstrate the way in the first training anatomies, so that small policies have some too."""
    anatomies = run.arches[: run.settings.anatomies]
    shown = anatomies[: run.settings.demonstrations]
    jobs = []
    for part in range(min(_PARTS, len(shown))):
        given = DemonstrationsJob(
            folder=run.folder / DEMONSTRATIONS,
            task=run.task,
            anatomies=anatomies,
            shown=shown[part::_PARTS],
            target=DEMONSTRATED,
            hold=decision_steps(run.task.task),
            seed=run.seed,
        )
        weight = len(given.shown) * _SECONDS["demonstration"]
        jobs.append(Job(f"{DEMONSTRATIONS}/{part}", record_demonstrations, given, after=after, weight=weight))
    return jobs


def _roadmap(run: _Run, after: tuple[str, ...], *, demonstrated: bool) -> list[Job]:
    """The main policy, and its tests as a job of their own, so that the image policies need not wait for them."""
    settings = run.settings
    start, training = policy_to_start_from(settings), None
    if settings.decisions:
        training = training_settings(settings, settings.anatomies, settings.decisions, EVALUATIONS, start)
    given = RoadmapJob(
        folder=run.folder,
        origin=run.origin(ROADMAP),
        task=run.task,
        anatomies=run.arches[: settings.anatomies],
        tests=(*test_sets(settings), *misregistered(settings)),
        settings=training,
        start=None if settings.policy is None else Path(settings.policy),
        validated=run.validated,
        demonstrated=demonstrated,
    )
    untested, gpu_gb = replace(given, tests=()), policy_gb(settings.task.image_size_px, 0)
    weight, tests = settings.decisions * _SECONDS["decision"], _seconds_of(given.tests, settings)
    return [
        Job(ROADMAP, train_roadmap, untested, after=after, weight=weight, gpu_gb=gpu_gb),
        Job(ROADMAP_TESTS, train_roadmap, given, after=(ROADMAP,), weight=tests, gpu_gb=gpu_gb),
    ]


def _of_the_curve(run: _Run, count: int, after: tuple[str, ...], *, demonstrated: bool) -> Job:
    """A policy of so many arches; all of the curve have equally many decisions."""
    settings, row = run.settings, f"{ROADMAP} {count}"
    given = RoadmapJob(
        folder=run.folder,
        origin=run.origin(row),
        task=run.task,
        anatomies=run.arches[:count],
        tests=(replace(test_sets(settings)[0], modes=("deterministic",)),),
        settings=training_settings(settings, count, settings.curve_decisions, OF_THE_CURVE),
        validated=run.validated,
        demonstrated=demonstrated,
    )
    weight = settings.curve_decisions * _SECONDS["decision"] + _seconds_of(given.tests, settings)
    return Job(row, train_roadmap, given, after=after, weight=weight, gpu_gb=policy_gb(settings.task.image_size_px, 0))


def _by_images(run: _Run, row: str) -> Job:
    settings = run.settings
    among = cluttered(settings) if row == XRAY else ()
    given = ImagePolicyJob(
        folder=run.folder,
        origin=run.origin(row),
        task=run.task,
        anatomies=run.arches[: settings.image_anatomies],
        tests=tuple(replace(test, modes=("deterministic",)) for test in (*test_sets(settings), *among)),
        settings=settings,
    )
    weight = settings.rounds * settings.advised_episodes * _SECONDS["xray" if given.xray else "advised"]
    weight += _seconds_of(given.tests, settings)
    gpu_gb = policy_gb(settings.task.image_size_px, 1)
    return Job(row, train_image_policy, given, after=(ROADMAP,), weight=weight, gpu_gb=gpu_gb)


def _parts(whole: Sequence[_Part]) -> list[Sequence[_Part]]:
    return [whole[k : k + _ANATOMIES_A_JOB] for k in range(0, len(whole), _ANATOMIES_A_JOB)]


def _seconds_of(tests: Sequence[HeldOutSet], settings: UnseenSettings) -> float:
    episodes = sum(len(test.phantoms) * test.episodes * len(test.modes) for test in tests)
    return episodes * len(settings.learnt_targets()) * _SECONDS["test"]
