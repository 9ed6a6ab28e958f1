"""Curves of a training as it goes, for TensorBoard or Weights & Biases, in its folder.

Which of them is said once, by the variable ENN_LOGGER of the environment or by `Curves(folder, logger)`. Policies that
learn by reinforcement write more (`enn.reinforcement.training.result`). Weights & Biases is told the rest by its own
variables (WANDB_PROJECT, WANDB_MODE=offline, WANDB_API_KEY); a training is one run there, also after an interruption.
"""

from __future__ import annotations

import os
import uuid
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Protocol, get_args

Logger = Literal["tensorboard", "wandb", "none"]
LOGGERS: tuple[Logger, ...] = get_args(Logger)
CHOICE = "ENN_LOGGER"  # variable of the environment
FOLDER = "tensorboard"
PROJECT = "endonav"  # at Weights & Biases, where WANDB_PROJECT names no other
_AT = "at"  # axis of the curves there: its own steps must not go back
_RUN_ID = ".wandb_id"


class Writer(Protocol):
    """What takes scalars."""

    def add_scalar(self, tag: str, scalar_value: float, global_step: int | None = None) -> None:
        """Takes a scalar at a step."""

    def close(self) -> None:
        """Ends its files."""


def chosen_logger() -> Logger:
    """The logger that the environment names, TensorBoard where it names none.

    Raises:
        ValueError: it names one that there is not.
    """
    named = os.environ.get(CHOICE) or LOGGERS[0]
    for logger in LOGGERS:
        if logger == named:
            return logger
    raise ValueError(f"there is no logger {named!r}: choose from {', '.join(LOGGERS)}")


def open_writer(folder: Path, logger: Logger | None = None, after: int = 0) -> Writer | None:
    """Opens a training's curves; None for the logger "none".

    Args:
        folder: of the training.
        logger: one of `LOGGERS`; None: `chosen_logger()`.
        after: of an interrupted training, the step that it goes on after: later ones are hidden.

    Raises:
        ModuleNotFoundError: the logger is not installed.
    """
    logger = logger or chosen_logger()
    if logger == "none":
        return None
    if logger == "wandb":
        return _WandbRun(folder)
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "TensorBoard's files are written with tensorboard: pip install tensorboard", name=error.name
        ) from None
    return SummaryWriter(str(folder / FOLDER), purge_step=after + 1 if after else None)


class _WandbRun:
    """A run at Weights & Biases, whose number lies in the training's folder; its own files lie in `wandb/` there."""

    def __init__(self, folder: Path) -> None:
        try:
            import wandb
        except ModuleNotFoundError as error:
            raise ModuleNotFoundError(
                "Weights & Biases is written with wandb: pip install 'endonav-enn[wandb]'", name=error.name
            ) from None
        folder.mkdir(parents=True, exist_ok=True)
        number = folder / _RUN_ID
        if not number.is_file():
            number.write_text(uuid.uuid4().hex[:8], encoding="ascii")
        self._run = wandb.init(
            project=os.environ.get("WANDB_PROJECT") or PROJECT,
            dir=str(folder),
            id=number.read_text(encoding="ascii"),
            name="/".join(folder.absolute().parts[-4:]),
            resume="allow",
            reinit="create_new",
            settings=wandb.Settings(silent=True, console="off"),
        )
        self._run.define_metric("*", step_metric=_AT)

    def add_scalar(self, tag: str, scalar_value: float, global_step: int | None = None) -> None:
        self._run.log({tag: float(scalar_value), _AT: global_step})

    def close(self) -> None:
        self._run.finish()


class Curves:
    """Takes a training's scalars into a file in its folder; one that goes on adds to what is there.

    Args:
        logger: as of `open_writer`.
    """

    def __init__(self, folder: Path, logger: Logger | None = None) -> None:
        self._folder, self._logger = folder, logger or chosen_logger()
        self._writer: Writer | None = None

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
            self._writer = open_writer(self._folder, self._logger)
            if self._writer is None:
                return
        for name, value in scalars.items():
            if value is not None:
                self._writer.add_scalar(f"{part}/{name}", value, step)

    def add_epochs(self, rows: Iterable[Mapping[str, Any]]) -> None:
        """Adds a training's table: a row an epoch."""
        for row in rows:
            self.add(row["epoch"], loss=row["loss"], validation=row["validation"])
