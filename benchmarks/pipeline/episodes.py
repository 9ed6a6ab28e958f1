"""Cost of episode logs: writing beside an environment's step, reading in sequence and at random, bytes a step.

Keys of the last line, beside the real environment, in one loop and in processor time: write_cost_pct (all writing, with
opening and finishing, over the environment's step with image and mask), env_step_us, env_write_us, env_open_finish_us,
env_bytes_per_step. With synthetic steps in a tight loop: random_access_ms, random_access_with_image_ms, write_us,
read_us_per_step, bytes_per_step, steps, and once an episode open_us and finish_us.
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cathsim import NavigateEnv
from pipeline.episodes import Camera, EpisodeInfo, EpisodeOutcome, EpisodeReader, EpisodeWriter, StepRecord
from pipeline.recording.record import CAMERA, cameras_of, step_record

SIZE = 80


@dataclass
class Recording:
    """Steps with their pictures."""

    records: list[StepRecord] = field(default_factory=list)
    images: list[NDArray[np.uint8]] = field(default_factory=list)
    masks: list[NDArray[np.bool_]] = field(default_factory=list)


def synthetic_recording(steps: int) -> Recording:
    """Draw steps of realistic size: 56 joints, 29 wire points, 10 contacts, a noisy fluoroscopy picture and mask."""
    rng = np.random.default_rng(0)
    recording = Recording()
    rows, columns = np.mgrid[:SIZE, :SIZE]
    background = 150 + 40 * np.sin(columns / 25) * np.cos(rows / 31)
    for i in range(steps):
        arc = np.linspace(0, 0.1, 29) + 1e-4 * i
        wire = np.stack((0.02 * np.sin(20 * arc), 0.01 * np.cos(15 * arc), 0.1 - arc), axis=1)
        wire += rng.normal(0, 1e-6, wire.shape)
        forces = rng.normal(0, 0.05, (10, 3))
        mask = np.abs(columns - 40 - 12 * np.sin(rows / 14 + i / 40)) < 1.0
        image = np.clip(background - 70 * mask + rng.normal(0, 5, mask.shape), 0, 255).astype(np.uint8)
        recording.records.append(
            StepRecord(
                step=i,
                action=rng.uniform(-1, 1, 2),
                reward=float(rng.normal()),
                terminated=False,
                truncated=False,
                joint_positions=rng.normal(0, 0.1, 56),
                joint_velocities=rng.normal(0, 1, 56),
                wire_points=wire,
                tip=wire[0],
                contact_positions=wire[:10],
                contact_forces=forces,
                resultant_force=forces.sum(axis=0),
                insertion=1e-4 * i,
                rotation=0.01 * i,
                extra={"distance_to_target": float(rng.uniform())},
            )
        )
        recording.images.append(image)
        recording.masks.append(mask)
    return recording


def environment_cost(folder: Path, steps: int, episodes: int) -> dict[str, float]:
    """Step the real environment and log every step in the same loop, with caches as cold as they are in use.

    Returns:
        Microseconds of processor time for a step of the environment with image and mask, and for its logging, which
        includes reading the simulator and making the record.
    """
    env = NavigateEnv(observation=("image", "mask"), max_steps=steps)
    cameras = cameras_of(env)
    rng = np.random.default_rng(0)
    env_s, log_s, opened_s, steps_taken, size = 0.0, 0.0, 0.0, 0, 0
    clock = time.process_time  # time that the system gives to other processes falls on neither side
    for episode in range(episodes):
        observation, info = env.reset(seed=episode)
        action, reward, terminated, truncated, step = np.zeros(2, np.float32), 0.0, False, False, 0
        start = clock()
        log = EpisodeWriter(folder / f"environment_{episode}.mcap", example_info(episode), cameras=cameras)
        opened_s += clock() - start
        while True:
            start = clock()
            record = step_record(env, step, action, reward, info, terminated=terminated, truncated=truncated)
            log.step(record, images={CAMERA: observation["image"][0]}, masks={CAMERA: observation["mask"][0]})
            log_s += clock() - start
            if terminated or truncated:
                break
            action = np.array([rng.uniform(0, 1), rng.uniform(-1, 1)], np.float32)
            start = clock()
            observation, reward, terminated, truncated, info = env.step(action)
            env_s += clock() - start
            step += 1
        start = clock()
        path = log.finish(EpisodeOutcome(success=bool(terminated), steps=step))
        opened_s += clock() - start
        steps_taken += step
        size += path.stat().st_size
    return {
        "env_step_us": env_s / steps_taken * 1e6,
        "env_write_us": log_s / steps_taken * 1e6,
        "env_open_finish_us": opened_s / steps_taken * 1e6,
        "env_bytes_per_step": size / steps_taken,
    }


def best_us(action: Callable[[], object], count: int, repeats: int) -> float:
    """Median microseconds a thing of an action that does `count` things."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        action()
        times.append((time.perf_counter() - start) / count * 1e6)
    return statistics.median(times)


