"""Figures of the report: pictures and films of the stages, inside the page when small and beside it when large."""

from __future__ import annotations

import base64
import shutil
from dataclasses import dataclass
from pathlib import Path

from pipeline.atomic import atomic_path
from pipeline.report.results import read_figures

FIGURES_FOLDER = "figures"
_MEDIA_TYPES = {
    ".png": "image/png",
    ".jpg": "image/jpeg",
    ".jpeg": "image/jpeg",
    ".gif": "image/gif",
    ".webp": "image/webp",
    ".svg": "image/svg+xml",
    ".mp4": "video/mp4",
    ".webm": "video/webm",
}


@dataclass(frozen=True)
class ShownFigure:
    """A figure as the page holds it."""

    title: str
    caption: str
    group: str
    source: str  # a data URI, or a path relative to the page
    media_type: str

    @property
    def is_film(self) -> bool:
        """Whether it moves and wants controls."""
        return self.media_type.startswith("video/")


def gather_figures(stage: str, folder: Path, report: Path, *, embed_limit: int) -> list[ShownFigure]:
    """Collects the figures of one stage folder.

    Args:
        stage: name of the folder, ``expert`` or ``expert@seed=1``; it heads figures without a group of their own.
        folder: the stage's folder.
        report: the report's folder; large files are copied below it, so that it can be moved as a whole.
        embed_limit: size in bytes up to which a file goes inside the page.

    Returns:
        The figures, in the stage's order; files of unknown type are left out.
    """
    shown = []
    for figure in read_figures(folder):
        file = folder / figure.file
        media_type = _MEDIA_TYPES.get(file.suffix.lower())
        if media_type is None:
            continue
        if file.stat().st_size <= embed_limit:
            source = f"data:{media_type};base64,{base64.b64encode(file.read_bytes()).decode()}"
        else:
            relative = Path(FIGURES_FOLDER, stage, figure.file)
            with atomic_path(report / relative) as temporary:
                shutil.copyfile(file, temporary)
            source = relative.as_posix()
        shown.append(ShownFigure(figure.title, figure.caption, figure.group or stage, source, media_type))
    return shown
