"""Jobs of the navigation: experts' episodes seen anew, navigators cloned and taught, and their logged trials.

A navigator's folder, ``<row>/``, draws as::

    navigator.pt  training.json
    lessons/round<k>.npz  round<k>.pt      until it is finished
    evaluation/<test>/<target>/<phantom>/NNN.mcap
"""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.episodes.errors import EpisodeReadError
from pipeline.jobs.worker import Report
from pipeline.recording.trials import Origin
from pipeline.seeds import fit_seed, further_expert_seeds, navigation_lesson_seeds
from pipeline.stages.navigation.demonstrations import episode_of_log, play, read_lessons, write_episodes
from pipeline.stages.navigation.perception import load_reader
from pipeline.stages.navigation.scene import Rig
from pipeline.stages.navigation.task import Anatomy, Rules, TrialSet, room_for, scenes_of
from pipeline.stages.navigation.trials import run_tests
from pipeline.store.atomic_files import write_json

if TYPE_CHECKING:
    from splineformer.navigation.cloning import Episode
    from splineformer.navigation.navigator import Navigator
    from splineformer.navigation.perception import Reader

Tell = Callable[[float, str], None]  # the share done, and a few words

NAVIGATOR, RECORD = "navigator.pt", "training.json"
PRELOAD = ("cathsim", "enn.policy", "splineformer.navigation.cloning", "skimage.graph", "pipeline.recording.record")
HINT_KEY = "roadmap"
_TRAINING = 0.7  # of a job's time


@dataclass(frozen=True)
class LogsJob:
    """An expert's episodes of one task to be seen through the rig.

    Attributes:
        file: for the episodes, in the order of the logs.
        reader: folder of the navigator's eye.
        rig: of the images.
        logs: of the expert's episodes; damaged ones are left out.
        count: episodes wanted; where there are fewer logs, the expert plays on.
        expert: file of its policy.
        anatomy: of the task.
        target: likewise.
        rules: likewise.
        guided: whether the navigator has a contrast run.
        space: whether it measures in space what both cameras show.
        hidden: units of the navigator, for its settings.
        action_repeat: steps for which it holds an action.
        seed: of the run: of the starts of episodes that the expert plays on.
    """

    file: Path
    reader: Path
    rig: Rig
    logs: tuple[Path, ...]
    count: int
    expert: Path
    anatomy: Anatomy
    target: str
    rules: Rules
    guided: bool
    space: bool
    hidden: int
    action_repeat: int
    seed: int


@dataclass(frozen=True)
class Course:
    """What a teacher teaches.

    Attributes:
        teacher: file of its policy.
        anatomies: in which it knows the way.
        targets: likewise.
        rules: of the episodes.
        hints: whether the navigator learns to tell the teacher's roadmap.
    """

    teacher: Path
    anatomies: tuple[Anatomy, ...]
    targets: tuple[str, ...]
    rules: Rules
    hints: bool = False


@dataclass(frozen=True)
class NavigatorJob:
    """A navigator to train and to test.

    Attributes:
        folder: of the navigator.
        reader: folder of its eye.
        rig: of the images.
        guided: whether it has a contrast run, or the target's mark alone.
        space: whether it measures in space what both cameras show.
        hidden: units.
        action_repeat: steps for which it holds an action.
        logs: files of experts' episodes to clone.
        episodes: of each file.
        epochs: of the cloning; of every round of lessons.
        updates: of the cloning, at least.
        courses: of the lessons.
        rounds: of lessons.
        lessons: episodes a round, shared among the courses.
        teacher_first: the teacher steers the first round, where there is nothing cloned before.
        targets: of the trials.
        tests: trials.
        seed: of everything.
        origin: kept in the logs.
    """

    folder: Path
    reader: Path
    rig: Rig
    guided: bool
    space: bool
    hidden: int
    action_repeat: int
    logs: tuple[Path, ...]
    episodes: int
    epochs: int
    updates: int
    courses: tuple[Course, ...]
    rounds: int
    lessons: int
    targets: tuple[str, ...]
    tests: tuple[TrialSet, ...]
    seed: int
    origin: Origin


