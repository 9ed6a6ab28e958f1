"""Jobs of the stage `unseen`: anatomies, roadmap policies, the image student, and their logged episodes.

A policy's folder, ``<row>/seed<k>/``, draws as::

    policy.pt or student.pt  training.csv  training.json
    segmenter.pt  lessons/round<k>.npz            of the image student; lessons only until it is finished
    checkpoint/                                   of a roadmap policy, until it is finished
    evaluation/<test set>/<target>/<mode>/<phantom>/NNN.mcap
"""

from __future__ import annotations

import json
import logging
import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.atomic import atomic_path, write_json
from pipeline.errors import stopping_the_stage
from pipeline.job_worker import Report
from pipeline.seeds import fit_seed, held_out_seeds, unseen_lesson_seeds
from pipeline.task import TASK
from pipeline.trials import Controller, Origin, run_trials, summary
from pipeline.unseen_demonstrations import read_demonstrations
from pipeline.unseen_starts import read_starts
from pipeline.unseen_task import RESOLUTION, ROADMAP_KEYS, UnseenTask, training_arch

if TYPE_CHECKING:
    from cathsim.metrics import EpisodeMetrics
    from enn.lumen_segmentation import LumenSegmenter
    from enn.reinforcement import TrainingSettings
    from enn.student import ImageStudent, Lesson

POLICY, STUDENT, RECORD, CURVE = "policy.pt", "student.pt", "training.json", "training.csv"
LUMEN_DEPTH = 1.5e-3  # m: a pixel shows the lumen where its ray passes through this much of it
SIDE_BY_SIDE = 12  # episodes played together while lessons are given
PRELOAD = ("cathsim.variety", "enn.reinforcement", "enn.lessons", "pipeline.recording")

_LOGGER = logging.getLogger(__name__)


@dataclass(frozen=True)
class HeldOutSet:
    """Anatomies and a wire that a policy has not been trained with.

    Attributes:
        name: in the tables.
        phantoms: names, paths of meshes, or seeds of random arches.
        episodes: on each, for each target.
        wire: a preset, "softer" or "stiffer".
        modes: "deterministic", "stochastic".
    """

    name: str
    phantoms: tuple[str | int, ...]
    episodes: int = 1
    wire: str = "default"
    modes: tuple[str, ...] = ("deterministic",)


@dataclass(frozen=True)
class AnatomiesJob:
    """Random arches to build into the cache.

    Attributes:
        arches: kind and seed of each.
        targets: whose ways are laid out in them.
    """

    arches: tuple[tuple[str, int], ...]
    targets: tuple[str, ...]


@dataclass(frozen=True)
class RoadmapJob:
    """A policy on the local roadmap to train and to test.

    Attributes:
        folder: of the policy.
        task: of its episodes.
        anatomies: seeds of the random arches trained on.
        settings: of the training.
        seed: of the training.
        origin: kept in the logs.
        tests: that it is put to.
        demonstrations: folder of demonstrations; those in its anatomies are learnt from.
        starts: folder of laid starts; those in its anatomies go into the bank.
        validated: seeds of random arches that the best policy is chosen by; none: those trained on.
    """

    folder: Path
    task: UnseenTask
    anatomies: tuple[int, ...]
    settings: TrainingSettings
    seed: int
    origin: Origin
    tests: tuple[HeldOutSet, ...]
    demonstrations: Path | None = None
    starts: Path | None = None
    validated: tuple[int, ...] = ()


@dataclass(frozen=True)
class StudentJob:
    """An image student to train on a roadmap policy's advice, and to test.

    Attributes:
        folder: of the student.
        expert: file of the roadmap policy.
        task: of its episodes.
        anatomies: seeds of the random arches trained on.
        segmenter_epochs: over their images.
        rounds: of lessons; the expert steers the first.
        lessons: episodes a round.
        epochs: over all lessons so far, a round; twice as many in the last.
        seed: of everything.
        origin: kept in the logs.
        tests: that it is put to.
    """

    folder: Path
    expert: Path
    task: UnseenTask
    anatomies: tuple[int, ...]
    segmenter_epochs: int
    rounds: int
    lessons: int
    epochs: int
    seed: int
    origin: Origin
    tests: tuple[HeldOutSet, ...] = field(default=())


def build_anatomies(job: AnatomiesJob, report: Report) -> dict[str, Any]:
    """Builds random arches into the cache of phantoms."""
    from cathsim.anatomy import load_phantom

    for done, (kind, seed) in enumerate(job.arches):
        report(done / len(job.arches), f"arch {seed}")
        phantom = load_phantom(kind, seed=seed, resolution=RESOLUTION)
        for target in job.targets:
            phantom.geodesic_field(target)
    return {"anatomies": len(job.arches)}


