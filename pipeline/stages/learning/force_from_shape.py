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
    from cathsim import Phantom
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
    from enn.force.samples import split_episodes

    groups = [read_episodes(sorted(folder.glob("*.mcap"))) for folder in job.logs]
    episodes = [episode for group in groups for episode in split_episodes(group, TEST_EVERY)[1]]
    phantom, parts, refused = load_phantom(job.phantom), [], 0
    for number, episode in enumerate(episodes):
        generator = np.random.default_rng((job.seed, number)) if job.disturbed else None
        forces, out = _episode_forces(episode, phantom, generator)
        parts.append(forces)
        refused += out
        report((number + 1) / len(episodes), f"episode {number + 1} of {len(episodes)}")
    if refused:
        _LOGGER.warning("%d of %d curves were refused: their force is taken to be 0", refused, sum(map(len, parts)))
    estimated = np.concatenate(parts)
    true = np.concatenate([episode.forces for episode in episodes]).astype(np.float32)
    drawn = np.random.default_rng(job.seed).permutation(len(true))[: job.test_samples]
    return estimated[drawn], true[drawn], refused


test_frames.__test__ = False  # type: ignore[attr-defined]  # no test, for pytest


def _episode_forces(
    episode: Trajectory, phantom: Phantom, generator: np.random.Generator | None
) -> tuple[NDArray[np.float64], int]:
    """Estimated forces (T,) N of an episode's steps, and how many curves were refused."""
    from cathsim.devices.pair import DevicePair
    from cathsim.statics import (
        ContactForceEstimator,
        DrawnErrors,
        Uncertainty,
        drawn_errors,
        inserted_part,
        noisy_curve,
    )

    devices = episode.metadata["devices"]
    outer = devices.get("catheter") or devices["wire"]
    device, sizes = devices["wire"] if outer is devices["wire"] else DevicePair(**devices), Uncertainty()
    known = DrawnErrors(phantom, device, 0.0, 0.0)
    if generator is not None:
        known = drawn_errors(phantom, device, sizes, generator)
    estimator = ContactForceEstimator(known.phantom, known.device, friction=outer.friction)
    shapes, feeders = episode.observations["shape"].astype(float), _feeders(episode)
    forces, refused = np.zeros(len(episode)), 0
    for moment, points in enumerate(shapes):
        curve = inserted_part(points, float(feeders[moment, :, 0].max()))
        if generator is not None:
            curve = noisy_curve(curve, sizes.curve, generator)
        wrong = feeders[moment] + (known.insertion, known.rotation)
        wrong[:, 0] = np.clip(wrong[:, 0], 0.0, estimator.max_insertion)
        (insertion, rotation), *others = wrong.tolist()
        try:
            found = estimator.update(curve, insertion, rotation, catheter=tuple(others[0]) if others else None)
        except ValueError as error:
            _LOGGER.debug("%s, moment %d: %s", episode.label, moment, error)
            refused += moment > 0
            continue
        if moment > 0:  # the first is the state after the reset, in which no step has ended
            forces[moment - 1] = found.resultant.value
    return forces, refused


def _feeders(episode: Trajectory) -> NDArray[np.float64]:
    """Insertion (m) and rotation (rad, without jumps) of each feeder in every moment. Shape (T + 1, feeders, 2)."""
    observed = episode.observations["feeder"].astype(float)
    columns = [observed[:, start : start + 3] for start in range(0, observed.shape[1] - 2, 3)]
    return np.stack(
        [np.column_stack((one[:, 0], np.unwrap(np.arctan2(one[:, 2], one[:, 1])))) for one in columns], axis=1
    )
