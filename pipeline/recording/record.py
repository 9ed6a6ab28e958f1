"""Recording an episode: a policy steers the simulator, every step goes to a log, and some to a film."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.episodes import Camera, DeviceRecord, EpisodeInfo, EpisodeOutcome, EpisodeWriter, PhantomMesh, StepRecord
from pipeline.store.provenance import software_versions

if TYPE_CHECKING:
    from cathsim import NavigateEnv, Phantom
    from cathsim.anatomy.point_target import Point
    from cathsim.devices.simulation import DualSimulation
    from cathsim.fluoroscopy import Projector
    from cathsim.metrics import EpisodeMetrics
    from cathsim.simulation import Simulation
    from cathsim.viewing.film import Film

CAMERA = "frontal"
ANATOMY = "anatomy"  # key of a log's configuration: what a file's anatomy was imported with
_MESH_STRIDE = 3  # grid nodes a node of the logged mesh: a viewer needs no finer wall

DEVICES = ("wire", "catheter")  # with masks of their own

Policy = Callable[[Any, Mapping[str, Any]], np.ndarray]  # observation, info -> action


def step_record(
    environment: NavigateEnv,
    step: int,
    action: np.ndarray,
    reward: float,
    info: Mapping[str, Any],
    *,
    terminated: bool = False,
    truncated: bool = False,
    further: Mapping[str, float] | None = None,
) -> StepRecord:
    """The record of a step (0: the state after reset) that the environment has just made, with further scalars."""
    from cathsim.metrics.load_cell import step_forces

    simulation = environment.simulation
    contacts, forces = simulation.contacts(), step_forces(simulation)
    return StepRecord(
        step=step,
        action=np.asarray(action, np.float64),
        reward=reward,
        terminated=terminated,
        truncated=truncated,
        joint_positions=simulation.joint_positions(),
        joint_velocities=simulation.joint_velocities(),
        wire_points=simulation.wire_points(),
        tip=info["tip"],
        contact_positions=contacts.points,
        contact_forces=contacts.forces,
        resultant_force=info["force_vector"],
        insertion=info["insertion"],
        rotation=info["rotation"],
        extra={
            "distance_m": info["distance"],
            **{f"load_{axis}_n": float(value) for axis, value in zip("xyz", forces.load, strict=True)},
            **{f"sheath_{axis}_n": float(value) for axis, value in zip("xyz", forces.sheath, strict=True)},
            "magnitude_sum_n": forces.magnitude_sum,
            "largest_contact_n": forces.largest_contact,
            **(further or {}),
        },
        devices=device_record(simulation),
    )


def device_record(simulation: Simulation) -> DeviceRecord | None:
    """Both devices of the moment; None of a wire without a catheter."""
    devices = with_catheter(simulation)
    if devices is None:
        return None
    return DeviceRecord(
        wire_points=devices.device_points("wire"),
        catheter_points=devices.device_points("catheter"),
        insertions=np.array(devices.device_insertions()),
        hub_rotations=np.array(devices.device_rotations()),
        tip_rotations=devices.tip_rotations(),
        lead=devices.device_lead,
        feeder_forces=devices.feeder_forces(),
        hub_torques=devices.hub_torques(),
    )


def with_catheter(simulation: Simulation) -> DualSimulation | None:
    """The simulation where a catheter is one of its devices; None of a wire alone."""
    from cathsim.devices.simulation import DualSimulation

    return simulation if isinstance(simulation, DualSimulation) and simulation.pair.catheter is not None else None


def cameras_of(environment: NavigateEnv) -> dict[str, Camera]:
    """Every camera of an environment by its topic's name: the frontal view, then those of `cameras`."""
    cameras = {CAMERA: _camera(environment.fluoroscope.renderer.projector)}
    if environment.biplane is not None:
        views = environment.biplane.fluoroscope.cameras
        cameras |= {name: _camera(view.projector) for name, view in views.items()}
    return cameras


def _camera(projector: Projector) -> Camera:
    return Camera(
        P=projector.P, K=projector.K, R=projector.R, t=projector.t, width=projector.width, height=projector.height
    )


@functools.lru_cache(maxsize=32)
def phantom_mesh(phantom: Phantom, target: str | Point, entry: str) -> PhantomMesh:
    """A coarse surface of a phantom's lumen for viewers, with target and entry."""
    from cathsim.anatomy.surface import lumen_surface

    mesh = lumen_surface(phantom.grid.coarser(_MESH_STRIDE))
    return PhantomMesh(
        vertices=np.asarray(mesh.vertices),
        faces=np.asarray(mesh.faces),
        target=phantom.target(target).position,
        entry=phantom.entry(entry).position,
    )