def train_roadmap(job: RoadmapJob, report: Report) -> dict[str, Any]:
    """Trains a policy on the roadmap and tests it; each part only where it lacks.

    Returns:
        ``training_s`` and a summary for each test set, target and mode.
    """
    from cathsim.variety import SHELF
    from enn.checkpoint import CheckpointError
    from enn.reinforcement import Training

    for leftover in job.folder.glob(".*.tmp"):
        leftover.unlink()
    validated = partial(job.task.training_environment, job.validated, ROADMAP_KEYS, "accurate")
    SHELF.capacity = max(SHELF.capacity, len(job.anatomies) + len(job.validated))  # all take turns
    training = Training(
        job.settings,
        partial(job.task.training_environment, job.anatomies, ROADMAP_KEYS),
        job.folder,
        seed=job.seed,
        demonstrations=[] if job.demonstrations is None else read_demonstrations(job.demonstrations, job.anatomies),
        metadata={**job.origin.configuration("training"), TASK: asdict(job.task.task)},
        starts=[] if job.starts is None else read_starts(job.starts, job.anatomies, job.task.targets),
        make_validation_env=validated if job.validated else None,
    )
    with stopping_the_stage(CheckpointError):
        result = training.run(lambda p: report(0.7 * p.decisions / p.total, f"success {100 * (p.success or 0):.0f} %"))

    def controllers(mode: str) -> Callable[[int], Controller]:
        return lambda seed: result.policy.controller(deterministic=mode == "deterministic", seed=seed)

    tested = run_tests(job, controllers, ROADMAP_KEYS, report.part(0.7, 1.0, "tests"))
    return {"training_s": result.timings["wall_s"], "tests": tested}


def train_student(job: StudentJob, report: Report) -> dict[str, Any]:
    """Trains the image student round by round and tests it; each part only where it lacks.

    Returns:
        ``training_s`` and a summary for each test set, target and mode.
    """
    from enn.student import IMAGE_KEYS, ImageStudent

    if (job.folder / RECORD).is_file():
        spent = float(json.loads((job.folder / RECORD).read_text(encoding="utf-8"))["wall_s"])
        student = ImageStudent.load(job.folder / STUDENT)
    else:
        student, spent = teach(job, report.part(0.0, 0.8, "lessons"))
    tested = run_tests(job, lambda mode: lambda seed: student.controller(), IMAGE_KEYS, report.part(0.8, 1.0, "tests"))
    return {"training_s": spent, "tests": tested}


def teach(job: StudentJob, report: Callable[[float, str], None]) -> tuple[ImageStudent, float]:
    """All rounds of lessons, going on after the last finished one.

    Returns:
        The student and the seconds that it took.
    """
    from cathsim.variety import SHELF
    from enn.lessons import give_lessons
    from enn.policy import Policy
    from enn.student import IMAGE_KEYS, ImageStudent, StudentSettings

    began = time.monotonic()
    expert = Policy.load(job.expert)
    rows: list[dict[str, Any]] = _read_rows(job.folder / CURVE)
    earlier = float(rows[-1]["wall_s"]) if rows else 0.0
    SHELF.capacity = max(SHELF.capacity, len(job.anatomies))  # all take turns
    if rows:
        student = ImageStudent.load(job.folder / STUDENT)
    else:
        segmenter, overlap = train_segmenter(job, report)
        hints = int(np.prod(expert.observation_space[expert.keys[0]].shape))  # type: ignore[index]
        settings = StudentSettings(hints=hints, action_repeat=expert.action_repeat)
        student = ImageStudent(settings, segmenter, job.seed)
        _LOGGER.info("the segmenter's overlap with its training lumens is %.3f", overlap)
    lessons = [lesson for row in rows for lesson in _read_lessons(_round(job, int(row["round"])))]
    observation = (*IMAGE_KEYS, *expert.keys)
    count = min(SIDE_BY_SIDE, job.lessons)
    envs = [job.task.training_environment(job.anatomies, observation) for _ in range(count)]
    for number in range(len(rows), job.rounds):
        first = number == 0
        epochs = job.epochs * (2 if number == job.rounds - 1 else 1)

        def playing(number: int = number) -> None:
            report((number + 0.2) / job.rounds, f"round {number + 1}, episodes")

        def fitting(epoch: int, loss: float, number: int = number, epochs: int = epochs) -> None:
            report((number + 0.6 + 0.4 * epoch / epochs) / job.rounds, f"round {number + 1}, loss {loss:.3f}")

        new = give_lessons(
            envs,
            expert,
            student,
            unseen_lesson_seeds(job.seed, number, job.lessons),
            expert_share=1.0 if first else 0.1,
            noise=0.3 if first else 0.1,
            generator=np.random.default_rng((job.seed, number)),
            tick=playing,
        )
        lessons += new
        loss = student.fit(lessons, epochs, seed=fit_seed(job.seed, number), progress=fitting)
        _write_lessons(_round(job, number), new)
        student.save(job.folder / STUDENT)
        rows.append(
            {
                "round": number,
                "decisions": sum(len(lesson.views) for lesson in lessons),
                "wall_s": round(earlier + time.monotonic() - began, 2),
                "success": round(float(np.mean([lesson.success for lesson in new])), 4),
                "loss": round(loss, 5),
            }
        )
        _write_rows(job.folder / CURVE, rows)  # last: the round counts from here on
    spent = float(rows[-1]["wall_s"])
    write_json(job.folder / RECORD, {"wall_s": spent, "rounds": rows, "anatomies": len(job.anatomies)})
    shutil.rmtree(job.folder / "lessons", ignore_errors=True)
    return student, spent


