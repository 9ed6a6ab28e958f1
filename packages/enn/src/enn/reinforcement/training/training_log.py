"""The log of a training: its latest rewards and episodes, its clocks, and the rows of its curve."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from enn.reinforcement.training.result import COLUMNS, Row, write_curve

REWARD_WINDOW, EPISODE_WINDOW = 100, 50


class TrainingLog:
    """What a training has measured of itself so far.

    Args:
        folder: where the curve is written after each row; None: nowhere.
        cpu_elsewhere: processor time of other processes of the training so far, s.
    """

    def __init__(self, folder: Path | None, cpu_elsewhere: Callable[[], float]) -> None:
        self.folder, self._cpu_elsewhere = folder, cpu_elsewhere
        self.env_steps = 0
        self.curve: list[Row] = []
        self.evaluation: dict[str, Any] = {}  # the latest that has no row yet
        self.rewards: deque[float] = deque(maxlen=REWARD_WINDOW)
        self.episodes: deque[tuple[int, bool]] = deque(maxlen=EPISODE_WINDOW)
        self.returns: deque[float] = deque(maxlen=EPISODE_WINDOW)  # of all episodes, also those from the reset bank
        self.spent = {"wall_s": 0.0, "cpu_s": 0.0, "simulation_s": 0.0, "update_s": 0.0, "evaluation_s": 0.0}
        self.began = time.perf_counter(), time.process_time()
        self.writer: Any = None

    def show_in_tensorboard(self, folder: Path, decisions: int) -> None:
        """Writes every further row there, too; rows after so many decisions, of an interrupted run, are hidden.

        Raises:
            ModuleNotFoundError: TensorBoard is not installed.
        """
        try:
            from torch.utils.tensorboard import SummaryWriter
        except ModuleNotFoundError as error:
            raise ModuleNotFoundError(
                "TensorBoard's files are written with tensorboard: pip install tensorboard", name=error.name
            ) from None

        self.writer = SummaryWriter(str(folder), purge_step=decisions or None)

    def observe(self, rewards: list[float], infos: list[dict[str, Any]]) -> None:
        """Takes a decision's rewards and infos, one for each environment."""
        for reward, info in zip(rewards, infos, strict=True):
            self.env_steps += info["steps"]
            self.rewards.append(reward / info["steps"])
            episode = info.get("episode")
            if episode is None:
                continue
            self.returns.append(episode["r"])
            if episode["fresh"]:
                self.episodes.append((episode["l"], episode["success"]))

    def success(self) -> float | None:
        """Share of the latest episodes from the usual start that succeeded; None before the first."""
        return float(np.mean([success for _, success in self.episodes])) if self.episodes else None

    def episode_return(self) -> float | None:
        """Mean sum of rewards of the latest episodes; None before the first."""
        return float(np.mean(self.returns)) if self.returns else None

    def clocks(self) -> tuple[float, float]:
        """Seconds of wall time and of processor time since the training began, all its runs together."""
        wall, cpu = time.perf_counter() - self.began[0], time.process_time() - self.began[1]
        return self.spent["wall_s"] + wall, self.spent["cpu_s"] + cpu + self._cpu_elsewhere()

    def last_row_at(self) -> int:
        """Decisions at the last row; 0 before the first."""
        return int(self.curve[-1]["decisions"]) if self.curve else 0

    def add_row(self, decisions: int, scalars: dict[str, Any]) -> None:
        """Ends the curve's next row, writes the curve, and shows row and scalars in TensorBoard."""
        wall, cpu = self.clocks()
        row = {
            "decisions": decisions,
            "env_steps": self.env_steps,
            "wall_s": round(wall, 3),
            "cpu_s": round(cpu, 3),
            "reward": float(np.mean(self.rewards)) if self.rewards else None,
            "episode_length": float(np.mean([length for length, _ in self.episodes])) if self.episodes else None,
            "success": self.success(),
            **self.evaluation,
        }
        self.evaluation = {}
        self.curve.append({name: row.get(name) for name in COLUMNS})
        self.write()
        if self.writer is not None:
            shown = {**row, "episode_return": self.episode_return()}
            for name, value in {**{f"curve/{k}": v for k, v in shown.items()}, **scalars}.items():
                if value is not None and name != "curve/decisions":
                    self.writer.add_scalar(name, value, decisions)

    def write(self) -> None:
        """Writes the curve as it is."""
        if self.folder is not None:
            write_curve(self.folder / "training.csv", self.curve)

    def state(self) -> dict[str, Any]:
        """What a checkpoint keeps of it, beside `env_steps`."""
        wall, cpu = self.clocks()
        return {
            "curve": self.curve,
            "latest": self.evaluation,
            "rewards": list(self.rewards),
            "episodes": list(self.episodes),
            "returns": list(self.returns),
            "spent": {**self.spent, "wall_s": wall, "cpu_s": cpu},
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Takes up what `state` gave."""
        self.curve, self.evaluation = state["curve"], state["latest"]
        self.rewards.extend(state["rewards"])
        self.episodes.extend(state["episodes"])
        self.returns.extend(state.get("returns", []))
        self.spent |= state["spent"]

    def close(self) -> None:
        """Ends the event file."""
        if self.writer is not None:
            self.writer.close()
