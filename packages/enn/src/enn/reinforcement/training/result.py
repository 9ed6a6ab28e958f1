"""What a training reports: its progress, its curve with the file that it is kept in, and its result."""

from __future__ import annotations

import csv
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from enn.curves import Writer
from enn.model_file import write_whole
from enn.policy import Policy

COLUMNS = (
    "decisions",
    "env_steps",
    "wall_s",
    "cpu_s",
    "reward",
    "episode_length",
    "success",
    "evaluation_success",
    "evaluation_stochastic_success",
    "evaluation_length",
    "evaluation_path_mm",
    "evaluation_force",
)
Row = dict[str, Any]


REWARD_WINDOW, EPISODE_WINDOW = 100, 50


@dataclass(frozen=True)
class Progress:
    """Where a training stands."""

    decisions: int  # taken so far
    total: int
    # share of the latest training episodes from the usual start that succeeded; None before the first
    success: float | None
    episode_return: float | None  # mean sum of rewards of the latest training episodes; None before the first
    best_success: float | None  # of the policy kept so far, in its evaluation; None before the first one
    wall_s: float  # since the training began, all its runs together
    remaining_s: float  # estimate to the end of the budget


@dataclass(frozen=True)
class TrainingResult:
    """What a training gives."""

    policy: Policy  # the best by evaluation (or the last, when there were none)
    curve: list[dict[str, Any]]
    timings: dict[str, float]  # seconds in all and in parts, and what was done in them
    # Figures of the best policy: success, stochastic_success, steps, path_mm, force_mean, force_max, decisions.
    evaluation: dict[str, float] | None


def write_curve(path: Path, curve: list[Row]) -> None:
    """Writes rows, what was not measured as an empty cell; atomically."""
    lines = [",".join(COLUMNS)]
    lines += [",".join("" if row[name] is None else str(row[name]) for name in COLUMNS) for row in curve]
    write_whole(path, ("\n".join(lines) + "\n").encode())


def read_curve(path: Path) -> list[Row]:
    """Reads what `write_curve` wrote."""
    with path.open(newline="", encoding="utf-8") as stream:
        return [{name: _number(value) for name, value in row.items()} for row in csv.DictReader(stream)]


def _number(text: str) -> float | int | None:
    if text == "":
        return None
    return float(text) if any(letter in text for letter in ".en") else int(text)


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
        self.returns: deque[float] = deque(maxlen=EPISODE_WINDOW)  # of all episodes, also from the start-state buffer
        self.spent = {"wall_s": 0.0, "cpu_s": 0.0, "simulation_s": 0.0, "update_s": 0.0, "evaluation_s": 0.0}
        self.began = time.perf_counter(), time.process_time()
        self.writer: Writer | None = None  # of the curves for a logger

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
            values = {**row, "episode_return": self.episode_return()}
            for name, value in {**{f"curve/{k}": v for k, v in values.items()}, **scalars}.items():
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
