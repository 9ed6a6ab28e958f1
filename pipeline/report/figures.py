"""Figures of the report: pictures and films of the stages, inside the page when small and beside it when large."""

from __future__ import annotations

import base64
import math
import shutil
from dataclasses import dataclass
from pathlib import Path

from pipeline.report.results import read_figures
from pipeline.store.atomic_files import atomic_path

FIGURES_FOLDER = "figures"
_BASE64 = 4 / 3  # characters a byte
_COLUMN_PIXELS = 1200
_MEDIA_TYPES = {
    ".png": "image/png", ".jpg": "image/jpeg", ".jpeg": "image/jpeg", ".gif": "image/gif", ".webp": "image/webp",
    ".svg": "image/svg+xml", ".mp4": "video/mp4", ".webm": "video/webm",
}  # fmt: skip


@dataclass(frozen=True)
class ShownFigure:
    """A figure as the page holds it."""

    title: str
    caption: str
    group: str
    source: str  # a data URI, or a path relative to the page
    media_type: str
    is_wide: bool = False  # too wide to be read in a column

    @property
    def embedded_bytes(self) -> int:
        """Its bytes in the page; 0 where it lies beside the page."""
        return len(self.source) if self.source.startswith("data:") else 0

    @property
    def is_film(self) -> bool:
        """Whether it is a film, which the page shows with controls."""
        return self.media_type.startswith("video/")


def gather_figures(
    stage: str, folder: Path, report: Path, *, embed_limit: int, room: float = math.inf
) -> list[ShownFigure]:
    """Collects the figures of one stage folder.

    Args:
        stage: name of the folder, ``expert`` or ``expert@seed=1``; it heads figures without a group of their own.
        report: the report's folder; large files are copied below it, so that it can be moved as a whole.
        embed_limit: size in bytes up to which a file goes inside the page.
        room: bytes of the page that its figures may take together; what does not fit lies beside it.

    Returns:
        The figures, in the stage's order; files of unknown type are left out.
    """
    shown = []
    for figure in read_figures(folder):
        file = folder / figure.file
        media_type = _MEDIA_TYPES.get(file.suffix.lower())
        if media_type is None:
            continue
        size = file.stat().st_size
        if size <= embed_limit and _BASE64 * size <= room:
            source = f"data:{media_type};base64,{base64.b64encode(file.read_bytes()).decode()}"
            room -= len(source)
        else:
            relative = Path(FIGURES_FOLDER, stage, figure.file)
            with atomic_path(report / relative) as temporary:
                shutil.copyfile(file, temporary)
            source = relative.as_posix()
        group = figure.group or stage
        shown.append(ShownFigure(figure.title, figure.caption, group, source, media_type, _is_wide(file)))
    return shown


def _is_wide(file: Path) -> bool:
    """Whether a PNG is wider than a column of the page can show it; its head gives the width."""
    with file.open("rb") as stream:
        head = stream.read(20)
    return head.startswith(b"\x89PNG") and int.from_bytes(head[16:20], "big") > _COLUMN_PIXELS
