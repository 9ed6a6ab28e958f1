"""Curves of a training for TensorBoard, as it goes: event files in `tensorboard/` of its folder.

Policies that learn by reinforcement write more (`enn.reinforcement.training.result`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

FOLDER = "tensorboard"


class Curves:
    """Takes a training's scalars into a file in its folder; one that goes on adds to what is there."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder / FOLDER
        self._writer: Any = None

    def __enter__(self) -> Curves:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._writer is not None:
            self._writer.close()

    def add(self, step: int, part: str = "train", /, **scalars: float | None) -> None:
        """Adds scalars, named `part/name`, at a step; those that are None were not measured."""
        if self._writer is None:
            from torch.utils.tensorboard import SummaryWriter

            self._writer = SummaryWriter(str(self._folder))
        for name, value in scalars.items():
            if value is not None:
                self._writer.add_scalar(f"{part}/{name}", value, step)

    def add_epochs(self, rows: Iterable[Mapping[str, Any]]) -> None:
        """Adds a training's table: a row an epoch."""
        for row in rows:
            self.add(row["epoch"], loss=row["loss"], validation=row["validation"])
