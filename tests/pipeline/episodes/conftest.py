"""A small episode as ground truth for the tests of the log."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.episodes import Camera, DeviceRecord, EpisodeInfo, EpisodeOutcome, EpisodeWriter, PhantomMesh, StepRecord

WIDTH, HEIGHT = 33, 20


@dataclass
class Episode:
    """All that goes into a log, kept to be compared with what comes out."""

    info: EpisodeInfo
    cameras: dict[str, Camera]
    mesh: PhantomMesh
    outcome: EpisodeOutcome
    records: list[StepRecord] = field(default_factory=list)
    images: list[np.ndarray] = field(default_factory=list)
    masks: list[np.ndarray] = field(default_factory=list)

    def record_steps(self, log: EpisodeWriter, start: int = 0, stop: int | None = None) -> None:
        """Give steps start..stop to a writer."""
        for i in range(start, len(self.records) if stop is None else stop):
            log.step(self.records[i], images={"frontal": self.images[i]}, masks={"frontal": self.masks[i]})

    def writer(self, path: Path, **arguments: Any) -> EpisodeWriter:
        """Start a log of this episode."""
        arguments = {"flush_every": 5, **arguments}
        return EpisodeWriter(path, self.info, cameras=self.cameras, phantom_mesh=self.mesh, **arguments)

    def write(self, path: Path, **arguments: Any) -> Path:
        """Write this episode as a finished log."""
        with self.writer(path, **arguments) as log:
            self.record_steps(log)
            log.finish(self.outcome)
        return path


def draw_record(step: int, rng: np.random.Generator, contacts: int = 3) -> StepRecord:
    """Draw a step whose every field is distinct."""
    return StepRecord(
        step=step,
        action=rng.normal(size=2).astype(np.float32),
        reward=float(rng.normal()),
        terminated=bool(step % 2),
        truncated=bool(step % 3),
        joint_positions=rng.normal(size=7),
        joint_velocities=rng.normal(size=6),
        wire_points=rng.normal(size=(5, 3)),
        tip=rng.normal(size=3),
        contact_positions=rng.normal(size=(contacts, 3)),
        contact_forces=rng.normal(size=(contacts, 3)),
        resultant_force=rng.normal(size=3),
        insertion=float(rng.normal()),
        rotation=float(rng.normal()),
        extra={"distance_m": float(rng.normal()), "geodesic_m": float(rng.normal())},
    )


def draw_camera() -> Camera:
    """Make a camera in an oblique pose."""
    K = np.array([[400.0, 0, 16.25], [0, 410.0, 9.5], [0, 0, 1]])
    angle = 0.4
    R = np.array(
        [[np.cos(angle), np.sin(angle), 0], [0, 0, -1], [-np.sin(angle), np.cos(angle), 0]]
    )  # x right, y down = -z of the world, z away
    t = np.array([0.01, -0.02, 0.7])
    return Camera(P=K @ np.column_stack((R, t)), K=K, R=R, t=t, width=WIDTH, height=HEIGHT)


def draw_episode(steps: int, seed: int = 0) -> Episode:
    """Draw an episode of so many records."""
    rng = np.random.default_rng(seed)
    info = EpisodeInfo(
        phantom="type_1",
        phantom_hash="5f" * 32,
        target="bca",
        entry="descending_aorta",
        seed=17,
        operator="sampling_expert",
        control_dt=0.1,
        start_time_ns=1_731_000_000_123_456_789,
        configuration={"budget": "smoke", "threshold_m": 0.008, "cameras": ["frontal"]},
        versions={"numpy": np.__version__},
    )
    mesh = PhantomMesh(
        vertices=rng.normal(size=(40, 3)),
        faces=rng.integers(40, size=(60, 3)),
        target=np.array([0.01, 0.0, 0.08]),
        entry=np.array([0.0, 0.02, -0.09]),
    )
    outcome = EpisodeOutcome(success=True, steps=steps - 1, metrics={"path_length_m": 0.1573, "spl": 0.1 + 0.2})
    episode = Episode(info, {"frontal": draw_camera()}, mesh, outcome)
    for i in range(steps):
        episode.records.append(draw_record(i, rng, contacts=i % 4))
        episode.images.append(rng.integers(0, 256, (HEIGHT, WIDTH), dtype=np.uint8))
        episode.masks.append(rng.random((HEIGHT, WIDTH)) < 0.2)
    return episode


def compare_records(found: Any, given: StepRecord | DeviceRecord) -> None:
    """Compare two steps, or the devices of two, bit by bit."""
    for name in given.__dataclass_fields__:
        one, other = getattr(found, name), getattr(given, name)
        if isinstance(other, np.ndarray):
            assert one.shape == other.shape, name
            assert one.dtype == other.dtype, name
            assert one.tobytes() == other.tobytes(), name
        else:
            assert one == other, name


@pytest.fixture
def episode() -> Episode:
    """An episode of 23 records: four whole flushes and a rest."""
    return draw_episode(23)


@pytest.fixture
def assert_same() -> Callable[[StepRecord, StepRecord], None]:
    """Compare two steps bit by bit."""
    return compare_records


@pytest.fixture
def make_episode() -> Callable[..., Episode]:
    """Draw an episode of another length."""
    return draw_episode


@pytest.fixture
def log_path(episode: Episode, tmp_path: Path) -> Path:
    """A finished log of the episode."""
    return episode.write(tmp_path / "episode.mcap")
