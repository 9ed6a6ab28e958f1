"""Small evaluation logs and training curves for the tests of the report's learning part."""

from __future__ import annotations

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
    info = EpisodeInfo(
        phantom=phantom,
        phantom_hash="5f" * 32,
        target=target,
        entry="descending",
        seed=seed,
        operator=operator,
        control_dt=0.1,
        start_time_ns=started_ns,
        configuration={
            "success_radius": RADIUS,
            "start_jitter": 0.001,
            "max_steps": MAX_STEPS,
            **(task or {}),
            **metadata,
        },
        versions={},
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    with EpisodeWriter(path, info, overwrite=True) as log:
        for step in range(steps + 1):
            pressed = force if step else 9.0
            log.step(
                StepRecord(
                    step=step,
                    action=np.zeros(2),
                    reward=1.0,  # the training's reward is another one than the thesis's
                    terminated=step == steps and success,
                    truncated=step == steps and not success,
                    joint_positions=np.zeros(2),
                    joint_velocities=np.zeros(2),
                    wire_points=np.zeros((2, 3)),
                    tip=np.array([0.0, 0.0, way * step / steps]),
                    contact_positions=np.zeros((contacts, 3)),
                    contact_forces=np.tile([pressed / max(contacts, 1), 0.0, 0.0], (contacts, 1)),
                    resultant_force=np.array([0.0, pressed, 0.0]),
                    insertion=0.0,
                    rotation=0.0,
                    extra={"distance_m": float(distances[step]), **(loads or {})},
                    devices=devices,
                )
            )
        said = success if outcome_success is None else outcome_success
        log.finish(EpisodeOutcome(success=said, steps=steps, status=status))
    return path


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
    return [
        write_evaluation(
            base / f"{index:03d}.mcap",
            success=success,
            phantom=phantom,
            target=target,
            seed=first + index,
            **{**origin, **log},
        )
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
    info = EpisodeInfo(
        phantom=phantom, phantom_hash="5f" * 32, target=target, entry="descending", seed=0, operator="sampling_expert",
        control_dt=0.1, configuration={"expert": {"free_force": 0.15}}, versions={},
    )  # fmt: skip
    path.parent.mkdir(parents=True, exist_ok=True)
    with EpisodeWriter(path, info) as log:
        for step, force in enumerate([7.0, *forces]):  # what lies in the state after reset does not count
            count = 2 if force > 0 else 0
            log.step(
                StepRecord(
                    step=step,
                    action=np.zeros(2),
                    reward=0.0,
                    terminated=False,
                    truncated=False,
                    joint_positions=np.zeros(4),
                    joint_velocities=np.zeros(4),
                    wire_points=np.zeros((3, 3)),
                    tip=np.zeros(3),
                    contact_positions=np.tile([0.0, 0.01, 0.001 * step], (count, 1)),
                    contact_forces=np.tile([0.5 * force, 0.0, 0.0], (count, 1)),
                    resultant_force=np.array([0.0, force, 0.0]),
                    insertion=0.0,
                    rotation=0.0,
                )
            )
        log.finish(EpisodeOutcome(success=True, steps=len(forces), metrics={}))
