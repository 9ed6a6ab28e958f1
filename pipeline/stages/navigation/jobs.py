"""Jobs of the navigation: experts' logged episodes as the navigator sees them, and navigators, trained and tested.

A navigator's folder, ``<row>/``, draws as::

    navigator.pt  training.json
    advised_episodes/                      until it is finished
    evaluation/<test>/<target>/<phantom>/NNN.mcap
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from enn.curves import Curves
from enn.imitation.advised_rounds import forget_rounds, last_policy, read_episodes, teach, write_episodes
from pipeline.episodes.records import EpisodeReadError
from pipeline.jobs.worker import Report
from pipeline.recording.trials import Origin
from pipeline.seeds import further_expert_seeds, navigation_episode_seeds
from pipeline.stages.navigation.perception import load_perception
from pipeline.stages.navigation.scene import (
    NAMED,
    Anatomy,
    TrialSet,
    episode_of_log,
    episode_starts,
    in_view,
    run_tests,
)
from pipeline.stages.navigation.settings import NavigationSettings
from pipeline.store.atomic_files import read_json, write_json
from pipeline.store.errors import StageError
from pipeline.task import Task

if TYPE_CHECKING:
    from cathsim.observations.c_arm_view import CArms
    from enn.imitation.recurrent_policy import RecurrentPolicy
    from enn.imitation.sequence_cloning import AdvisedEpisode
    from enn.policy import Policy
    from splineformer.navigation.navigator_perception import NavigatorPerception
    from splineformer.navigation.perception import PerceptionNetwork

Tell = Callable[[float, str], None]  # the share done, and a few words

NAVIGATOR, RECORD, LOGS = "navigator.pt", "training.json", "episodes"
HINT_KEY = "roadmap"
_TRAINING = 0.7  # of a job's time


@dataclass(frozen=True)
class LogsJob:
    """An expert's episodes of one task to be seen by the C-arms."""

    folder: Path
    settings: NavigationSettings
    phantom: str
    target: str
    logs: tuple[Path, ...]  # of the expert's episodes; damaged ones are left out
    expert: Path  # file of its policy, which plays on where there are fewer logs than the settings ask for
    seed: int

    @property
    def file(self) -> Path:
        """For the episodes, in the order of the logs."""
        return self.folder / LOGS / self.phantom / f"{self.target}.npz"


@dataclass(frozen=True)
class Course:
    """What a teacher teaches."""

    teacher: Path
    anatomies: tuple[Anatomy, ...]  # in which it knows the way
    targets: tuple[str, ...]  # to which it knows the way
    task: Task
    hints: bool = False  # whether the navigator learns to predict the teacher's roadmap
    clutter: float = 0.0  # in the images of every second anatomy


@dataclass(frozen=True)
class NavigatorJob:
    """A navigator to train and to test."""

    folder: Path
    settings: NavigationSettings
    origin: Origin  # kept in the logs; its row names the navigator's folder, its seed is that of everything
    tests: tuple[TrialSet, ...]
    hidden: int  # units
    epochs: int  # of the cloning; of every round of advised episodes
    logs: tuple[Path, ...] = ()  # files of experts' episodes to clone
    episodes: int = 0
    courses: tuple[Course, ...] = ()
    rounds: int = 0
    round_episodes: int = 0  # episodes a round, shared among the courses

    @property
    def own_folder(self) -> Path:
        return self.folder / self.origin.row


def perception_of(network: PerceptionNetwork, settings: NavigationSettings) -> NavigatorPerception:
    """The perception of the stage's navigators."""
    from splineformer.navigation.navigator_perception import NavigatorPerception, NavigatorPerceptionSettings

    cameras = tuple(settings.cameras)
    return NavigatorPerception(
        NavigatorPerceptionSettings(cameras, network.tokens, network.encoded, settings.guided, settings.in_space),
        network,
    )


def navigator_on(
    perception: NavigatorPerception, settings: NavigationSettings, hidden: int, hints: int = 0, seed: int = 0
) -> RecurrentPolicy:
    """A navigator with fresh weights."""
    from enn.imitation.recurrent_policy import RecurrentPolicy, RecurrentPolicySettings

    of_policy = RecurrentPolicySettings(
        features=perception.settings.size, encoder_blocks=perception.settings.encoder_blocks, hidden=hidden,
        hints=hints, action_repeat=settings.action_repeat,
    )  # fmt: skip
    return RecurrentPolicy(of_policy, seed, perception.network.predictor.device, asdict(perception.settings))


