"""The navigation stage: navigators on SplineFormer's features and tokens, from images alone, beside their rivals."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pipeline.anatomies.settings import check_anatomies, require_known_phantoms, require_known_targets, settle
from pipeline.jobs.pool import Job, run_jobs
from pipeline.jobs.worker import POLICIES
from pipeline.recording.trials import POLICY, Origin
from pipeline.seeds import perception_arches, training_arches, unseen_arches
from pipeline.stages import Stage, StageContext
from pipeline.stages.imitation import ImitationJob, imitate
from pipeline.stages.job_memory import LEARNT_BATCH, network_gb, policy_gb
from pipeline.stages.learning.aids import note, of_navigator
from pipeline.stages.learning.expert_episodes import (
    expert_folder,
    expert_logs,
    load_policy,
    read_episodes,
    require_expert,
)
from pipeline.stages.learning.task import LearningTask
from pipeline.stages.navigation.jobs import LOGS, Course, LogsJob, NavigatorJob, navigate, see_logs
from pipeline.stages.navigation.perception import PERCEPTION, PerceptionJob, fine_tune_perception
from pipeline.stages.navigation.scene import NAMED, Anatomy, TrialSet
from pipeline.stages.navigation.settings import NavigationSettings
from pipeline.stages.navigation.tables import (
    ARCHES,
    DAGGER,
    FILMS,
    PIXELS,
    FilmJob,
    figures,
    film_trials,
    row_of,
    tables,
)
from pipeline.stages.networks.training import PREDICTOR
from pipeline.stages.unseen.task import TEST_PHANTOM, training_arch
from pipeline.stages.user_study import recordings
from pipeline.store.errors import ConfigurationError, StageError
from pipeline.tables import Results
from pipeline.task import MOTION, TASK, require_feeder, require_known_task, require_same_task, task_from

UNSEEN, CLUTTERED = "unseen_arches", "unseen_arches_clutter"
RIVAL_VARIANT = "desk"  # network of the rival that clones pixels, whatever the budget: the thesis prints none for it
RIVAL_EPOCHS = 20  # passes, twice the variant's own: the rival is not the one with the shorter fit


def check_navigation(settings: NavigationSettings) -> None:
    """Refuses unknown phantoms and targets."""
    require_known_phantoms(settings.transfer_phantoms)
    check_anatomies(settings)
    if settings.arches or settings.test_arches:
        require_known_targets(settings.targets)
    if settings.transfer_phantoms:
        require_known_targets(settings.targets, settings.transfer_phantoms)
    for task in (settings.task, settings.arch_task):
        require_known_task(task)
        require_feeder(task, "navigation")
        if task.catheter is not None:
            raise ConfigurationError(
                f"stage navigation steers a wire without a catheter, got {TASK}.catheter={task.catheter}: leave it out"
            )


def run_navigation(settings: NavigationSettings, context: StageContext) -> Results:
    jobs = plan(settings, context)
    preload = (*POLICIES, "splineformer.navigation.navigator_perception", "skimage.graph")
    outcomes = run_jobs(
        context.folder, jobs, workers=settings.workers, label="navigators", preload=preload, device=settings.device
    )
    notes = {"navigation": note((job.given for job in jobs if isinstance(job.given, NavigatorJob)), of_navigator)}
    return Results(tables(settings, context, outcomes), figures(outcomes), notes)


def plan(settings: NavigationSettings, context: StageContext) -> list[Job]:
    """The jobs: the perception network, the experts' episodes seen through it, navigators, rivals, films."""
    reading_gb = network_gb(settings.splineformer, "desk")
    seen: list[Job] = []
    courses: list[Course] = []
    rivals: list[Job] = []
    for phantom in settings.phantoms:
        for target in settings.targets:
            learnt = LearningTask(phantom, target, settings.task, settings.anatomy_file)
            expert = expert_folder(context.inputs["enn"], learnt.name, settings.expert)
            logs = expert_logs(expert)
            read_episodes(logs, 1)  # an empty folder is refused before any work
            require_expert("navigation", learnt, expert)
            logs_job = LogsJob(context.path, settings, phantom, target, tuple(logs), expert / POLICY, context.seed)
            key = f"{LOGS}/{learnt.name}"
            seen.append(Job(key, see_logs, logs_job, after=(PERCEPTION,), gpu_gb=reading_gb))
            courses.append(Course(expert / POLICY, ((settings.anatomy(phantom), NAMED),), (target,), settings.task))
            if settings.pixel_cloning:
                rivals.append(_rival(settings, context, learnt, expert))
    files, after, tests = tuple(job.given.file for job in seen), tuple(job.key for job in seen), trial_sets(settings)
    navigators: list[Job] = []

    def navigator(row: str, after: tuple[str, ...], tests: tuple[TrialSet, ...], epochs: int, **fields: Any) -> None:
        origin = Origin("navigation", row, context.seed, context.budget)
        job_fields: dict[str, Any] = {"hidden": settings.hidden, **fields}
        job = NavigatorJob(context.path, settings, origin, tests, epochs=epochs, **job_fields)
        navigators.append(Job(row, navigate, job, after=after, gpu_gb=reading_gb))

    if settings.arches:  # takes longest: goes first, beside the experts' episodes
        rounds, count = settings.arch_rounds, settings.arch_episodes
        navigator(
            ARCHES, (PERCEPTION,), (*tests, *cluttered(settings)), settings.arch_epochs,
            courses=(_arches(settings, context),), rounds=rounds, round_episodes=count, hidden=settings.arch_hidden,
        )  # fmt: skip
    first = len(navigators)
    learnt_in = tuple(test for test in tests if test.name in settings.phantoms)
    named = tuple(test for test in tests if test.name != UNSEEN)
    for number, count in enumerate(settings.episodes):
        test_sets = learnt_in if number else named
        navigator(row_of(settings, count), after, test_sets, settings.epochs, logs=files, episodes=count)
    if settings.dagger_rounds:
        rounds, count = settings.dagger_rounds, settings.dagger_episodes
        navigator(
            DAGGER, after, tests, settings.dagger_epochs, logs=files, episodes=settings.episodes[0],
            courses=tuple(courses), rounds=rounds, round_episodes=count,
        )  # fmt: skip
    jobs = [_perception(settings, context, reading_gb), *navigators[:first], *seen, *navigators[first:], *rivals]
    if settings.film:
        rows = [job.key for job in navigators]
        order = [ARCHES, DAGGER, *(row_of(settings, count) for count in reversed(settings.episodes))]
        film_rows = tuple(row for row in order if row in rows)
        origin = Origin("navigation", FILMS, context.seed, context.budget)
        filmed = FilmJob(context.path, settings, film_rows, (*tests, *cluttered(settings)), origin)
        jobs.append(Job(FILMS, film_trials, filmed, after=tuple(rows), gpu_gb=reading_gb))
    return jobs


