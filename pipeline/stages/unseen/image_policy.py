"""Image students of the stage `unseen`: rounds of lessons, with what they see an image with, and their tests.

A student's folder, ``<row>/seed<k>/``, draws as::

    student.pt  training.csv  training.json
    lessons/round<k>.npz                          until it is finished
    evaluation/<test set>/<target>/<mode>/<phantom>/NNN.mcap
"""

from __future__ import annotations

import json
import logging
import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.jobs.worker import Report
from pipeline.recording.trials import Origin
from pipeline.seeds import fit_seed, unseen_lesson_seeds
from pipeline.stages.unseen.task import RESOLUTION, UnseenTask, training_arch
from pipeline.stages.unseen.trials import HeldOutSet, run_tests
from pipeline.stages.unseen.xray_policy import XrayEnvironment, contrast_run, train_wire_segmenter
from pipeline.store.atomic_files import atomic_path, write_json

if TYPE_CHECKING:
    from enn.imitation.lumen_segmentation import LumenSegmenter
    from enn.imitation.recurrent_policy import ImageStudent, Lesson
    from enn.imitation.wire_segmentation import WireSegmenter
    from enn.policy import Policy

STUDENT, RECORD, CURVE = "student.pt", "training.json", "training.csv"
LUMEN_DEPTH = 1.5e-3  # m: a pixel shows the lumen where its ray passes through this much of it
SIDE_BY_SIDE = 12  # episodes played together while lessons are given

_LOGGER = logging.getLogger(__name__)


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
        xray: sees noisy X-ray images and a contrast run instead of images and the true mask.
        wire_epochs: of the network that finds the wire in them.
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
    xray: bool = False
    wire_epochs: int = 6

    def observations(self, *further: str) -> tuple[str, ...]:
        """What an environment is made with, beside what `seen` adds."""
        from enn.imitation.recurrent_policy import IMAGE_KEYS

        return (*(("goal_image",) if self.xray else IMAGE_KEYS), *further)

    def seen(self, environment: Any, **further: Any) -> Any:
        """The environment as the student sees it."""
        return XrayEnvironment(environment, self.task.task.image_size_px, **further) if self.xray else environment


def train_student(job: StudentJob, report: Report) -> dict[str, Any]:
    """Trains the image student round by round and tests it; each part only where it lacks.

    Returns:
        ``training_s`` and a summary for each test set, target and mode.
    """
    from enn.imitation.recurrent_policy import ImageStudent

    if (job.folder / RECORD).is_file():
        spent = float(json.loads((job.folder / RECORD).read_text(encoding="utf-8"))["wall_s"])
        student = ImageStudent.load(job.folder / STUDENT, report.device)
    else:
        student, spent = teach(job, report.part(0.0, 0.8, "lessons"), report.device)
    tests = report.part(0.8, 1.0, "tests")
    tested = run_tests(job, lambda mode: lambda seed: student.controller(), job.observations(), tests, job.seen)
    return {"training_s": spent, "tests": tested}


def teach(job: StudentJob, report: Callable[[float, str], None], device: str = "cpu") -> tuple[ImageStudent, float]:
    """All rounds of lessons, going on after the last finished one.

    Returns:
        The student and the seconds that it took.
    """
    from cathsim.many_anatomies import SHELF
    from enn.imitation.advised_episodes import give_lessons
    from enn.imitation.recurrent_policy import ImageStudent, StudentSettings
    from enn.policy import Policy

    began = time.monotonic()
    expert = Policy.load(job.expert, device)
    rows: list[dict[str, Any]] = _read_rows(job.folder / CURVE)
    earlier = float(rows[-1]["wall_s"]) if rows else 0.0
    SHELF.capacity = max(SHELF.capacity, len(job.anatomies))  # all take turns
    if rows:
        student = ImageStudent.load(job.folder / STUDENT, device)
    else:
        segmenter, overlap = train_segmenter(job, report, device)
        wire = None if not job.xray else find_wires(job, expert, report, device)
        hints = int(np.prod(expert.observation_space[expert.keys[0]].shape))  # type: ignore[index]
        settings = StudentSettings(hints=hints, action_repeat=expert.action_repeat)
        student = ImageStudent(settings, segmenter, job.seed, device, wire)
        _LOGGER.info("the segmenter's overlap with its training lumens is %.3f", overlap)
    lessons = [lesson for row in rows for lesson in _read_lessons(_round(job, int(row["round"])))]
    observation = job.observations(*expert.keys)
    count = min(SIDE_BY_SIDE, job.lessons)
    envs = [job.seen(job.task.training_environment(job.anatomies, observation)) for _ in range(count)]
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


def train_segmenter(
    job: StudentJob, report: Callable[[float, str], None], device: str = "cpu"
) -> tuple[LumenSegmenter, float]:
    """Trains the network that finds the lumen, on images of the training anatomies without a wire: of contrast runs, or
    without noise.

    Returns:
        The network, and its overlap with the lumens that it was trained on.
    """
    from cathsim.fluoroscopy import Projector, background_image
    from cathsim.fluoroscopy.attenuation import lumen_path_length
    from cathsim.many_anatomies import SHELF
    from enn.imitation.lumen_segmentation import fit_segmenter

    images, lumens = [], []
    for number, seed in enumerate(job.anatomies):
        report(0.1 * number / len(job.anatomies) / job.rounds, "images")
        phantom = SHELF.take(training_arch(seed), RESOLUTION)
        projector = Projector.frontal(phantom.bounds, job.task.task.image_size_px)
        if job.xray:
            radius = job.task.task.guidewire().radius
            images.append(contrast_run(phantom, job.task.task.image_size_px, radius).contrast[0])
        else:
            images.append(background_image(phantom.grid, projector, key=phantom.hash))
        lumens.append(lumen_path_length(phantom.grid, projector) > LUMEN_DEPTH)
    return fit_segmenter(
        np.stack(images),
        np.stack(lumens).astype(np.float32),
        epochs=job.segmenter_epochs,
        seed=job.seed,
        device=device,
        progress=lambda epoch, _: report((0.1 + 0.1 * epoch / job.segmenter_epochs) / job.rounds, "segmenter"),
    )


def find_wires(
    job: StudentJob, expert: Policy, report: Callable[[float, str], None], device: str = "cpu"
) -> WireSegmenter:
    """Trains the network that finds the wire, on an episode in each training anatomy."""
    environment = job.task.training_environment(job.anatomies, job.observations(*expert.keys))
    targets = len(job.task.targets)
    cases = [environment.case_of(place, place % targets) for place in range(len(job.anatomies))]
    network, score = train_wire_segmenter(
        job.seen(environment, with_mask=True), expert, cases, epochs=job.wire_epochs, seed=job.seed,
        device=device,
        report=lambda share, text: report((0.1 + 0.1 * share) / job.rounds, text),
    )  # fmt: skip
    environment.close()
    _LOGGER.info("the Dice score of the wire's segmenter on its training images is %.3f", score)
    return network


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
    from enn.imitation.recurrent_policy import Lesson

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
