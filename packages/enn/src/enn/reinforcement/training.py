"""Reinforcement learning: a training from settings to the best policy, resumable at any moment."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import gymnasium
from numpy.typing import NDArray
from stable_baselines3.common.utils import get_device

from enn.policy import Policy
from enn.reinforcement.checkpoint import CheckpointError
from enn.reinforcement.training_curve import read_curve
from enn.reinforcement.training_run import Progress, TrainingResult, TrainingRun
from enn.reinforcement.training_settings import DESK_PPO, DESK_SAC, THESIS_PPO, THESIS_SAC, TrainingSettings
from enn.trajectory import Trajectory

__all__ = [
    "DESK_PPO",
    "DESK_SAC",
    "THESIS_PPO",
    "THESIS_SAC",
    "Progress",
    "Training",
    "TrainingResult",
    "TrainingSettings",
]


class Training:
    """One reinforcement learning run; with a folder it can be interrupted and goes on exactly where it was.

        folder/policy.pt        the best policy           folder/training.csv   the curve
        folder/training.json    settings and outcome      folder/checkpoint/    until it is finished
        folder/tensorboard/     event files, if asked for

    Args:
        settings: of the training.
        make_env: makes one environment; called for each of those sampled, and for evaluation.
        folder: where it is kept; None: only in memory.
        seed: of everything.
        demonstrations: their states enter the bank; their steps the replay buffer, if the settings say so.
        encoder: frozen, turns observations into features.
        metadata: kept in the policy's file.
        starts: further states of the bank, an array for each case or way. Shapes (k, n).
        make_validation_env: makes the environments of the evaluations that choose the best policy; None: `make_env`.
    """

    def __init__(
        self,
        settings: TrainingSettings,
        make_env: Callable[[], gymnasium.Env[Any, Any]],
        folder: Path | str | None = None,
        seed: int = 0,
        demonstrations: Sequence[Trajectory] = (),
        encoder: Any = None,
        metadata: dict[str, Any] | None = None,
        starts: Sequence[NDArray[Any]] = (),
        make_validation_env: Callable[[], gymnasium.Env[Any, Any]] | None = None,
    ) -> None:
        self.starts, self.make_validation_env = tuple(starts), make_validation_env or make_env
        self.settings, self.make_env, self.seed = settings, make_env, seed
        self.folder = None if folder is None else Path(folder)
        self.demonstrations, self.encoder = tuple(demonstrations), encoder
        self.metadata = {"seed": seed, **(metadata or {})}

    def run(self, progress: Callable[[Progress], None] | None = None) -> TrainingResult:
        """Trains to the end of the budget, going on from a checkpoint if the folder holds one.

        Args:
            progress: called a few times a second between decisions; what it raises stops the training, which can go
                on later from that decision.

        Raises:
            NotFiniteError: an observation or a reward was not finite.
            CheckpointError: the folder's checkpoint, or its record of a finished training, is damaged or of another
                training.
        """
        if self.folder is not None and (self.folder / "training.json").is_file():
            return self._finished()
        run = TrainingRun(self, progress)
        try:
            return run.train()
        finally:
            run.close()

    def _finished(self) -> TrainingResult:
        assert self.folder is not None
        policy = Policy.load(self.folder / "policy.pt", get_device(self.settings.device))
        try:
            record = json.loads((self.folder / "training.json").read_text())
            curve = read_curve(self.folder / "training.csv")
            return TrainingResult(policy, curve, dict(record["timings"]), record["evaluation"])
        except (KeyError, RecursionError, TypeError, ValueError) as error:
            raise CheckpointError(
                f"the training in {self.folder} is finished, but its training.json or training.csv is damaged: remove "
                "both to train again"
            ) from error