def see_logs(job: LogsJob, report: Report) -> dict[str, Any]:
    """Reads the images of an expert's episodes once, for every navigator that is cloned from them."""
    from enn.policy import Policy
    from splineformer.navigation.navigator import Navigator

    if not job.file.is_file():
        reader = load_reader(job.reader, report.device)
        teacher = Policy.load(job.expert, report.device)
        settings = settings_of(reader, job)
        episodes: list[Episode] = []
        for log in job.logs:
            if len(episodes) == job.count:
                break
            report(len(episodes) / job.count, f"{len(episodes)} of {job.count} episodes")
            try:
                seen = episode_of_log(log, job.rules.rig(job.rig), reader, settings)
            except EpisodeReadError:
                continue
            episodes.append(seen)
        missing, begun = job.count - len(episodes), len(episodes)
        if missing:  # the expert plays on
            environments = scenes_of(
                job.rules, [(job.anatomy, job.target)] * missing, job.rig, teacher.keys,
                further_expert_seeds(job.seed, missing),
            )  # fmt: skip
            more = play(
                environments, teacher, Navigator(settings, reader), teacher_share=1.0, noise=0.0,
                generator=np.random.default_rng(0), tick=lambda done: report((begun + done) / job.count, "played on"),
            )  # fmt: skip
            episodes += more
        write_episodes(job.file, episodes)
    return {"episodes": len(read_lessons(job.file))}


def settings_of(reader: Reader, job: LogsJob | NavigatorJob, hints: int = 0) -> Any:
    """The settings of a job's navigator that sees with a reader."""
    from splineformer.navigation.navigator import NavigatorSettings

    return NavigatorSettings(
        cameras=job.rig.cameras, tokens=reader.tokens, memory=reader.memory, guided=job.guided, space=job.space,
        hidden=job.hidden, hints=hints, action_repeat=job.action_repeat,
    )  # fmt: skip


def navigate(job: NavigatorJob, report: Report) -> dict[str, Any]:
    """Trains a navigator and tests it; each part only where it lacks.

    Returns:
        How it was trained, and ``tests``: a row for each set of trials and target.
    """
    reader = load_reader(job.reader, report.device)
    told = job.folder / RECORD
    if told.is_file():
        from splineformer.navigation.navigator import Navigator

        outcome, navigator = (
            json.loads(told.read_text(encoding="utf-8")),
            Navigator.load(job.folder / NAVIGATOR, reader),
        )
    else:
        navigator, outcome = train(job, reader, report.part(0.0, _TRAINING, "training"))
        navigator.save(job.folder / NAVIGATOR, **{key: outcome[key] for key in ("episodes", "decisions")})
        write_json(told, outcome)
        shutil.rmtree(job.folder / "lessons", ignore_errors=True)
    outcome["tests"] = run_tests(
        navigator, job.tests, job.targets, job.rig, job.folder, seed=job.seed, origin=job.origin,
        report=report.part(_TRAINING, 1.0, "trials"),
    )  # fmt: skip
    return dict(outcome)


