"""Reinforcement learning: a training from settings to the best policy, resumable at any moment."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

from stable_baselines3.common.utils import get_device

from enn.policy import Policy
from enn.reinforcement.checkpoint import CheckpointError
from enn.reinforcement.training.inputs import TrainingInputs
from enn.reinforcement.training.result import Progress, TrainingResult, read_curve
from enn.reinforcement.training.run import TrainingRun


class Training(TrainingInputs):
    """One reinforcement learning run; with a folder it can be interrupted and goes on exactly where it was.

        folder/policy.pt        the best policy           folder/training.csv   the curve
        folder/training.json    settings and outcome      folder/checkpoint/    until it is finished
        folder/tensorboard/     event files, if asked for

    Args and attributes are those of `TrainingInputs`.
    """

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
        if self.folder is not None and (Path(self.folder) / "training.json").is_file():
            return self._finished(Path(self.folder))
        run = TrainingRun(self, progress)
        try:
            return run.train()
        finally:
            run.close()

    def _finished(self, folder: Path) -> TrainingResult:
        policy = Policy.load(folder / "policy.pt", get_device(self.settings.device))
        try:
            record = json.loads((folder / "training.json").read_text(encoding="utf-8"))
            curve = read_curve(folder / "training.csv")
            return TrainingResult(policy, curve, dict(record["timings"]), record["evaluation"])
        except (KeyError, RecursionError, TypeError, ValueError) as error:
            raise CheckpointError(
                f"the training in {folder} is finished, but its training.json or training.csv is damaged: remove "
                "both to train again"
            ) from error
