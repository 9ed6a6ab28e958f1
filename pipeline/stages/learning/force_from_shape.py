"""Forces from the logged shape of the wire, on the frames that the networks of the force stage are tested on."""

from __future__ import annotations

import json
import logging
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pipeline.jobs.worker import Report
from pipeline.stages.learning.expert_episodes import read_episodes
from pipeline.stages.learning.force import TEST_EVERY
from pipeline.store.atomic_files import write_json

if TYPE_CHECKING:
    from enn.trajectory import Trajectory

RECORD = "force.json"
PRELOAD = ("cathsim.statics",)

_LOGGER = logging.getLogger(__name__)


@dataclass(frozen=True)
class ShapeForceJob:
    """Contact forces of the test frames, estimated by `cathsim.statics`."""

    folder: Path
    phantom: str
    logs: tuple[Path, ...]  # folders of the disturbed episodes
    test_samples: int  # at most
    seed: int
    # whether the curve has noise of 0.5 mm, and stiffness, feeder and lumen errors; drawn for each episode
    disturbed: bool


def forces_from_shape(job: ShapeForceJob, report: Report) -> dict[str, Any]:
    """Estimates the resultant contact force of every test frame from the wire's points and the feeder's position.

    Returns:
        ``test_samples``, ``mse_n2``, ``variance_n2``, ``share_pct`` of the variance (None where all forces are the
        same), ``correlation``, ``refused`` (frames whose curve was refused, taken to be without force), ``cpu_s``.
    """
    from enn.force import score

    record = job.folder / RECORD
    if record.is_file():
        return dict(json.loads(record.read_text(encoding="utf-8")))
    worked = time.process_time()
    estimated, true, refused = test_frames(job, report)
    result = score(estimated, true)
    outcome = {
        "test_samples": result.samples,
        "mse_n2": result.mse_n2,
        "variance_n2": result.variance_n2,
        "share_pct": 100.0 * result.share_of_variance if result.variance_n2 > 0 else None,
        "correlation": result.correlation,
        "refused": refused,
        "cpu_s": time.process_time() - worked,
    }
    write_json(record, outcome)
    return outcome


def test_frames(job: ShapeForceJob, report: Report) -> tuple[NDArray[np.float64], NDArray[np.float32], int]:
    """Estimated and true forces of the test frames.

    Returns:
        Forces (N,) N, the true ones in the order of `pipeline.stages.learning.force.samples_of`, and how many curves
        were refused.
    """
    from cathsim import load_phantom
    from cathsim.statics.shape_series import forces_of_shapes
    from enn.force.samples import split_episodes

    groups = [read_episodes(sorted(folder.glob("*.mcap"))) for folder in job.logs]
    episodes = [episode for group in groups for episode in split_episodes(group, TEST_EVERY)[1]]
    phantom, parts, refused = load_phantom(job.phantom), [], 0
    for number, episode in enumerate(episodes):
        generator = np.random.default_rng((job.seed, number)) if job.disturbed else None
        shapes = episode.observations["shape"].astype(float)
        forces, out = forces_of_shapes(shapes, _feeders(episode), episode.metadata["devices"], phantom, generator)
        parts.append(forces[1:])  # the first is the state after the reset, in which no step has ended
        refused += out
        report((number + 1) / len(episodes), f"episode {number + 1} of {len(episodes)}")
    if refused:
        _LOGGER.warning("%d of %d curves were refused: their force is taken to be 0", refused, sum(map(len, parts)))
    estimated = np.concatenate(parts)
    true = np.concatenate([episode.forces for episode in episodes]).astype(np.float32)
    drawn = np.random.default_rng(job.seed).permutation(len(true))[: job.test_samples]
    return estimated[drawn], true[drawn], refused


test_frames.__test__ = False  # type: ignore[attr-defined]  # no test, for pytest


def _feeders(episode: Trajectory) -> NDArray[np.float64]:
    """Insertion (m) and rotation (rad, without jumps) of each feeder in every moment. Shape (T + 1, feeders, 2)."""
    observed = episode.observations["feeder"].astype(float)
    columns = [observed[:, start : start + 3] for start in range(0, observed.shape[1] - 2, 3)]
    return np.stack(
        [np.column_stack((one[:, 0], np.unwrap(np.arctan2(one[:, 2], one[:, 1])))) for one in columns], axis=1
    )
