"""The navigation stage: navigators on SplineFormer's memory and tokens, from images alone, beside their rivals."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pipeline.jobs.gpu_memory import LEARNT_BATCH, network_gb, policy_gb
from pipeline.jobs.pool import Job, run_jobs
from pipeline.recording.human import FOLDER as HUMAN
from pipeline.recording.human import SUFFIX
from pipeline.recording.trials import Origin
from pipeline.report.aids import navigation_note
from pipeline.report.results import write_figures, write_notes, write_results
from pipeline.seeds import reader_arches, training_arches, unseen_arches
from pipeline.stages import Stage, StageContext
from pipeline.stages.learning.expert_episodes import (
    POLICY,
    expert_folder,
    expert_logs,
    load_policy,
    read_episodes,
    require_expert,
)
from pipeline.stages.learning.imitation import ImitationJob, cloning_settings, imitate
from pipeline.stages.learning.task import LearningTask
from pipeline.stages.navigation.film import FilmJob, film_trials
from pipeline.stages.navigation.jobs import PRELOAD, Course, LogsJob, NavigatorJob, navigate, see_logs
from pipeline.stages.navigation.perception import ReaderJob, train_reader
from pipeline.stages.navigation.scene import Rig
from pipeline.stages.navigation.settings import NavigationSettings
from pipeline.stages.navigation.tables import ARCHES, DAGGER, FILMS, LOGS, PIXELS, READER, figures, row_of, tables
from pipeline.stages.navigation.task import Anatomy, Rules, TrialSet
from pipeline.stages.networks.training import PREDICTOR
from pipeline.stages.phantoms import require_known_phantoms, require_known_targets
from pipeline.stages.unseen.task import TEST_PHANTOM, training_arch
from pipeline.store.errors import StageError
from pipeline.store.provenance import hash_file
from pipeline.task import TASK, require_feeder, require_known_task, require_same_task, task_from

UNSEEN = "unseen_arches"
RIVAL_VARIANT = "desk"  # network of the rival that clones pixels, whatever the budget: the thesis prints none for it
NAMED = -1  # seed of an anatomy that has a name of its own
_SECONDS = {"frame": 0.06, "episode": 1.2, "lesson": 2.4, "trial": 2.0}  # guesses, for the estimate of the end


def check_navigation(settings: NavigationSettings) -> None:
    """Refuses unknown phantoms and targets.

    Raises:
        ConfigurationError: listing the valid names.
    """
    require_known_phantoms([*settings.phantoms, *settings.transfer_phantoms])
    require_known_targets(settings.targets)
    for task in (settings.task, settings.arch_task):
        require_known_task(task)
        require_feeder(task, "navigation")


def run_navigation(settings: NavigationSettings, context: StageContext) -> None:
    """Trains and tests every navigator and sums them up.

    Args:
        settings: of the stage.
        context: where experts, teachers and the SplineFormer lie, and where to write.
    """
    jobs = plan(settings, context)
    outcomes = run_jobs(
        context.folder, jobs, workers=settings.workers, label="navigators", preload=PRELOAD, device=settings.device
    )
    write_results(context.path, tables(settings, context, outcomes))
    navigators = [job.given for job in jobs if isinstance(job.given, NavigatorJob)]
    write_notes(context.path, {"navigation": navigation_note(navigators)})
    write_figures(context.path, figures(settings, context.path, outcomes))


def rig_of(settings: NavigationSettings) -> Rig:
    """The cameras of the settings."""
    return Rig(tuple(settings.cameras), settings.image_size_px)


def plan(settings: NavigationSettings, context: StageContext) -> list[Job]:
    """The jobs: the eye, the experts' episodes seen through it, navigators, rivals, films.

    Args:
        settings: of the stage.
        context: likewise.

    Raises:
        StageError: an earlier stage left no expert, no episodes or no teacher.
    """
    path, rig, seed = context.path, rig_of(settings), context.seed
    rules = Rules(settings.task)
    jobs = [_reader(settings, context, rig)]
    reading = network_gb(settings.splineformer, "desk")
    seen: list[Job] = []
    courses: list[Course] = []
    rivals: list[Job] = []
    for phantom in settings.phantoms:
        for target in settings.targets:
            learnt = LearningTask(phantom, target, settings.task)
            task = learnt.name
            expert = expert_folder(context.inputs["enn"], task, settings.expert)
            logs = expert_logs(expert)
            read_episodes(logs, 1)  # an empty folder is told before any work
            require_expert("navigation", learnt, expert)
            given = LogsJob(
                file=path / LOGS / phantom / f"{target}.npz", reader=path / READER, rig=rig, logs=tuple(logs),
                count=settings.episodes[-1], expert=expert / POLICY, anatomy=(phantom, NAMED), target=target,
                rules=rules, guided=settings.guided, space=settings.in_space, hidden=settings.hidden,
                action_repeat=settings.action_repeat, seed=seed,
            )  # fmt: skip
            weight = settings.episodes[-1] * _SECONDS["episode"]
            seen.append(Job(f"{LOGS}/{task}", see_logs, given, after=(READER,), weight=weight, gpu_gb=reading))
            courses.append(Course(expert / POLICY, ((phantom, NAMED),), (target,), rules))
            if settings.pixel_cloning:
                rivals.append(_rival(settings, context, learnt, expert))
    files, after = tuple(job.given.file for job in seen), tuple(job.key for job in seen)
    tests = trial_sets(settings)
    navigators: list[Job] = []

    def navigator(row: str, after: tuple[str, ...], weight: float, tests: tuple[TrialSet, ...], **given: Any) -> None:
        job = NavigatorJob(
            folder=path / row, reader=path / READER, rig=rig, guided=settings.guided, space=settings.in_space,
            action_repeat=settings.action_repeat, updates=settings.updates, targets=tuple(settings.targets),
            tests=tests, seed=seed, origin=Origin("navigation", row, seed, context.budget),
            **{"hidden": settings.hidden, "logs": (), "episodes": 0, "courses": (), "rounds": 0, "lessons": 0, **given},
        )  # fmt: skip
        trials = sum(len(test.anatomies) * test.trials for test in tests) * len(settings.targets)
        navigators.append(
            Job(row, navigate, job, after=after, weight=weight + trials * _SECONDS["trial"], gpu_gb=reading)
        )

    learnt_in = tuple(test for test in tests if test.name in settings.phantoms)
    named = tuple(test for test in tests if test.name != UNSEEN)
    for number, count in enumerate(settings.episodes):
        navigator(
            row_of(settings, count),
            after,
            count,
            learnt_in if number else named,
            logs=files,
            episodes=count,
            epochs=settings.epochs,
        )
    if settings.dagger_rounds:
        weight = settings.dagger_rounds * settings.dagger_lessons * _SECONDS["lesson"]
        navigator(
            DAGGER, after, weight, tests, logs=files, episodes=settings.episodes[0], epochs=settings.dagger_epochs,
            courses=tuple(courses), rounds=settings.dagger_rounds, lessons=settings.dagger_lessons,
        )  # fmt: skip
    if settings.arches:
        weight = settings.arch_rounds * settings.arch_lessons * _SECONDS["lesson"]
        navigator(
            ARCHES, (READER,), weight, tests, epochs=settings.arch_epochs, courses=(_arches(settings, context),),
            rounds=settings.arch_rounds, lessons=settings.arch_lessons, hidden=settings.arch_hidden,
        )  # fmt: skip
    longest = [job for job in navigators if job.key == ARCHES]  # goes first, beside the experts' episodes
    jobs += [*longest, *seen, *(job for job in navigators if job.key != ARCHES), *rivals]
    if settings.film:
        order = [ARCHES, DAGGER, *(row_of(settings, count) for count in reversed(settings.episodes))]
        rows = [job.key for job in navigators]
        shown = tuple(path / row for row in order if row in rows)
        filmed = FilmJob(path / FILMS, path / READER, rig, shown, tests, tuple(settings.targets),
                         Origin("navigation", FILMS, seed, context.budget))  # fmt: skip
        jobs.append(Job(FILMS, film_trials, filmed, after=tuple(rows), weight=10.0, gpu_gb=reading))
    return jobs


def _reader(settings: NavigationSettings, context: StageContext, rig: Rig) -> Job:
    arches = [training_arch(seed) for seed in reader_arches(context.seed, settings.reader_arches)]
    variant = settings.splineformer
    given = ReaderJob(
        folder=context.path / READER,
        splineformer=context.inputs["splineformer"] / variant / PREDICTOR,
        variant=variant,
        rig=rig,
        anatomies=(*((name, NAMED) for name in settings.phantoms), *arches),
        frames=settings.reader_frames,
        epochs=settings.reader_epochs,
        targets=("bca", "lcca", "lsa"),
        seed=context.seed,
        teacher=_teacher(settings, context) if settings.arches else None,
        taught=tuple(settings.targets),
        rules=Rules(settings.arch_task),
        named=Rules(settings.task),
    )
    frames = len(given.anatomies) * settings.reader_frames
    return Job(
        READER,
        train_reader,
        given,
        weight=frames * (1 + settings.reader_epochs) * _SECONDS["frame"],
        gpu_gb=network_gb(variant, "desk"),
    )


def _rival(settings: NavigationSettings, context: StageContext, task: LearningTask, expert: Path) -> Job:
    """Behaviour cloning from pixels, from as many expert trials as the first navigator has."""
    given = ImitationJob(
        folder=context.path / PIXELS / task.name,
        origin=Origin("navigation", PIXELS, context.seed, RIVAL_VARIANT),
        settings=cloning_settings(RIVAL_VARIANT, ("image",), feature_matching=0.0),
        task=task,
        expert=expert,
        episodes=settings.episodes[0],
        evaluation_episodes=settings.trials,
    )
    return Job(
        f"{PIXELS}/{task.name}",
        imitate,
        given,
        weight=20.0,
        gpu_gb=policy_gb(settings.task.image_size_px, 1, LEARNT_BATCH),
    )


def _arches(settings: NavigationSettings, context: StageContext) -> Course:
    anatomies = tuple(training_arch(seed) for seed in training_arches(context.seed, settings.arches))
    teacher, rules = _teacher(settings, context), Rules(settings.arch_task)
    return Course(teacher, anatomies, tuple(settings.targets), rules, hints=True)


def _teacher(settings: NavigationSettings, context: StageContext) -> Path:
    """The roadmap policy of the stage unseen, which must know the task in random arches."""
    teacher = context.inputs["unseen"] / "roadmap" / f"seed{context.seed}" / POLICY
    if not teacher.is_file():
        raise StageError(f"there is no teacher {teacher}: run stage=unseen with this seed, or set stage.arches=0")
    told = task_from(load_policy(teacher, "unseen").metadata.get(TASK))
    if told is None:
        raise StageError(f"{teacher} does not say what task it was trained for: run stage=unseen again")
    require_same_task("navigation", settings.arch_task, told, "the teacher in random arches", "unseen")
    return teacher


def trial_sets(settings: NavigationSettings) -> tuple[TrialSet, ...]:
    """The trials: in the phantoms learnt in, in others, in random arches that nothing was trained in.

    Args:
        settings: of the stage.
    """
    tests = [
        TrialSet(name, ((name, NAMED),), settings.trials, Rules(settings.task))
        for name in (*settings.phantoms, *settings.transfer_phantoms)
    ]
    unseen: tuple[Anatomy, ...] = tuple((TEST_PHANTOM, arch) for arch in unseen_arches(settings.test_arches))
    return (*tests, *([TrialSet(UNSEEN, unseen, 1, Rules(settings.arch_task))] if unseen else []))


def _recordings(run_path: Path) -> dict[str, str]:
    logs: Sequence[Path] = sorted((run_path / HUMAN).rglob(f"*{SUFFIX}"))
    return {f"{HUMAN}/{path.relative_to(run_path).as_posix()}": hash_file(path) for path in logs}


STAGE = Stage(
    settings=NavigationSettings,
    run=run_navigation,
    reads=("expert", "enn", "unseen", "splineformer"),
    writes=(
        "reader/{predictor.pt, reader.json}",
        "episodes/<phantom>/<target>.npz",
        "<row>/{navigator.pt, training.json}",
        "<row>/evaluation/<test>/<target>/<phantom>/NNN.mcap",
        "behaviour_cloning/<phantom>/<target>/{policy.pt, evaluation}",
        "films/{success, failure}.{gif, mcap}",
        "curve.png, failures.png",
        "results.json",
        "notes.json",
        "figures.json",
    ),
    check=check_navigation,
    further_inputs=_recordings,
    place=14,
)
