"""Rounds of advised episodes in a policy's folder, so that an interrupted training goes on after its last whole round.

Until the training is finished the folder holds::

    advised_episodes/round<k>.npz   the round's episodes
    advised_episodes/round<k>.pt    the policy after it: the round counts from here on
"""

from __future__ import annotations

import itertools
import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pipeline.recording.curves import Curves
from pipeline.seeds import fit_seed
from pipeline.store.atomic_files import write_arrays

if TYPE_CHECKING:
    from enn.imitation.recurrent_policy import RecurrentPolicy
    from enn.imitation.sequence_cloning import AdvisedEpisode, SequenceCloningSettings

FOLDER = "advised_episodes"
_ARRAYS = ("features", "actions", "hints")


@dataclass(frozen=True)
class FinishedRound:
    """What a round came to; `wall_s` is the training's time so far."""

    new: list[AdvisedEpisode]
    loss: float
    wall_s: float


def teach(
    folder: Path,
    policy: RecurrentPolicy,
    episodes: list[AdvisedEpisode],
    play: Callable[[int, float, float], list[AdvisedEpisode]],
    settings: SequenceCloningSettings,
    *,
    rounds: int,
    seed: int,
    began: float,
    report: Callable[[float, str], None],
) -> list[FinishedRound]:
    """Plays and fits the rounds that are missing: `policy`, in place, by earlier `episodes` and those of all rounds."""
    from enn.imitation.advised_episodes import advised_rounds

    done = finished_rounds(folder)
    episodes += [episode for one in done for episode in one.new]
    earlier = done[-1].wall_s if done else 0.0

    def fitting(number: int, epoch: int, loss: float) -> None:
        share = min(0.5 + 0.5 * epoch / settings.epochs, 1.0)
        report((number + share) / rounds, f"round {number + 1}, loss {loss:.3f}")

    missing = range(len(done), rounds)
    seed_of = partial(fit_seed, seed)
    for one in advised_rounds(policy, episodes, play, settings, rounds=missing, seed_of=seed_of, progress=fitting):
        finished = FinishedRound(one.new, one.loss, earlier + time.monotonic() - began)
        write_episodes(_episodes_of(folder, one.number), one.new)
        policy.save(_policy_of(folder, one.number), loss=finished.loss, wall_s=finished.wall_s)
        done.append(finished)
        with Curves(folder) as curves:
            success = float(np.mean([episode.success for episode in one.new]))
            curves.add(len(done), "rounds", loss=one.loss, success=success)
    return done


def last_policy(folder: Path) -> Path | None:
    """The file of the policy after the last whole round; None before the first."""
    rounds = _whole_rounds(folder)
    return _policy_of(folder, rounds - 1) if rounds else None


def finished_rounds(folder: Path) -> list[FinishedRound]:
    """The whole rounds of a policy's folder."""
    from enn.imitation.recurrent_policy import RecurrentPolicy

    found = []
    for number in range(_whole_rounds(folder)):
        kept = RecurrentPolicy.load(_policy_of(folder, number)).metadata
        found.append(FinishedRound(read_episodes(_episodes_of(folder, number)), kept["loss"], kept["wall_s"]))
    return found


def _whole_rounds(folder: Path) -> int:
    return next(number for number in itertools.count() if not _policy_of(folder, number).is_file())


def forget_rounds(folder: Path) -> None:
    """Removes the rounds of a finished training."""
    shutil.rmtree(folder / FOLDER, ignore_errors=True)


def write_episodes(path: Path, episodes: Sequence[AdvisedEpisode]) -> None:
    """Writes episodes into one file, whole or not at all."""
    arrays = {
        "lengths": np.array([len(episode.features) for episode in episodes]),
        "success": np.array([episode.success for episode in episodes]),
        "target": np.array([episode.target for episode in episodes]),
    }
    write_arrays(path, arrays | {name: np.concatenate([getattr(one, name) for one in episodes]) for name in _ARRAYS})


def read_episodes(path: Path) -> list[AdvisedEpisode]:
    """Reads what `write_episodes` wrote."""
    from enn.imitation.sequence_cloning import AdvisedEpisode

    with np.load(path) as arrays:
        cuts = np.cumsum(arrays["lengths"])[:-1]
        parts = (np.split(arrays[name], cuts) for name in _ARRAYS)
        ends = arrays["success"].tolist(), arrays["target"].tolist()
        return [AdvisedEpisode(*one) for one in zip(*parts, *ends, strict=True)]


def _episodes_of(folder: Path, number: int) -> Path:
    return folder / FOLDER / f"round{number}.npz"


def _policy_of(folder: Path, number: int) -> Path:
    return folder / FOLDER / f"round{number}.pt"
