"""What can go wrong with an episode log, each error one sentence that says what to do."""

from __future__ import annotations

from pathlib import Path

from pipeline.printing import written
from pipeline.store.errors import PipelineError


class EpisodeWriteError(PipelineError, OSError):
    """A log cannot be written; what was flushed before is safe in its partial file."""


class EpisodeReadError(PipelineError, ValueError):
    """A log cannot be read, because it is damaged, foreign or too new."""


class ViewerError(PipelineError, RuntimeError):
    """A log cannot be shown: the viewer's package is missing, or its file cannot be written."""


class ContainerError(ValueError):
    """A part of an MCAP file is damaged; the message is the reason alone, without file name or advice."""


def damaged(path: Path, reason: object) -> EpisodeReadError:
    """Make the error of a damaged log."""
    return EpisodeReadError(f"{path} is damaged: {reason}; run '{recover_command(path)}' to save what is intact")


def recover_command(path: Path) -> str:
    """Give the command line that recovers a log."""
    return f"{written('episodes')} recover {path}"
