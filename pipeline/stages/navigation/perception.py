"""The navigation's perception: the SplineFormer is fine-tuned on wires under the navigation's cameras.

Shapes are laid out along the ways of random arches and moved on from there, and others are steered by a teacher with
noise in its actions; the simulator knows where the wire is. After this the network's weights stay as they are, for
every navigator. The folder holds::

    predictor.pt  perception.json
    frames.npz  fit/                 until it is finished
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from enn.curves import Curves
from pipeline.anatomies.anatomy_file import AnatomyFile
from pipeline.anatomies.devices import fitted_task
from pipeline.anatomies.settings import TARGETS
from pipeline.jobs.worker import Report
from pipeline.stages.navigation.scene import NAMED, Anatomy, among_clutter, phantom_of, scene_of
from pipeline.stages.navigation.settings import NavigationSettings
from pipeline.store.atomic_files import read_json, write_arrays, write_json
from pipeline.store.errors import StageError
from pipeline.task import DESCENDING

if TYPE_CHECKING:
    from cathsim.anatomy import Phantom
    from cathsim.observations.c_arm_view import CArms
    from guide3d.learning.training import FitProgress
    from splineformer.navigation.fine_tuning import WirePictures
    from splineformer.navigation.perception import PerceptionNetwork
    from splineformer.predictor import Predictor


_STEERED = 0.6  # share of the pictures of wires that a teacher steers, where there is one
BETWEEN = 12  # steps between two pictures of those
CLUTTERED = 2  # of so many wires one is among clutter, where there is to be any
_CURVE_M = 0.5e-3  # between the points of a true curve

Frame = tuple[np.ndarray, np.ndarray]  # pictures, and curves


def frames_in(
    anatomy: Anatomy,
    settings: NavigationSettings,
    seed: int,
    teacher: Path | None,
    size_px: int,
    device: str = "cpu",
) -> list[Frame]:
    """(cameras, size, size) pictures and (cameras, 240, 2) curves, shares of sides, of inserted, then steered wires."""
    generator = np.random.default_rng((seed, int(phantom_of(anatomy).hash[:8], 16)))
    steered = 0 if teacher is None else round(_STEERED * settings.perception_frames)
    frames = _inserted_frames(anatomy, settings, size_px, settings.perception_frames - steered, generator)
    if teacher is not None and steered:
        frames += _steered(anatomy, settings, size_px, steered, generator, teacher, device)
    return frames


def _arms(arms: CArms, settings: NavigationSettings, number: int, generator: np.random.Generator) -> CArms:
    """The C-arms for the wire of a number, which may be among clutter of its own."""
    return among_clutter(arms, settings.clutter * (number % CLUTTERED == CLUTTERED - 1), generator)


def _steered(
    anatomy: Anatomy,
    settings: NavigationSettings,
    size_px: int,
    count: int,
    generator: np.random.Generator,
    teacher: Path,
    device: str,
) -> list[Frame]:
    """Pictures of episodes that a teacher steers, each with a share of noise in its actions, from none to all."""
    from cathsim.observations.c_arm_view import with_shaft
    from enn.imitation.dagger import PerturbedController
    from enn.policy import Policy

    policy = Policy.load(teacher, device)
    phantom, task = phantom_of(anatomy), settings.arch_task
    if isinstance(anatomy[0], AnatomyFile):  # whose ways may be longer than those of the arches
        anatomy_task = fitted_task(replace(task, wire_length_mm=0.0), phantom, settings.targets)
        task = max(task, anatomy_task, key=lambda one: one.guidewire().length)
    frames: list[Frame] = []
    for number in range(4 * count):
        if len(frames) >= count:
            break
        target = settings.targets[number % len(settings.targets)]
        scene = scene_of(task, anatomy, target, settings.arms, policy.keys)
        environment = scene.environment
        observation, _ = environment.reset(seed=int(generator.integers(2**31)))
        arms = _arms(scene.arms, settings, number, generator)
        steer = PerturbedController(policy, generator)
        over, step = False, 0
        while not over and len(frames) < count:
            observation, _, terminated, truncated, _ = environment.step(steer(observation))
            over, step = terminated or truncated, step + 1
            if step % BETWEEN == 0 and not over:
                simulation = environment.simulation
                nodes = with_shaft(simulation.wire_points(), simulation.vessel.direction)
                frame = _frame(phantom, arms, nodes, size_px, int(generator.integers(2**31)))
                if frame is not None:
                    frames.append(frame)
        environment.close()
    return frames


def _inserted_frames(
    anatomy: Anatomy,
    settings: NavigationSettings,
    size_px: int,
    count: int,
    generator: np.random.Generator,
) -> list[Frame]:
    """Pictures of wires that are inserted along ways and moved on from there."""
    from cathsim import ACCURACY, Simulation
    from cathsim.devices.wire_placement import pushed_shapes
    from cathsim.observations.c_arm_view import with_shaft

    phantom, task = phantom_of(anatomy), settings.task if anatomy[1] == NAMED else settings.arch_task
    wire = task.guidewire()
    entry = task.entry if anatomy[1] == NAMED else DESCENDING
    simulation = Simulation(phantom, wire.scaled(max(wire.length, 0.312)), ACCURACY["fast"], entry=entry)
    usual = [target for target in TARGETS if target in phantom.targets]
    ways = _ways(phantom, usual or settings.targets, simulation)
    frames: list[Frame] = []
    for number in range(4 * count):
        if len(frames) >= count or not ways:
            break
        arms = _arms(settings.arms_for(task), settings, number, generator)
        way = ways[int(generator.integers(len(ways)))]
        try:
            shapes = pushed_shapes(simulation, way, generator)
        except ValueError:  # too short a wire for this one
            continue
        for points in shapes:
            nodes = with_shaft(points, simulation.vessel.direction)
            frame = _frame(phantom, arms, nodes, size_px, int(generator.integers(2**31)))
            if frame is not None:
                frames.append(frame)
    return frames[:count]


def _ways(phantom: Phantom, targets: Sequence[str], simulation: Any) -> list[np.ndarray]:
    from cathsim.devices.wire_placement import plan_way
    from cathsim.planning.path import UnreachableError

    ways = []
    for target in targets:
        try:
            ways.append(plan_way(simulation, phantom.target(target).position))
        except UnreachableError:
            continue
    return ways


def _frame(phantom: Phantom, arms: CArms, nodes: np.ndarray, size_px: int, seed: int) -> Frame | None:
    """Pictures and curves of one moment; None where a camera does not see enough of the wire."""
    from cathsim.fluoroscopy.curve import smooth_curve
    from cathsim.observations.c_arm_view import fluoroscope_of, images_of_shape
    from guide3d.geometry.polyline import resample
    from splineformer.image_input import picture_of
    from splineformer.learning.augmentation import inside
    from splineformer.navigation.fine_tuning import CURVE_POINTS

    curve, _ = smooth_curve(nodes, _CURVE_M)
    cameras = fluoroscope_of(phantom, arms).cameras
    lines = []
    for name in arms.cameras:
        seen = inside((cameras[name].pixels(curve) + 0.5) / arms.image_size_px)
        if seen is None:
            return None
        lines.append(resample(seen, count=CURVE_POINTS))
    images = images_of_shape(phantom, arms, nodes, seed)
    pictures = [picture_of(image, size_px, arms.image_size_px).pixels for image in images]
    return np.stack(pictures), np.stack(lines)


PERCEPTION = "perception"  # job and folder
PREDICTOR, RECORD, FRAMES = "predictor.pt", "perception.json", "frames.npz"
_VALIDATION = 0.1  # share of the anatomies
_PREPARING = 0.3  # of the job's time


@dataclass(frozen=True)
class PerceptionJob:
    """The fine-tuning of the perception network."""

    folder: Path
    settings: NavigationSettings
    splineformer: Path  # model file of the stage splineformer
    anatomies: tuple[Anatomy, ...]  # whose wires are shown
    seed: int
    teacher: Path | None = None  # file of a policy that steers some of the wires; None: all are inserted


def fine_tune_perception(job: PerceptionJob, report: Report) -> dict[str, Any]:
    """Trains the SplineFormer further: ``images``, ``epochs``, errors before and after on other anatomies, px."""
    from guide3d.learning.training import finished
    from splineformer.navigation.fine_tuning import fine_tune
    from splineformer.predictor import Predictor

    if (job.folder / RECORD).is_file():
        return dict(read_json(job.folder / RECORD))
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
        pictures = _wire_pictures(job, predictor, report.part(0.0, _PREPARING, "frames"))
        with Curves(job.folder) as curves:
            predictor, errors = fine_tune(
                predictor, pictures, job.settings.splineformer, epochs,
                folder=job.folder / "fit", seed=job.seed, device=report.device, progress=progress,
            )  # fmt: skip
        outcome |= errors
    predictor.save(job.folder / PREDICTOR, navigation_epochs=epochs)
    write_json(job.folder / RECORD, outcome)
    finished(job.folder / "fit")
    (job.folder / FRAMES).unlink(missing_ok=True)
    return outcome


def load_perception(folder: Path, device: str = "cpu") -> PerceptionNetwork:
    """The perception network of a finished job, on the device where it reads images."""
    import torch

    from splineformer.navigation.perception import PerceptionNetwork
    from splineformer.predictor import Predictor

    torch.set_num_threads(1)
    return PerceptionNetwork(Predictor.load(folder / PERCEPTION / PREDICTOR, device=device))


def _wire_pictures(job: PerceptionJob, predictor: Predictor, report: Any) -> WirePictures:
    from splineformer.navigation.fine_tuning import WirePictures

    file = job.folder / FRAMES
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
            "held_out": np.tile(np.array(held_out), len(job.settings.cameras)),
        }
        write_arrays(file, arrays)
    with np.load(file) as content:
        return WirePictures(content["pictures"], content["curves"], content["held_out"])