def _perception(settings: NavigationSettings, context: StageContext, gpu_gb: float) -> Job:
    arches = [training_arch(seed) for seed in perception_arches(context.seed, settings.perception_arches)]
    perception_job = PerceptionJob(
        context.path / PERCEPTION,
        settings,
        context.inputs["splineformer"] / settings.splineformer / PREDICTOR,
        (*((settings.anatomy(name), NAMED) for name in settings.phantoms), *arches),
        context.seed,
        _teacher(settings, context) if settings.arches else None,
    )
    return Job(PERCEPTION, fine_tune_perception, perception_job, gpu_gb=gpu_gb)


def _rival(settings: NavigationSettings, context: StageContext, task: LearningTask, expert: Path) -> Job:
    """Behaviour cloning from pixels, from as many expert trials as the first navigator has."""
    from enn.imitation.behaviour_cloning import cloning_settings

    imitation_job = ImitationJob(
        folder=context.path / PIXELS / task.name,
        origin=Origin("navigation", PIXELS, context.seed, RIVAL_VARIANT),
        settings=cloning_settings(RIVAL_VARIANT, ("image",), feature_matching=0.0, epochs=RIVAL_EPOCHS),
        task=task,
        expert=expert,
        episodes=settings.episodes[0],
        evaluation_episodes=settings.trials,
        drawn_episodes=0,
    )
    gpu_gb = policy_gb(settings.task.image_size_px, 1, LEARNT_BATCH)
    return Job(f"{PIXELS}/{task.name}", imitate, imitation_job, gpu_gb=gpu_gb)


def _arches(settings: NavigationSettings, context: StageContext) -> Course:
    anatomies = tuple(training_arch(seed) for seed in training_arches(context.seed, settings.arches))
    teacher = _teacher(settings, context)
    return Course(teacher, anatomies, tuple(settings.targets), settings.arch_task, hints=True, clutter=settings.clutter)


def _teacher(settings: NavigationSettings, context: StageContext) -> Path:
    """The roadmap policy of the stage unseen, which must know the task in random arches."""
    teacher = context.inputs["unseen"] / "roadmap" / f"seed{context.seed}" / POLICY
    if not teacher.is_file():
        raise StageError(f"there is no teacher {teacher}: run stage=unseen with this seed, or set stage.arches=0")
    task = task_from(load_policy(teacher, "unseen").metadata.get(TASK))
    if task is None:
        raise StageError(f"{teacher} does not say what task it was trained for: run stage=unseen again")
    # it sees a roadmap: neither images nor the limit of an episode are its own
    require_same_task("navigation", settings.arch_task, task, "the teacher in random arches", "unseen", MOTION)
    return teacher


def trial_sets(settings: NavigationSettings) -> tuple[TrialSet, ...]:
    """The trials: in the phantoms learnt in, in others, in random arches that nothing was trained in."""
    tests = [
        TrialSet(name, ((settings.anatomy(name), NAMED),), settings.trials, settings.task)
        for name in (*settings.phantoms, *settings.transfer_phantoms)
    ]
    unseen = _unseen(settings)
    return (*tests, *([TrialSet(UNSEEN, unseen, 1, settings.arch_task)] if unseen else []))


def cluttered(settings: NavigationSettings) -> tuple[TrialSet, ...]:
    """The trials of the navigator of random arches among clutter, in the first of the unseen ones."""
    arches = _unseen(settings)[: settings.clutter_arches]
    if not (settings.clutter and arches):
        return ()
    return (TrialSet(CLUTTERED, arches, 1, settings.arch_task, settings.clutter),)


def _unseen(settings: NavigationSettings) -> tuple[Anatomy, ...]:
    return tuple((TEST_PHANTOM, arch) for arch in unseen_arches(settings.test_arches))


STAGE = Stage(
    settings=NavigationSettings,
    run=run_navigation,
    reads=("expert", "enn", "unseen", "splineformer"),
    prepare=settle,
    check=check_navigation,
    further_inputs=recordings,
    repeated=True,
)