def describe_episode(
    environment: NavigateEnv, *, seed: int, operator: str, configuration: Mapping[str, Any] | None = None
) -> EpisodeInfo:
    """What is known of an episode before its first step: operator, task, devices, and a further configuration."""
    from cathsim.navigation import reward_name
    from cathsim.presets import PACES

    return EpisodeInfo(
        phantom=environment.phantom.name,
        phantom_hash=environment.phantom.hash,
        target=environment.task.target_name,
        entry=environment.simulation.entry,
        seed=seed,
        operator=operator,
        control_dt=environment.simulation.pace.interval,
        configuration={
            **asdict(environment.task),
            "reward": reward_name(environment.task.reward),
            "image_size": environment.fluoroscope.shape[0],
            **_devices_of(environment.simulation),
            "numerics": asdict(environment.simulation.numerics),
            **({} if environment.simulation.pace == PACES["usual"] else {"pace": asdict(environment.simulation.pace)}),
            **({} if environment.biplane is None else {"cameras": environment.biplane.fluoroscope.to_json()}),
            **_imported_from(environment.phantom),
            **(configuration or {}),
        },
        versions=software_versions(),
    )


def _imported_from(phantom: Phantom) -> dict[str, Any]:
    """Where the anatomy of a file came from, so that the episode can be repeated; nothing of another anatomy."""
    from cathsim.anatomy.library import phantom_to_spec

    return {} if phantom.source is None else {ANATOMY: phantom_to_spec(phantom)}


def _devices_of(simulation: Simulation) -> dict[str, Any]:
    """The devices as a log's configuration holds them: a preset's values may change, so they stand there themselves."""
    from cathsim.devices.shelf import catheter_preset_of

    devices = with_catheter(simulation)
    if devices is None:
        return {"wire": asdict(simulation.wire)}
    pair = devices.pair
    assert pair.catheter is not None
    return {
        "wire": None if pair.wire is None else asdict(pair.wire),
        "catheter": asdict(pair.catheter),
        "catheter_preset": catheter_preset_of(pair.catheter),
        "torsion": pair.torsion,
    }


def open_log(
    environment: NavigateEnv, path: Path, info: EpisodeInfo, *, overwrite: bool, pictures: bool = True
) -> EpisodeWriter:
    """Starts an episode's log with the environment's fluoroscope, unless it has no pictures, and phantom."""
    path.parent.mkdir(parents=True, exist_ok=True)
    return EpisodeWriter(
        path,
        info,
        cameras=cameras_of(environment) if pictures else {},
        phantom_mesh=phantom_mesh(environment.phantom, environment.task.target, info.entry),
        overwrite=overwrite,
    )


def logged_pictures(environment: NavigateEnv) -> dict[str, Any]:
    """Images and masks of the moment, with a catheter also the mask of each device: arguments of a writer's `step`."""
    fluoroscope, biplane = environment.fluoroscope, environment.biplane
    views = () if biplane is None else biplane.fluoroscope.names

    def masks(device: str | None) -> dict[str, np.ndarray]:
        seen = {CAMERA: fluoroscope.mask(device)}
        return seen if biplane is None else seen | {name: biplane.mask(name, device) for name in views}

    images = {CAMERA: fluoroscope.image()}
    if biplane is not None:
        images |= {name: biplane.frame(name).image for name in views}
    both = with_catheter(environment.simulation) is not None
    return {
        "images": images,
        "masks": masks(None),
        "device_masks": {device: masks(device) for device in DEVICES} if both else {},
    }


def record_episode(
    environment: NavigateEnv,
    policy: Policy,
    path: Path,
    *,
    seed: int,
    operator: str,
    configuration: Mapping[str, Any] | None = None,
    film: Film | None = None,
    pictures: bool = True,
) -> EpisodeMetrics:
    """Runs one episode and logs it; the log appears under its name only when it is whole.

    Args:
        path: of the log; one that is there is replaced.
        operator: who steers, e.g. "sampling_expert".
        pictures: log image and mask of every step, whatever the observation is; without, nothing is drawn that the
            policy does not look at.

    Returns:
        The episode's metrics, also kept in the log's outcome.
    """
    from cathsim.metrics import EpisodeMetrics

    observation, info = environment.reset(seed=seed)
    tips, forces, rewards = [info["tip"]], [], []
    description = describe_episode(environment, seed=seed, operator=operator, configuration=configuration)
    action: np.ndarray = np.zeros(environment.action_space.shape or (), np.float32)
    reward, terminated, truncated, step = 0.0, False, False, 0
    with open_log(environment, path, description, overwrite=True, pictures=pictures) as log:
        while True:
            record = step_record(environment, step, action, reward, info, terminated=terminated, truncated=truncated)
            log.step(record, **(logged_pictures(environment) if pictures else {}))
            if film is not None:
                film.add(environment)
            if terminated or truncated:
                break
            action = np.asarray(policy(observation, info), environment.action_space.dtype)  # as a replay gives it
            observation, reward, terminated, truncated, info = environment.step(action)
            step += 1
            tips.append(info["tip"])
            forces.append(info["force"])
            rewards.append(reward)
        metrics = EpisodeMetrics.from_arrays(
            np.array(tips),
            np.array(forces),
            np.array(rewards),
            bool(info["success"]),
            target=description.target,
            ending=info,
        )
        log.finish(EpisodeOutcome(success=metrics.success, steps=step, metrics=asdict(metrics)))
    return metrics
