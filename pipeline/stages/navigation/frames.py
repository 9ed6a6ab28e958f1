"""Pictures for the navigator's eye: wires laid along ways and pushed on, and wires that a teacher steers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.stages.navigation.scene import Rig, fluoroscope_of, images_of_shape, with_shaft
from pipeline.stages.navigation.task import Anatomy, phantom_of

if TYPE_CHECKING:
    from cathsim.anatomy import Phantom
    from pipeline.stages.navigation.perception import ReaderJob

_SHALLOWEST = 0.01  # m of wire inside the vessel
_MOVES = 8  # of 0.1 s, before each picture
_PICTURES = 6  # from one laid wire
_LEAN = -0.3, 1.0  # mean of a run's pushes, of the most in a step: a wire pushed on folds at the wall, as in navigation
_FORWARD, _TURN = 0.4, 0.7  # spread of the moves, of the most in a step
_STEERED = 0.6  # share of the pictures of wires that a teacher steers, where there is one
_BETWEEN = 12  # steps between two pictures of those
_CURVE_M = 0.5e-3  # between the points of a true curve

Frame = tuple[np.ndarray, np.ndarray]  # pictures, and curves


def frames_in(anatomy: Anatomy, job: ReaderJob, size_px: int, device: str = "cpu") -> list[Frame]:
    """Pictures of wires in an anatomy: laid ones, then steered ones.

    Args:
        anatomy: kind and seed.
        job: with targets, rig, number of frames, teacher and seed.
        size_px: of the pictures.

    Returns:
        A (cameras, size, size) stack of pictures and (cameras, 240, 2) curves as shares of the sides, each.
    """
    phantom = phantom_of(anatomy)
    generator = np.random.default_rng((job.seed, int(phantom.hash[:8], 16)))
    steered = 0 if job.teacher is None else round(_STEERED * job.frames)
    found = _laid(anatomy, job, size_px, job.frames - steered, generator)
    return found + _steered(anatomy, job, size_px, steered, generator, device)


def _steered(
    anatomy: Anatomy, job: ReaderJob, size_px: int, count: int, generator: np.random.Generator, device: str
) -> list[Frame]:
    """Pictures of episodes that a teacher steers, each with a share of noise in its actions, from none to all."""
    from enn.imitation.perturbed_controller import PerturbedController
    from enn.policy import Policy

    if not count:
        return []
    assert job.teacher is not None
    teacher = Policy.load(job.teacher, device)
    phantom = phantom_of(anatomy)
    found: list[Frame] = []
    for number in range(4 * count):
        if len(found) >= count:
            break
        target = job.taught[number % len(job.taught)]
        scene = job.rules.scene(anatomy, target, job.rig, teacher.keys)
        environment = scene.environment
        observation, _ = environment.reset(seed=int(generator.integers(2**31)))
        steer = PerturbedController(teacher, generator)
        over, step = False, 0
        while not over and len(found) < count:
            observation, _, terminated, truncated, _ = environment.step(steer(observation))
            over, step = terminated or truncated, step + 1
            if step % _BETWEEN == 0 and not over:
                simulation = environment.simulation
                nodes = with_shaft(simulation.wire_points(), simulation.vessel.direction)
                frame = _frame(phantom, scene.rig, nodes, size_px, int(generator.integers(2**31)))
                if frame is not None:
                    found.append(frame)
        environment.close()
    return found


def _laid(anatomy: Anatomy, job: ReaderJob, size_px: int, count: int, generator: np.random.Generator) -> list[Frame]:
    """Pictures of wires that are laid along ways and moved on from there."""
    from cathsim import ACCURACY, Simulation
    from cathsim.environment import ROTATION_STEP, TRANSLATION_STEP
    from cathsim.wire_placement import place_wire

    phantom, rules = phantom_of(anatomy), job.rules_in(anatomy)
    wire, rig = rules.task.guidewire(), rules.rig(job.rig)
    simulation = Simulation(phantom, wire.scaled(max(wire.length, 0.312)), ACCURACY["fast"])
    ways = _ways(phantom, job.targets, simulation)
    found: list[Frame] = []
    for _ in range(4 * count):
        if len(found) >= count or not ways:
            break
        way = ways[int(generator.integers(len(ways)))]
        length = float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum())
        try:
            place_wire(simulation, way, generator.uniform(0.005, length - _SHALLOWEST))
        except ValueError:  # too short a wire for this one
            continue
        turn, lean = generator.uniform(-1, 1), generator.uniform(*_LEAN)
        for _ in range(_PICTURES):
            for _ in range(_MOVES):
                push = np.clip(lean + _FORWARD * generator.standard_normal(), -1, 1)
                twist = np.clip(turn + _TURN * generator.standard_normal(), -1, 1)
                simulation.advance(TRANSLATION_STEP * float(push), ROTATION_STEP * float(twist))
            if not simulation.valid:
                break
            nodes = with_shaft(simulation.wire_points(), simulation.vessel.direction)
            frame = _frame(phantom, rig, nodes, size_px, int(generator.integers(2**31)))
            if frame is not None:
                found.append(frame)
    return found[:count]


def _ways(phantom: Phantom, targets: Sequence[str], simulation: Any) -> list[np.ndarray]:
    from cathsim.planning.path import UnreachableError
    from cathsim.wire_placement import plan_way

    ways = []
    for target in targets:
        try:
            ways.append(plan_way(simulation, phantom.target(target).position))
        except UnreachableError:
            continue
    return ways


def _frame(phantom: Phantom, rig: Rig, nodes: np.ndarray, size_px: int, seed: int) -> Frame | None:
    """Pictures and curves of one moment; None where a camera does not see enough of the wire."""
    from cathsim.fluoroscopy.curve import smooth_curve
    from guide3d.geometry.polyline import resample
    from splineformer.image_input import picture_of
    from splineformer.learning.augmentation import inside

    curve, _ = smooth_curve(nodes, _CURVE_M)
    cameras = fluoroscope_of(phantom, rig, rig.filling).cameras
    lines = []
    for name in rig.cameras:
        seen = inside((cameras[name].pixels(curve) + 0.5) / rig.image_size_px)
        if seen is None:
            return None
        lines.append(resample(seen, count=240))
    images = images_of_shape(phantom, rig, nodes, seed)
    pictures = [picture_of(image, size_px, rig.image_size_px).pixels for image in images]
    return np.stack(pictures), np.stack(lines)
