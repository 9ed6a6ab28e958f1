"""The navigator's eye: a trained SplineFormer, trained a little further on wires under the navigation's own cameras.

The data set shows wires deep in one phantom. A navigation begins with a short wire, in other anatomies, and folds its
tip at walls and in wrong branches. So shapes are laid out along the ways of random arches and moved on from there, and
others are steered by a teacher, more or less clumsily; the simulator knows where the wire is. After this the network's
weights stay as they are, for every navigator.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.jobs.worker import Report
from pipeline.stages.navigation.frames import frames_in
from pipeline.stages.navigation.scene import Rig
from pipeline.stages.navigation.task import Rules
from pipeline.store.atomic_files import atomic_path, write_json
from pipeline.store.errors import StageError

if TYPE_CHECKING:
    from splineformer.predictor import Predictor

PREDICTOR, RECORD, FRAMES = "predictor.pt", "reader.json", "frames.npz"
_VALIDATION = 0.1  # share of the anatomies
_RATE = 6e-4
_PREPARING = 0.3  # of the job's time


@dataclass(frozen=True)
class ReaderJob:
    """The training that goes on.

    Attributes:
        folder: of the reader.
        splineformer: model file of the stage splineformer.
        variant: its variant, whose recipe for a desk is followed.
        rig: of the images.
        anatomies: kind and seed of each random arch; ("type_1", -1) is a named phantom.
        frames: in each anatomy.
        epochs: over them; 0: the network stays as it is.
        targets: whose ways wires are laid along.
        seed: of everything.
        teacher: file of a policy that steers some of the wires; None: all are laid.
        taught: targets to which it knows the way.
        rules: of its episodes, and of the wires laid in random arches.
        named: rules in the named phantoms, whose wire is laid there.
    """

    folder: Path
    splineformer: Path
    variant: str
    rig: Rig
    anatomies: tuple[tuple[str, int], ...]
    frames: int
    epochs: int
    targets: tuple[str, ...]
    seed: int
    teacher: Path | None = None
    taught: tuple[str, ...] = ()
    rules: Rules = field(default_factory=Rules)
    named: Rules = field(default_factory=Rules)

    def rules_in(self, anatomy: tuple[str, int]) -> Rules:
        """Those of an anatomy: a seed below 0 is a named phantom's."""
        return self.named if anatomy[1] < 0 else self.rules


def train_reader(job: ReaderJob, report: Report) -> dict[str, Any]:
    """Trains the SplineFormer further, and tells how far it was and is off.

    Returns:
        ``images``, and before and after the tip's and the curve's mean and median error on anatomies kept apart, px of
        1,024.
    """
    from guide3d.learning.distributed import Ranks
    from guide3d.learning.training import FitProgress, finished, fit
    from splineformer.learning.recipes import recipe_of
    from splineformer.learning.samples import SplineObjective
    from splineformer.predictor import Predictor

    if (job.folder / RECORD).is_file():
        return dict(json.loads((job.folder / RECORD).read_text(encoding="utf-8")))
    predictor = _taken_over(job.splineformer, report.device)
    outcome: dict[str, Any] = {"images": 0, "epochs": job.epochs}
    if job.epochs:
        pictures, curves, apart = _frames(job, predictor, report.part(0.0, _PREPARING, "frames"))
        count = len(curves) // len(job.rig.cameras)
        stores = [_Kept(pictures[n * count : (n + 1) * count]) for n in range(len(job.rig.cameras))]
        items = np.arange(len(curves))
        recipe = recipe_of(job.variant, "desk")
        settings = replace(recipe.fit, epochs=job.epochs, learning_rate=_RATE)
        objective = SplineObjective(
            stores, curves, items[~apart], items[apart], predictor.network,
            augmentation=recipe.augmentation, weights=recipe.weights, source_px=predictor.source_px,
        )  # fmt: skip
        outcome |= {f"{name}_before": value for name, value in errors(predictor, pictures, curves, apart).items()}

        def tell(now: FitProgress) -> None:
            report(_PREPARING + (1 - _PREPARING) * now.epoch / now.epochs, f"epoch {now.epoch}, loss {now.loss:.3g}")

        ranks = Ranks.join(report.device)
        fitted = fit(
            predictor.network, objective, settings, folder=job.folder / "fit", seed=job.seed, ranks=ranks, progress=tell
        )
        predictor = Predictor(predictor.network, source_px=predictor.source_px, device=report.device)
        outcome |= {"images": len(curves), "cpu_min": fitted.cpu_s / 60}
        outcome |= {f"{name}_after": value for name, value in errors(predictor, pictures, curves, apart).items()}
    predictor.save(job.folder / PREDICTOR, navigation_epochs=job.epochs)
    write_json(job.folder / RECORD, outcome)
    finished(job.folder / "fit")
    (job.folder / FRAMES).unlink(missing_ok=True)
    return outcome


