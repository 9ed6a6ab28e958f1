"""The unseen stage: one policy for every target, trained on random anatomies, tested on those it has never seen.

Rows say what a policy sees. `roadmap`: the way, walls, wire, force and tip as the simulator has them; the rows
`roadmap <k>` are the curve's, each trained on k arches for equally many decisions. `image_true_mask`: images without
noise, the lumen always filled, and the simulator's own mask of the wire. `xray`: noisy X-ray images, no mask, and one
contrast run before the episode.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.anatomies.known import require_known_entry, require_known_phantoms, require_known_targets
from pipeline.anatomies.settings import settle
from pipeline.jobs.gpu_memory import policy_gb
from pipeline.jobs.pool import Job, run_jobs
from pipeline.recording.trials import Origin
from pipeline.report.learning.tables import log_summary
from pipeline.report.results import write_results
from pipeline.seeds import training_arches, unseen_arches, validation_arches
from pipeline.stages import Stage, StageContext
from pipeline.stages.learning.hyperparameters import with_hyperparameters
from pipeline.stages.unseen.arches import with_steep_take_off
from pipeline.stages.unseen.demonstrations import DEMONSTRATIONS, DemonstrationsJob, record_demonstrations
from pipeline.stages.unseen.held_out import cluttered, misregistered, test_sets
from pipeline.stages.unseen.image_policy import ImagePolicyJob, train_image_policy
from pipeline.stages.unseen.jobs import PRELOAD, AnatomiesJob, RoadmapJob, build_anatomies, train_roadmap
from pipeline.stages.unseen.settings import UnseenSettings
from pipeline.stages.unseen.starts import STARTS, StartsJob, lay_starts
from pipeline.stages.unseen.tables import curve, registration
from pipeline.stages.unseen.task import (
    IMAGE,
    ROADMAP,
    ROADMAP_KEYS,
    VARIETY,
    XRAY,
    UnseenTask,
    arch_of_test,
    training_arch,
)
from pipeline.stages.unseen.trials import HeldOutSet
from pipeline.store.errors import ConfigurationError
from pipeline.task import decision_steps, require_feeder, require_known_task

if TYPE_CHECKING:
    from enn.policy import Policy
    from enn.reinforcement.training import TrainingSettings

ROADMAP_TESTS = "roadmap tests"
EVALUATIONS, OF_THE_CURVE = 5, 2  # of a training; policies of few anatomies fail, which takes longest
STOP_AFTER = 2  # perfect evaluations: a few anatomies are soon learnt
_ANATOMIES_A_JOB = 16
_MOST_TRIED = 1_000  # arches, to find those with a steep take-off
_ACTS_FIRST = 0.05  # of the decisions, where a training starts from a policy: it fills the replay buffer
_PARTS = 2  # jobs that demonstrate beside each other
DEMONSTRATED = "lcca"  # the target that is hard to find without
BANK_CAPACITY, BANK_SHARE = 64, 0.5  # states of a case; fresh starts are what hard cases lack
# guesses
_SECONDS = {"anatomy": 0.8, "starts": 1.2, "decision": 10e-3, "demonstration": 10.0, "advised": 0.6, "test": 0.4,
            "xray": 1.5}  # fmt: skip


def check_unseen(settings: UnseenSettings) -> None:
    """Refuses unknown phantoms, targets and wires.

    Raises:
        ConfigurationError: listing the valid names.
    """
    from cathsim import GUIDEWIRES

    if settings.policy is not None:
        _policy_to_start_from(settings)
    require_known_targets(settings.targets)
    if settings.arches == VARIETY and settings.file is not None:
        raise ConfigurationError(f"stage.arches={VARIETY} tries policies in such arches alone: leave phantom.file out")
    if settings.file is None:
        require_known_phantoms(settings.phantoms)
        if settings.phantoms:
            require_known_targets(settings.tested_targets(), settings.phantoms)
        require_known_entry(settings.own_entry, settings.phantoms)
    wires = (*GUIDEWIRES, "softer", "stiffer")
    unknown = [name for name in settings.wires if name not in wires]
    if unknown:
        raise ConfigurationError(f"unknown wire {', '.join(map(repr, unknown))}: choose from {', '.join(wires)}")
    require_known_task(settings.task)
    require_feeder(settings.task, "unseen")


def run_unseen(settings: UnseenSettings, context: StageContext) -> None:
    """Trains and tests every policy."""
    jobs = plan(settings, context.path, context.seed, context.budget)
    outcomes = run_jobs(
        context.folder,
        jobs,
        workers=settings.workers,
        label="anatomies and policies",
        preload=PRELOAD,
        device=settings.device,
    )
    tables = {"generalisation_curve": curve(jobs, outcomes)}
    if settings.registration_noise_mm:
        tables["registration"] = registration(settings, outcomes[ROADMAP_TESTS]["tests"])
    write_results(context.path, tables)
    log_summary(context.path)


def plan(settings: UnseenSettings, folder: Path, run_seed: int, variant: str) -> list[Job]:
    """The jobs: anatomies first, then the roadmap policies, the image policies' teacher before the others.

    Args:
        run_seed: of the run; also which random arches are trained on.
        variant: kept in the logs: the budget, whose sizes the policies have.

    Returns:
        In the order in which they should start.
    """
    task = UnseenTask(settings.learnt_targets(), settings.task, arches=settings.arches)
    image_rows = [IMAGE] * settings.image + [XRAY] * settings.xray
    most = max(count for _, count, _ in policies_of(settings))
    arches, validated = arches_of(settings, run_seed, max(most, settings.image_anatomies if image_rows else 0))
    tested = unseen_arches(settings.test_anatomies)
    jobs = []
    for name, kinds in (
        ("training", [training_arch(seed, task.arches) for seed in arches]),
        ("validation", [training_arch(seed, task.arches) for seed in validated]),
        ("test", [arch_of_test(seed, task.arches) for seed in tested]),
    ):
        for part in _parts(kinds):
            building = AnatomiesJob(tuple(part), task.kept_targets())
            weight = len(part) * _SECONDS["anatomy"]
            jobs.append(Job(f"{name}/{part[0][1]}", build_anatomies, building, weight=weight))
    built = tuple(job.key for job in jobs)
    laid = [
        Job(
            f"{STARTS}/{part[0]}",
            lay_starts,
            StartsJob(folder / STARTS, task, tuple(part), run_seed),
            after=(f"training/{part[0]}",),
            weight=len(part) * _SECONDS["starts"],
        )
        for part in _parts(arches[:most])
    ]
    jobs += laid
    shown = [] if DEMONSTRATED not in task.targets else demonstrations(settings, folder, task, arches, run_seed)
    jobs += [replace(job, after=built) for job in shown]
    taught = (*built, *(job.key for job in (*laid, *shown)))
    main, among = test_sets(settings), cluttered(settings)
    plain = (replace(main[0], modes=("deterministic",)),)
    start = None if settings.policy is None else _policy_to_start_from(settings)
    vectors, images = policy_gb(settings.task.image_size_px, 0), policy_gb(settings.task.image_size_px, 1)
    for row, count, decisions in policies_of(settings):
        given = RoadmapJob(
            folder=folder,
            origin=Origin("unseen", row, run_seed, variant),
            task=task,
            anatomies=tuple(arches[:count]),
            tests=(*main, *misregistered(settings)) if row == ROADMAP else plain,
            settings=training_settings(
                settings, count, decisions, *((EVALUATIONS, start) if row == ROADMAP else (OF_THE_CURVE,))
            ),
            start=Path(settings.policy) if row == ROADMAP and settings.policy is not None else None,
            validated=tuple(validated),
            demonstrated=bool(shown),
        )
        tests, weight = _tests(given.tests, settings), decisions * _SECONDS["decision"]
        if row == ROADMAP:  # its tests are a job of their own, so that the image policies need not wait for them
            jobs.append(Job(row, train_roadmap, replace(given, tests=()), after=taught, weight=weight, gpu_gb=vectors))
            jobs.append(Job(ROADMAP_TESTS, train_roadmap, given, after=(row,), weight=tests, gpu_gb=vectors))
        else:  # the one with most arches never beside another that keeps as many in memory
            after = (*taught, *([ROADMAP, *image_rows] if count == most else []))
            jobs.append(Job(row, train_roadmap, given, after=after, weight=weight + tests, gpu_gb=vectors))
    teacher = next(place for place, job in enumerate(jobs) if job.key == ROADMAP)
    for row in image_rows:  # the longest chain of jobs: next after their teacher
        policy = ImagePolicyJob(
            folder=folder,
            origin=Origin("unseen", row, run_seed, variant),
            task=task,
            anatomies=tuple(arches[: settings.image_anatomies]),
            tests=tuple(replace(test, modes=("deterministic",)) for test in (*main, *(among if row == XRAY else ()))),
            settings=settings,
        )
        weight = settings.rounds * settings.advised_episodes * _SECONDS["xray" if policy.xray else "advised"]
        weight += _tests(policy.tests, settings)
        jobs.insert(teacher + 1, Job(row, train_image_policy, policy, after=(ROADMAP,), weight=weight, gpu_gb=images))
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


def policies_of(settings: UnseenSettings) -> list[tuple[str, int, int]]:
    """Row, training anatomies and decisions of the roadmap policies, the main one first.

    Those of the curve all have equally many decisions; where it has points, the main one's number of anatomies is one
    of them.
    """
    counts = sorted({*settings.curve, settings.anatomies}) if settings.curve else []
    further = [(f"{ROADMAP} {count}", count, settings.curve_decisions) for count in counts]
    return [(ROADMAP, settings.anatomies, settings.decisions), *further]


def _parts(whole: Sequence[Any]) -> list[Any]:
    return [whole[k : k + _ANATOMIES_A_JOB] for k in range(0, len(whole), _ANATOMIES_A_JOB)]


def demonstrations(
    settings: UnseenSettings, folder: Path, task: UnseenTask, arches: Sequence[int], run_seed: int
) -> list[Job]:
    """The jobs that demonstrate the way in the first training anatomies, so that small policies have some too."""
    anatomies = arches[: settings.anatomies]
    shown = anatomies[: settings.demonstrations]
    jobs = []
    for part in range(min(_PARTS, len(shown))):
        given = DemonstrationsJob(
            folder=folder / DEMONSTRATIONS,
            task=task,
            anatomies=tuple(anatomies),
            shown=tuple(shown[part::_PARTS]),
            target=DEMONSTRATED,
            hold=decision_steps(task.task),
            seed=run_seed,
        )
        weight = len(given.shown) * _SECONDS["demonstration"]
        jobs.append(Job(f"{DEMONSTRATIONS}/{part}", record_demonstrations, given, weight=weight))
    return jobs


def _tests(tests: Sequence[HeldOutSet], settings: UnseenSettings) -> float:
    episodes = sum(len(test.phantoms) * test.episodes * len(test.modes) for test in tests)
    return episodes * len(settings.learnt_targets()) * _SECONDS["test"]


def training_settings(
    settings: UnseenSettings,
    anatomies: int,
    decisions: int,
    evaluations: int = EVALUATIONS,
    start: Policy | None = None,
) -> TrainingSettings:
    """Those of the roadmap policies: a wider network than for one anatomy, and a reset bank with its cases.

    Args:
        anatomies: how many the policy is trained on.
        evaluations: on the validation anatomies, the best of which decides.
        start: the policy that it starts from.
    """
    from enn.reinforcement.rehearsal import starting_from
    from enn.reinforcement.training import DESK_SAC

    training = replace(
        DESK_SAC,
        keys=ROADMAP_KEYS,
        hidden=(settings.hidden, settings.hidden),
        batch_size=256,
        gradient_steps=0.5,
        n_envs=16,
        decisions=decisions,
        buffer_size=max(decisions, 1000),
        learning_starts=min(DESK_SAC.learning_starts, decisions // 4),
        action_repeat=decision_steps(settings.task),
        reset_bank_share=BANK_SHARE,
        reset_bank_capacity=BANK_CAPACITY,
        reset_bank_cases=anatomies * len(settings.learnt_targets()),
        evaluate_every=max(decisions // evaluations, 1),
        evaluation_episodes=settings.validation_episodes,
        stop_after=STOP_AFTER,
        tensorboard=settings.tensorboard,
        keep_critics=True,  # a rehearsal starts from it
    )
    if start is not None:
        training = starting_from(training, start, _ACTS_FIRST)
    return with_hyperparameters(training, settings.training)


def _policy_to_start_from(settings: UnseenSettings) -> Policy:
    from enn.policy import Policy

    try:
        policy = Policy.load(Path(str(settings.policy)))
    except (OSError, ValueError) as error:
        raise ConfigurationError(f"stage.policy={settings.policy} can't be read: {error}") from None
    if not policy.critics or policy.keys != ROADMAP_KEYS:
        raise ConfigurationError(
            f"stage.policy={settings.policy} is no policy by a roadmap that was saved with critics: give such a one"
        )
    return policy


STAGE = Stage(
    settings=UnseenSettings,
    run=run_unseen,
    writes=(
        "starts/<arch>.npz",
        "demonstrations/<target>_<arch>.npz",
        "<row>/seed<k>/{policy.pt or image_policy.pt, training.csv, training.json}",
        "<row>/seed<k>/evaluation/<test set>/<target>/<mode>/<phantom>/NNN.mcap",
        "results.json",
    ),
    prepare=settle,
    check=check_unseen,
    repeated=True,
    place=9,
)