def train(job: NavigatorJob, reader: Reader, report: Tell) -> tuple[Navigator, dict[str, Any]]:
    """Clones the experts' episodes, then gives lessons round by round, going on after the last finished one."""
    from enn.policy import Policy
    from splineformer.navigation.cloning import LESSONS, CloningSettings, clone
    from splineformer.navigation.navigator import Navigator

    began, worked = time.monotonic(), time.process_time()
    device = str(reader.predictor.device)
    teachers = [Policy.load(course.teacher, device) for course in job.courses]
    room_for([anatomy for course in job.courses for anatomy in course.anatomies])
    hints = max((_hints(course, teacher) for course, teacher in zip(job.courses, teachers, strict=True)), default=0)
    settings = settings_of(reader, job, hints)
    navigator = Navigator(settings, reader, job.seed)
    episodes = [one for file in job.logs for one in read_lessons(file)[: job.episodes]]
    parts = job.rounds + bool(episodes)
    losses: list[float] = []
    if episodes:
        first = CloningSettings(epochs=job.epochs, updates=job.updates)
        passes = first.passes(len(episodes))
        losses = clone(
            navigator, episodes, first, seed=job.seed,
            progress=lambda epoch, loss: report(epoch / passes / parts, f"cloning, loss {loss:.4f}"),
        )  # fmt: skip
    cloned, rounds = len(episodes), []
    for number in range(job.rounds):
        told = _part(report, (number + bool(cloned)) / parts, 1 / parts, f"round {number + 1}")
        file = job.folder / "lessons" / f"round{number}.npz"
        kept = file.with_suffix(".pt")
        if not (file.is_file() and kept.is_file()):
            share = 1.0 if number == 0 and not cloned else 0.1
            new = _round(job, number, teachers, navigator, share, told)
            write_episodes(file, new)
            episodes += new
            epochs = job.epochs * (2 if number == job.rounds - 1 else 1)
            fit = replace(LESSONS, epochs=epochs)
            fitting = partial(_fitting, told, epochs)
            losses = clone(navigator, episodes, fit, seed=fit_seed(job.seed, number), progress=fitting)
            navigator.save(kept)
        else:
            new = read_lessons(file)
            episodes += new
            navigator = Navigator.load(kept, reader)
        rounds.append({"episodes": len(episodes), "success_pct": success_of(new)})
    outcome = {
        "episodes": len(episodes),
        "decisions": sum(len(one.looks) for one in episodes),
        "rounds": rounds,
        "loss": losses[-1] if losses else None,
        "wall_s": time.monotonic() - began,
        "cpu_s": time.process_time() - worked,
    }
    return navigator, outcome


def _part(report: Tell, begun: float, share: float, label: str) -> Tell:
    return lambda fraction, text: report(begun + share * fraction, f"{label}, {text}")


def _playing(report: Tell, before: int, wanted: int, done: int) -> None:
    report(0.5 * (before + done) / wanted, f"{before + done} of {wanted} episodes")


def _fitting(report: Tell, epochs: int, epoch: int, loss: float) -> None:
    report(0.5 + 0.5 * epoch / epochs, f"loss {loss:.3f}")


def _hints(course: Course, teacher: Any) -> int:
    return int(np.prod(teacher.observation_space[HINT_KEY].shape)) if course.hints else 0


def success_of(episodes: Sequence[Episode]) -> dict[str, float]:
    """The success in % in each target."""
    ended: dict[str, list[bool]] = {}
    for one in episodes:
        ended.setdefault(one.target, []).append(one.success)
    return {target: 100.0 * float(np.mean(successes)) for target, successes in sorted(ended.items())}


def _round(
    job: NavigatorJob,
    number: int,
    teachers: Sequence[Any],
    navigator: Navigator,
    teacher_share: float,
    report: Tell,
) -> list[Episode]:
    episodes: list[Episode] = []
    for index, (course, teacher) in enumerate(zip(job.courses, teachers, strict=True)):
        generator = np.random.default_rng((job.seed, number, index))
        count = len(range(index, job.lessons, len(job.courses)))
        cases = [(anatomy, target) for anatomy in course.anatomies for target in course.targets]
        chosen: list[tuple[Anatomy, str]] = []
        while len(chosen) < count:
            chosen += [cases[k] for k in generator.permutation(len(cases))]
        before = len(episodes)
        seeds = navigation_lesson_seeds(job.seed, number, index, count)
        scenes = scenes_of(course.rules, chosen[:count], job.rig, teacher.keys, seeds)
        episodes += play(
            scenes, teacher, navigator, teacher_share=teacher_share, noise=0.3 if teacher_share == 1.0 else 0.1,
            generator=generator, hint_key=HINT_KEY if course.hints else None,
            tick=partial(_playing, report, before, job.lessons),
        )  # fmt: skip
    return episodes