def train_segmenter(job: StudentJob, report: Callable[[float, str], None]) -> tuple[LumenSegmenter, float]:
    """Trains the network that finds the lumen, on images of the training anatomies without a wire.

    Returns:
        The network, and its overlap with the lumens that it was trained on.
    """
    from cathsim.fluoroscopy import Projector, background_image
    from cathsim.fluoroscopy.attenuation import lumen_path_length
    from cathsim.variety import SHELF
    from enn.lumen_segmentation import fit_segmenter

    images, lumens = [], []
    for number, seed in enumerate(job.anatomies):
        report(0.1 * number / len(job.anatomies) / job.rounds, "images")
        phantom = SHELF.take(training_arch(seed), RESOLUTION)
        projector = Projector.frontal(phantom.bounds, job.task.task.image_size_px)
        images.append(background_image(phantom.grid, projector, key=phantom.hash))
        lumens.append(lumen_path_length(phantom.grid, projector) > LUMEN_DEPTH)
    return fit_segmenter(
        np.stack(images),
        np.stack(lumens).astype(np.float32),
        epochs=job.segmenter_epochs,
        seed=job.seed,
        progress=lambda epoch, _: report((0.1 + 0.1 * epoch / job.segmenter_epochs) / job.rounds, "segmenter"),
    )


def run_tests(
    job: RoadmapJob | StudentJob,
    controllers: Callable[[str], Callable[[int], Controller]],
    observation: tuple[str, ...],
    report: Callable[[float, str], None],
) -> list[dict[str, Any]]:
    """Puts a policy to its tests; episodes whose log is there are not repeated.

    Args:
        job: whose tests.
        controllers: gives, for a mode, the policy for the episode of a seed.
        observation: that the policy sees.
        report: takes the share done and a few words.

    Returns:
        A row for each test set, target and mode: their names and the summary of the episodes.
    """
    rows = []
    cells = [(test, target, mode) for test in job.tests for target in job.task.targets for mode in test.modes]
    total = sum(len(test.phantoms) for test, _, _ in cells)
    done = 0
    for test, target, mode in cells:
        metrics: list[EpisodeMetrics] = []
        origin = Origin(
            job.origin.stage,
            job.origin.row,
            job.origin.training_seed,
            job.origin.variant,
            {**job.origin.further, "test_set": test.name, "training_anatomies": len(job.anatomies)},
        )
        for place, phantom in enumerate(test.phantoms):
            environment = job.task.test_environment(phantom, target, test.wire, observation)
            name = environment.phantom.name
            seeds = held_out_seeds(job.seed, len(test.phantoms) * test.episodes)
            metrics += run_trials(
                environment,
                controllers(mode),
                job.folder / "evaluation" / test.name / target / mode / name,
                seeds=seeds[place * test.episodes : (place + 1) * test.episodes],
                mode=mode,
                origin=origin,
            )
            environment.close()
            done += 1
            won = sum(one.success for one in metrics)
            report(done / total, f"{test.name} {target} {won}/{len(metrics)}")
        rows.append({"test_set": test.name, "target": target, "mode": mode, **summary(metrics)})
    return rows


def _round(job: StudentJob, number: int) -> Path:
    return job.folder / "lessons" / f"round{number}.npz"


def _write_lessons(path: Path, lessons: Sequence[Lesson]) -> None:
    arrays = {
        "lengths": np.array([len(lesson.views) for lesson in lessons]),
        "success": np.array([lesson.success for lesson in lessons]),
        **{name: np.concatenate([getattr(one, name) for one in lessons]) for name in ("views", "actions", "hints")},
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        np.savez(stream, **arrays)  # type: ignore[arg-type]


def _read_lessons(path: Path) -> list[Lesson]:
    from enn.student import Lesson

    with np.load(path) as arrays:
        cuts = np.cumsum(arrays["lengths"])[:-1]
        views, actions, hints = (np.split(arrays[name], cuts) for name in ("views", "actions", "hints"))
        successes = arrays["success"].tolist()
    return [Lesson(*parts) for parts in zip(views, actions, hints, successes, strict=True)]


def _write_rows(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    lines = [",".join(rows[0]), *(",".join(str(value) for value in row.values()) for row in rows)]
    with atomic_path(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _read_rows(path: Path) -> list[dict[str, Any]]:
    if not path.is_file():
        return []
    names, *lines = path.read_text(encoding="utf-8").split()
    rows = [dict(zip(names.split(","), map(float, line.split(",")), strict=True)) for line in lines]
    return [{**row, "round": int(row["round"]), "decisions": int(row["decisions"])} for row in rows]