def load_navigator(path: Path, network: PerceptionNetwork) -> tuple[RecurrentPolicy, NavigatorPerception]:
    """Reads a navigator and its perception by a network; a ValueError where it is damaged, or another network's."""
    from enn.imitation.recurrent_policy import RecurrentPolicy
    from splineformer.navigation.navigator_perception import NavigatorPerception, NavigatorPerceptionSettings

    policy = RecurrentPolicy.load(path, network.predictor.device)
    return policy, NavigatorPerception(NavigatorPerceptionSettings(**policy.perception), network)


def see_logs(job: LogsJob, report: Report) -> dict[str, Any]:
    """Reads the images of an expert's episodes once, for every navigator that is cloned from them."""
    from enn.imitation.advised_episodes import play_advised
    from enn.policy import Policy

    if job.file.is_file():
        return {"episodes": len(read_episodes(job.file))}
    settings, count = job.settings, job.settings.episodes[-1]
    perception = perception_of(load_perception(job.folder, report.device), settings)
    teacher = Policy.load(job.expert, report.device)
    episodes: list[AdvisedEpisode] = []
    for log in job.logs:
        if len(episodes) == count:
            break
        report(len(episodes) / count, f"{len(episodes)} of {count} episodes")
        try:
            seen = episode_of_log(log, settings.arms_for(settings.task), perception, settings.action_repeat)
        except EpisodeReadError:
            continue
        episodes.append(seen)
    missing, begun = count - len(episodes), len(episodes)
    if missing:  # the expert plays on
        cases = [((settings.anatomy(job.phantom), NAMED), job.target)] * missing
        seeds = further_expert_seeds(job.seed, missing)
        starts = episode_starts(
            settings.task, cases, seeds, settings.arms, teacher.keys, perception.settings, settings.action_repeat
        )
        episodes += play_advised(
            starts, teacher, navigator_on(perception, settings, settings.hidden), perception, teacher_share=1.0,
            generator=np.random.default_rng(0), tick=lambda done: report((begun + done) / count, "played on"),
        )  # fmt: skip
    write_episodes(job.file, episodes)
    return {"episodes": len(episodes)}


def navigate(job: NavigatorJob, report: Report) -> dict[str, Any]:
    """Trains a navigator and tests it, each where it lacks: how it was trained, ``tests``, a row a set and target."""
    network = load_perception(job.folder, report.device)
    record, file = job.own_folder / RECORD, job.own_folder / NAVIGATOR
    if record.is_file():
        outcome = read_json(record)
        policy, perception = load_navigator(file, network)
    else:
        perception = perception_of(network, job.settings)
        policy, outcome = train(job, perception, report.part(0.0, _TRAINING, "training"))
        policy.save(file, **{key: outcome[key] for key in ("episodes", "decisions")})
        write_json(record, outcome)
        forget_rounds(job.own_folder)
    outcome["tests"] = run_tests(
        policy, perception, job.tests, job.settings, job.own_folder, job.origin,
        report=report.part(_TRAINING, 1.0, "trials"),
    )  # fmt: skip
    return dict(outcome)


