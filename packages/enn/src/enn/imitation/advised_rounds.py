"""Rounds of advised episodes in a policy's folder: an interrupted training goes on after its last whole round.

Until the training is finished the folder holds::

    advised_episodes/round<k>.npz   the round's episodes
    advised_episodes/round<k>.pt    the policy after it: the round counts from here on

Source: S. Ross, G. Gordon, D. Bagnell, A reduction of imitation learning and structured prediction to no-regret online
learning, AISTATS 2011, algorithm 3.1.
"""

from __future__ import annotations

import itertools
import os
import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from enn.curves import Curves

if TYPE_CHECKING:
    from enn.imitation.recurrent_policy import RecurrentPolicy
    from enn.imitation.sequence_cloning import AdvisedEpisode, SequenceCloningSettings

FOLDER = "advised_episodes"
TEACHER_SHARE, NOISE = 0.1, 0.1  # of a round: share of the episodes that the teacher steers, noise of the actions
FIRST_TEACHER_SHARE, FIRST_NOISE = 1.0, 0.3  # where nothing was learnt before
_ARRAYS = ("features", "actions", "hints")


@dataclass(frozen=True)
class FinishedRound:
    """What a round came to.

    Attributes:
        loss: mean of the last epoch of its fit.
        wall_s: the training's time so far.
    """

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
    report: Callable[[float, str], None] = lambda share, text: None,
) -> list[FinishedRound]:
    """Rounds of DAgger: the policy steers most episodes, the teacher advises, and the policy is fitted to all so far.

    Args:
        folder: of the policy; rounds that it has are not played again.
        policy: learns in place; `last_policy` where there is one.
        episodes: learnt before; those of the rounds are added.
        play: takes a round's number, the share of its episodes that the teacher steers and the noise of the actions.
        settings: of each fit; the last round has twice as many epochs.
        seed: of the fits' order of samples.
        began: `time.monotonic` when the training began.
        report: takes the share that is done, and a few words.
    """
    from enn.imitation.sequence_cloning import clone_sequences

    done = finished_rounds(folder)
    episodes += [episode for one in done for episode in one.new]
    earlier = done[-1].wall_s if done else 0.0
    for number in range(len(done), rounds):
        first = number == 0 and not episodes
        new = play(number, FIRST_TEACHER_SHARE if first else TEACHER_SHARE, FIRST_NOISE if first else NOISE)
        episodes += new

        def fitting(epoch: int, loss: float, number: int = number) -> None:
            share = min(0.5 + 0.5 * epoch / settings.epochs, 1.0)
            report((number + share) / rounds, f"round {number + 1}, loss {loss:.3f}")

        fit = replace(settings, epochs=settings.epochs * (2 if number == rounds - 1 else 1))
        loss = clone_sequences(policy, episodes, fit, seed=seed * 1000 + number, progress=fitting)[-1]
        finished = FinishedRound(new, loss, earlier + time.monotonic() - began)
        write_episodes(_episodes_of(folder, number), new)
        policy.save(_policy_of(folder, number), loss=loss, wall_s=finished.wall_s)
        done.append(finished)
        with Curves(folder) as curves:
            curves.add(len(done), "rounds", loss=loss, success=float(np.mean([episode.success for episode in new])))
    return done


def last_policy(folder: Path) -> Path | None:
    """The file of the policy after the last whole round; None before the first."""
    rounds = _whole_rounds(folder)
    return _policy_of(folder, rounds - 1) if rounds else None


def finished_rounds(folder: Path) -> list[FinishedRound]:
    """The whole rounds of a policy's folder."""
    from enn.imitation.recurrent_policy import RecurrentPolicy

    rounds = []
    for number in range(_whole_rounds(folder)):
        metadata = RecurrentPolicy.load(_policy_of(folder, number)).metadata
        rounds.append(FinishedRound(read_episodes(_episodes_of(folder, number)), metadata["loss"], metadata["wall_s"]))
    return rounds


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
    } | {name: np.concatenate([getattr(one, name) for one in episodes]) for name in _ARRAYS}
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(f".{path.name}.tmp")
    with unfinished.open("wb") as stream:
        np.savez(stream, **arrays)  # type: ignore[arg-type]
        os.fsync(stream.fileno())
    os.replace(unfinished, path)


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
