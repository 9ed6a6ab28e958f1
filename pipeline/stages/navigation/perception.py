"""Job of the navigation that fine-tunes the SplineFormer on wires under the navigation's cameras.

Shapes are laid out along the ways of random arches and moved on from there, and others are steered by a teacher with
noise in its actions; the simulator knows where the wire is. After this the network's weights stay as they are, for
every navigator. The folder holds::

    predictor.pt  perception.json
    frames.npz  fit/                 until it is finished
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.jobs.worker import Report
from pipeline.recording.curves import Curves
from pipeline.stages.navigation.frames import frames_in
from pipeline.stages.navigation.scene import Anatomy, phantom_of
from pipeline.stages.navigation.settings import NavigationSettings
from pipeline.store.atomic_files import write_arrays, write_json
from pipeline.store.errors import StageError

if TYPE_CHECKING:
    from guide3d.learning.training import FitProgress
    from splineformer.navigation.fine_tuning import WirePictures
    from splineformer.navigation.perception import PerceptionNetwork
    from splineformer.predictor import Predictor

PERCEPTION = "perception"  # job and folder
PREDICTOR, RECORD, FRAMES = "predictor.pt", "perception.json", "frames.npz"
_VALIDATION = 0.1  # share of the anatomies
_PREPARING = 0.3  # of the job's time


@dataclass(frozen=True)
class PerceptionJob:
    """The fine-tuning of the perception network.

    Attributes:
        splineformer: model file of the stage splineformer.
        anatomies: whose wires are shown.
        teacher: file of a policy that steers some of the wires; None: all are laid.
    """

    folder: Path
    settings: NavigationSettings
    splineformer: Path
    anatomies: tuple[Anatomy, ...]
    seed: int
    teacher: Path | None = None


def fine_tune_perception(job: PerceptionJob, report: Report) -> dict[str, Any]:
    """Trains the SplineFormer further.

    Returns:
        ``images``, ``epochs``, and before and after the tip's and the curve's mean and median error on anatomies kept
        apart, px of 1,024.
    """
    from guide3d.learning.training import finished
    from splineformer.navigation.fine_tuning import fine_tune
    from splineformer.predictor import Predictor

    if (job.folder / RECORD).is_file():
        return dict(json.loads((job.folder / RECORD).read_text(encoding="utf-8")))
    try:
        predictor = Predictor.load(job.splineformer, device=report.device)
    except (FileNotFoundError, ValueError) as error:
        raise StageError(f"{error}; run stage=splineformer again") from error
    epochs = job.settings.perception_epochs
    outcome: dict[str, Any] = {"images": 0, "epochs": epochs}

    def progress(now: FitProgress) -> None:
        curves.add(now.epoch, loss=now.loss, validation=now.validation)
        report(_PREPARING + (1 - _PREPARING) * now.epoch / now.epochs, f"epoch {now.epoch}, loss {now.loss:.3g}")

    if epochs:
        shown = _shown(job, predictor, report.part(0.0, _PREPARING, "frames"))
        with Curves(job.folder) as curves:
            predictor, errors = fine_tune(
                predictor, shown, job.settings.splineformer, epochs,
                folder=job.folder / "fit", seed=job.seed, device=report.device, progress=progress,
            )  # fmt: skip
        outcome |= errors
    predictor.save(job.folder / PREDICTOR, navigation_epochs=epochs)
    write_json(job.folder / RECORD, outcome)
    finished(job.folder / "fit")
    (job.folder / FRAMES).unlink(missing_ok=True)
    return outcome


def load_perception(folder: Path, device: str = "cpu") -> PerceptionNetwork:
    """The perception network of a finished job.

    Args:
        device: where it reads images.
    """
    import torch

    from splineformer.navigation.perception import PerceptionNetwork
    from splineformer.predictor import Predictor

    torch.set_num_threads(1)
    return PerceptionNetwork(Predictor.load(folder / PERCEPTION / PREDICTOR, device=device))


def _shown(job: PerceptionJob, predictor: Predictor, report: Any) -> WirePictures:
    from splineformer.navigation.fine_tuning import WirePictures

    file, cameras = job.folder / FRAMES, len(job.settings.cameras)
    if not file.is_file():
        pictures, curves, held_out = [], [], []
        count = len(job.anatomies)
        validated = max(1, round(_VALIDATION * count))
        for number, (kind, seed) in enumerate(job.anatomies):
            report(number / count, f"frames in {phantom_of((kind, seed)).name}")
            size_px, device = predictor.network.settings.image_px, str(predictor.device)
            for images, lines in frames_in((kind, seed), job.settings, job.seed, job.teacher, size_px, device):
                pictures.append(images)
                curves.append(lines)
                held_out.append(number >= count - validated and count > 1)
        if not pictures:
            raise StageError("no wire could be laid in any anatomy: choose others")
        arrays = {  # camera by camera
            "pictures": np.stack(pictures, axis=1).reshape(-1, *pictures[0].shape[1:]),
            "curves": np.stack(curves, axis=1).reshape(-1, *curves[0].shape[1:]),
            "held_out": np.tile(np.array(held_out), cameras),
        }
        write_arrays(file, arrays)
    with np.load(file) as kept:
        return WirePictures(kept["pictures"], kept["curves"], kept["held_out"], cameras)