def load_reader(folder: Path, device: str = "cpu") -> Any:
    """The reader of a finished job.

    Args:
        folder: of the job.
        device: where it reads.
    """
    import torch

    from splineformer.navigation.perception import Reader
    from splineformer.predictor import Predictor

    torch.set_num_threads(1)
    return Reader(Predictor.load(folder / PREDICTOR, device=device))


def _taken_over(path: Path, device: str) -> Predictor:
    from splineformer.predictor import Predictor

    try:
        return Predictor.load(path, device=device)
    except (FileNotFoundError, ValueError) as error:
        raise StageError(f"{error}; run stage=splineformer again") from error


def errors(
    predictor: Predictor, pictures: np.ndarray, curves: Sequence[np.ndarray], chosen: np.ndarray
) -> dict[str, float]:
    """Mean and median error of tip and curve of the chosen pictures, in px of an image of 1,024."""
    from splineformer.comparison.curve_errors import curve_errors
    from splineformer.navigation.perception import Reader

    if not chosen.any():
        return {}
    reader, told = Reader(predictor), []
    places = np.flatnonzero(chosen).tolist()
    for place, reading in zip(places, reader(list(pictures[places])), strict=True):
        told.append(curve_errors(1024.0 * reading.points.astype(float), 1024.0 * curves[place]))
    values = {name: [one[name] for one in told] for name in ("tip_px", "mean_px")}
    means = {name: float(np.mean(of)) for name, of in values.items()}
    return means | {f"median_{name}": float(np.median(of)) for name, of in values.items()}


class _Kept:
    """Pictures in memory, as training takes them."""

    def __init__(self, pictures: np.ndarray) -> None:
        self._pictures = pictures

    def healthy(self, indices: np.ndarray) -> np.ndarray:
        return np.ones(len(indices), bool)

    def pictures(self, indices: np.ndarray) -> np.ndarray:
        return self._pictures[indices]


def _frames(job: ReaderJob, predictor: Predictor, report: Any) -> tuple[np.ndarray, list[np.ndarray], np.ndarray]:
    """Pictures (N, size, size) of the first camera, then the second; their curves; those to validate with."""
    file = job.folder / FRAMES
    if not file.is_file():
        pictures, curves, apart = [], [], []
        held = max(1, round(_VALIDATION * len(job.anatomies)))
        for number, (kind, seed) in enumerate(job.anatomies):
            report(number / len(job.anatomies), f"frames in {kind} {max(seed, 0)}")
            for images, lines in frames_in(
                (kind, seed), job, predictor.network.settings.image_px, str(predictor.device)
            ):
                pictures.append(images)
                curves.append(lines)
                apart.append(number >= len(job.anatomies) - held and len(job.anatomies) > 1)
        if not pictures:
            raise StageError("no wire could be laid in any anatomy: choose others")
        # camera by camera
        arrays = {
            "pictures": np.stack(pictures, axis=1).reshape(-1, *pictures[0].shape[1:]),
            "curves": np.stack(curves, axis=1).reshape(-1, *curves[0].shape[1:]),
            "apart": np.tile(np.array(apart), len(job.rig.cameras)),
        }
        file.parent.mkdir(parents=True, exist_ok=True)
        with atomic_path(file) as temporary, temporary.open("wb") as stream:
            np.savez(stream, **arrays)  # type: ignore[arg-type]
    with np.load(file) as kept:
        return kept["pictures"], list(kept["curves"]), kept["apart"]