def example_camera() -> Camera:
    """Make an 80-pixel camera that looks along +y."""
    K = np.array([[800.0, 0, 39.5], [0, 800, 39.5], [0, 0, 1]])
    R = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    t = np.array([0.0, 0, 0.7])
    return Camera(P=K @ np.column_stack((R, t)), K=K, R=R, t=t, width=SIZE, height=SIZE)


def example_info(seed: int) -> EpisodeInfo:
    """Make the information of an episode."""
    return EpisodeInfo(
        phantom="type_1",
        phantom_hash="0" * 64,
        target="bca",
        entry="descending",
        seed=seed,
        operator="benchmark",
        control_dt=0.1,
        start_time_ns=1_700_000_000_000_000_000,
    )


def measure(recording: Recording, folder: Path, repeats: int) -> dict[str, object]:
    """Write and read a recording; give the figures by key."""
    path, count = folder / "episode.mcap", len(recording.records)
    info = example_info(0)
    opens, writes, finishes = [], [], []
    for _ in range(repeats):
        path.unlink(missing_ok=True)
        start = time.perf_counter()
        log = EpisodeWriter(path, info, cameras={"frontal": example_camera()})
        opened = time.perf_counter()
        for record, image, mask in zip(recording.records, recording.images, recording.masks, strict=True):
            # Making the record is part of the cost: its arrays are checked then.
            log.step(replace(record), images={"frontal": image}, masks={"frontal": mask})
        written = time.perf_counter()
        log.finish(EpisodeOutcome(success=True, steps=count - 1))
        finished = time.perf_counter()
        opens.append((opened - start) * 1e6)
        writes.append((written - opened) / count * 1e6)
        finishes.append((finished - written) * 1e6)
    order = np.random.default_rng(1).integers(count, size=200)
    with EpisodeReader(path) as log_reader:
        read_us = best_us(lambda: [record.step for record in log_reader], count, repeats)

        def random_access() -> None:
            for step in order:
                log_reader.step(int(step))

        random_us = best_us(random_access, len(order), repeats)

        def random_picture() -> None:
            for step in order:
                log_reader.step(int(step))
                log_reader.image("frontal", int(step))

        picture_us = best_us(random_picture, len(order), repeats)
    return {
        "random_access_ms": round(random_us / 1e3, 4),
        "random_access_with_image_ms": round(picture_us / 1e3, 4),
        "write_us": round(statistics.median(writes), 1),
        "open_us": round(statistics.median(opens)),
        "finish_us": round(statistics.median(finishes)),
        "read_us_per_step": round(read_us, 1),
        "bytes_per_step": round(path.stat().st_size / count),
        "steps": count,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--quick", action="store_true", help="fewer repeats, under 50 s")
    parser.add_argument("--steps", type=int, default=300, help="records an episode (default 300)")
    arguments = parser.parse_args()
    repeats = 7 if arguments.quick else 25
    with tempfile.TemporaryDirectory() as folder:
        cost = environment_cost(Path(folder), arguments.steps, 3 if arguments.quick else 10)
        written = cost["env_write_us"] + cost["env_open_finish_us"]
        figures: dict[str, object] = {"write_cost_pct": round(100 * written / cost["env_step_us"], 2)}
        figures |= {key: round(value, 1) for key, value in cost.items()}
        figures |= measure(synthetic_recording(arguments.steps), Path(folder), repeats)
    for key, value in figures.items():
        print(f"{key:<28} {value}")
    print(json.dumps(figures))


if __name__ == "__main__":
    main()