def train(job: NavigatorJob, perception: NavigatorPerception, report: Tell) -> tuple[RecurrentPolicy, dict[str, Any]]:
    """Clones the experts' episodes, then teaches round by round, going on after the last finished one."""
    from cathsim.many_anatomies import SHELF
    from enn.imitation.recurrent_policy import RecurrentPolicy
    from enn.imitation.sequence_cloning import SequenceCloningSettings, clone_sequences
    from enn.policy import Policy

    began, worked = time.monotonic(), time.process_time()
    device, seed = perception.network.predictor.device, job.origin.training_seed
    teachers = [Policy.load(course.teacher, str(device)) for course in job.courses]
    anatomies = {anatomy for course in job.courses for anatomy in course.anatomies}
    SHELF.capacity = max(SHELF.capacity, len(anatomies))  # all take turns
    hints = max((_hints(course, teacher) for course, teacher in zip(job.courses, teachers, strict=True)), default=0)
    episodes = [one for file in job.logs for one in read_episodes(file)[: job.episodes]]
    cloned = 1 / (1 + job.rounds) if episodes else 0.0  # of the time
    last, losses = last_policy(job.own_folder), []
    if last is not None:
        policy = RecurrentPolicy.load(last, device)
    else:
        policy = navigator_on(perception, job.settings, job.hidden, hints, seed)
        if episodes:
            cloning = SequenceCloningSettings(
                epochs=job.epochs, updates=job.settings.updates, batch_size=8, weight_decay=1e-3, noise=0.05
            )
            passes = cloning.passes(len(episodes))

            def report_loss(epoch: int, loss: float) -> None:
                curves.add(epoch, "cloning", loss=loss)
                report(cloned * epoch / passes, f"cloning, loss {loss:.4f}")

            with Curves(job.own_folder) as curves:
                losses = clone_sequences(policy, episodes, cloning, seed=seed, progress=report_loss)
    # a teacher knows more than the images show: to predict its roadmap teaches more than its actions alone
    advised = SequenceCloningSettings(epochs=job.epochs, batch_size=16, weight_decay=0.1, noise=0.15, hint_weight=10.0)
    before = len(episodes)

    def taught(share: float, text: str) -> None:
        report(cloned + (1 - cloned) * share, text)

    done = teach(
        job.own_folder, policy, episodes, partial(_play, job, teachers, policy, perception, taught), advised,
        rounds=job.rounds, seed=seed, began=began, report=taught,
    )  # fmt: skip
    rounds, loss = [], losses[-1] if losses else None
    for one in done:
        before, loss = before + len(one.new), one.loss
        rounds.append({"episodes": before, "success_pct": success_of(one.new)})
    outcome = {
        "episodes": len(episodes),
        "decisions": sum(len(one.features) for one in episodes),
        "rounds": rounds,
        "loss": loss,
        "wall_s": time.monotonic() - began,
        "cpu_s": time.process_time() - worked,
    }
    return policy, outcome


def _hints(course: Course, teacher: Any) -> int:
    return int(np.prod(teacher.observation_space[HINT_KEY].shape)) if course.hints else 0


def success_of(episodes: Sequence[AdvisedEpisode]) -> dict[str, float]:
    """The success in % in each target."""
    ended: dict[str, list[bool]] = {}
    for one in episodes:
        ended.setdefault(one.target, []).append(one.success)
    return {target: 100.0 * float(np.mean(successes)) for target, successes in sorted(ended.items())}


def cases_in_view(course: Course, count: int, arms: CArms, generator: np.random.Generator) -> list[tuple[Anatomy, str]]:
    """Anatomies and targets of so many episodes, all as often; without targets that a camera does not see."""
    cases = [(anatomy, target) for anatomy in course.anatomies for target in course.targets]
    chosen: list[tuple[Anatomy, str]] = []
    while len(chosen) < count:
        before = len(chosen)
        for k in generator.permutation(len(cases)):
            anatomy, target = cases[k]
            if len(chosen) < count and in_view(anatomy, target, arms):
                chosen.append((anatomy, target))
        if len(chosen) == before:
            raise StageError(
                "the C-arms see no target in any of the anatomies to learn in; choose other stage.cameras."
            )
    return chosen


def _play(
    job: NavigatorJob,
    teachers: Sequence[Policy],
    policy: RecurrentPolicy,
    perception: NavigatorPerception,
    report: Tell,
    number: int,
    teacher_share: float,
    noise: float,
) -> list[AdvisedEpisode]:
    """The episodes of a round, course by course."""
    from enn.imitation.advised_episodes import play_advised

    episodes: list[AdvisedEpisode] = []
    seed, total = job.origin.training_seed, job.round_episodes
    for index, (course, teacher) in enumerate(zip(job.courses, teachers, strict=True)):
        generator = np.random.default_rng((seed, number, index))
        count = len(range(index, total, len(job.courses)))
        chosen = cases_in_view(course, count, job.settings.arms, generator)

        def tick(finished: int, before: int = len(episodes)) -> None:
            done = before + finished
            report((number + 0.5 * done / total) / job.rounds, f"round {number + 1}, {done} of {total} episodes")

        seeds = navigation_episode_seeds(seed, number, index, count)
        starts = episode_starts(
            course.task, chosen, seeds, job.settings.arms, teacher.keys, perception.settings,
            job.settings.action_repeat, dict.fromkeys(course.anatomies[1::2], course.clutter),
        )  # fmt: skip
        episodes += play_advised(
            starts, teacher, policy, perception, teacher_share=teacher_share, noise=noise, generator=generator,
            hint_key=HINT_KEY if course.hints else None, tick=tick,
        )  # fmt: skip
    return episodes
