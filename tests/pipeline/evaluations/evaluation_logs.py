"""Small evaluation logs and training curves for the tests of the report's learning part."""

import csv
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.episodes import DeviceRecord, EpisodeInfo, EpisodeOutcome, EpisodeWriter, StepRecord

RADIUS = 0.008  # m
MAX_STEPS = 300


def write_evaluation(
    path: Path,
    *,
    steps: int = 4,
    force: float = 0.1,
    way: float = 0.2,
    success: bool = True,
    operator: str = "policy",
    phantom: str = "type_1",
    phantom_hash: str = "5f" * 32,
    target: str = "bca",
    seed: int = 0,
    contacts: int = 2,
    status: str = "finished",
    end_distance: float | None = None,
    outcome_success: bool | None = None,
    started_ns: int = 1_700_000_000_000_000_000,
    task: dict[str, Any] | None = None,
    loads: dict[str, float] | None = None,
    catheter: str | None = None,
    feeder_forces: tuple[float, float] = (0.0, 0.0),
    **metadata: Any,
) -> Path:
    """A log of a straight way of `way` metres in equal steps, each with the same resultant force.

    Distances to the target fall from 0.1 m by equal steps to `end_distance`: 4 mm on success, 30 mm otherwise. Every
    step has `contacts` contacts that share the force. The first record, the state after reset, has a force of 9 N,
    which counts nowhere. `loads` are further scalars of every record. With a `catheter`, the feeders
    push with `feeder_forces`. Returns the path.
    """
    devices = None
    if catheter is not None:
        metadata |= {"catheter": {"length": float(len(catheter))}, "catheter_preset": catheter, "torsion": "elastic"}
        pairs = dict.fromkeys(("insertions", "hub_rotations", "tip_rotations", "hub_torques"), np.zeros(2))
        points = dict.fromkeys(("wire_points", "catheter_points"), np.zeros((2, 3)))
        devices = DeviceRecord(**pairs, **points, lead=0.0, feeder_forces=np.array(feeder_forces))
    end = (0.004 if success else 0.03) if end_distance is None else end_distance
    distances = np.linspace(0.1, end, steps + 1)
    usual = {"success_radius": RADIUS, "start_jitter": 0.001, "max_steps": MAX_STEPS}
    episode = {"target": target, "seed": seed, "operator": operator, "start_time_ns": started_ns}
    info = _info(phantom, phantom_hash, {**usual, **(task or {}), **metadata}, **episode)
    path.parent.mkdir(parents=True, exist_ok=True)
    with EpisodeWriter(path, info, overwrite=True) as log:
        for step in range(steps + 1):
            last = step == steps
            ended = {"terminated": last and success, "truncated": last and not success}
            extra = {"distance_m": float(distances[step]), **(loads or {})}
            tip = np.array([0.0, 0.0, way * step / steps])
            places = np.zeros((contacts, 3))
            log.step(_step(step, force if step else 9.0, places, tip=tip, extra=extra, devices=devices, **ended))
        said = success if outcome_success is None else outcome_success
        log.finish(EpisodeOutcome(success=said, steps=steps, status=status))
    return path


def _info(phantom: str, phantom_hash: str, configuration: dict[str, Any], **further: Any) -> EpisodeInfo:
    place = {"phantom": phantom, "phantom_hash": phantom_hash, "entry": "descending"}
    return EpisodeInfo(**place, control_dt=0.1, configuration=configuration, versions={}, **further)


def _step(step: int, pressed: float, places: np.ndarray, **further: Any) -> StepRecord:
    """A record whose contacts, at these places, share a force."""
    forces = np.tile([pressed / max(len(places), 1), 0.0, 0.0], (len(places), 1))
    contacts = {"contact_positions": places, "contact_forces": forces, "resultant_force": np.array([0.0, pressed, 0.0])}
    still = {"joint_positions": np.zeros(2), "joint_velocities": np.zeros(2), "wire_points": np.zeros((2, 3))}
    still |= {"tip": np.zeros(3), "insertion": 0.0, "rotation": 0.0, "terminated": False, "truncated": False}
    # the training's reward is another one than the thesis's
    return StepRecord(step=step, action=np.zeros(2), reward=1.0, **contacts | still | further)


def write_row(
    run: Path,
    stage: str,
    row: str,
    *,
    successes: tuple[bool, ...] = (True, True),
    folder: str = "",
    seed: int = 0,
    phantom: str = "type_1",
    target: str = "bca",
    mode: str = "deterministic",
    variant: str = "desk",
    **log: Any,
) -> list[Path]:
    """The evaluation logs of one training, one an entry of `successes`, with the metadata that a stage gives them."""
    base = run / (folder or stage) / phantom / target / row / f"seed{seed}" / "evaluation" / mode
    first = 1_000_000 + 1000 * seed
    origin = {"stage": stage, "row": row, "mode": mode, "training_seed": seed, "variant": variant}
    given = {"phantom": phantom, "target": target, **origin, **log}
    return [
        write_evaluation(base / f"{index:03d}.mcap", success=success, seed=first + index, **given)
        for index, success in enumerate(successes)
    ]


def write_curve(folder: Path, *, end: int = 1000, success: float = 1.0, evaluated: bool = True) -> Path:
    """A training curve of eleven lines in the folder of a training, evaluated on every second."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "training.csv"
    head = ("decisions", "env_steps", "wall_s", "cpu_s", "reward", "episode_length", "success", "evaluation_success",
            "evaluation_length", "evaluation_force")  # fmt: skip
    with path.open("w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream)
        table.writerow(head)
        for part in range(11):
            share = part / 10
            checked = (share * success, 300 - 200 * share, 0.1) if evaluated and part % 2 == 0 else ("", "", "")
            at = round(end * share)
            table.writerow([at, 4 * at, at / 50, at / 100, -0.1 + 0.05 * share, 300 - 100 * share, share, *checked])
    return path


def write_force_log(path: Path, forces: np.ndarray, *, phantom: str = "type_1", target: str = "bca") -> None:
    """A log whose step i > 0 has two contacts that share the force forces[i - 1], and none where that is zero."""
    configuration = {"expert": {"free_force": 0.15}}
    path.parent.mkdir(parents=True, exist_ok=True)
    with EpisodeWriter(
        path, _info(phantom, "5f" * 32, configuration, target=target, seed=0, operator="sampling_expert")
    ) as log:
        for step, force in enumerate([7.0, *forces]):  # what lies in the state after reset does not count
            log.step(_step(step, force, np.tile([0.0, 0.01, 0.001 * step], (2 if force > 0 else 0, 1))))
        log.finish(EpisodeOutcome(success=True, steps=len(forces), metrics={}))
