"""Figures of the report: pictures and films of the stages, inside the page when small and beside it when large."""

from __future__ import annotations

import base64
import math
import shutil
from dataclasses import dataclass
from pathlib import Path

from pipeline.plots.words import in_words
from pipeline.store.atomic_files import atomic_path
from pipeline.tables import read_figures

FIGURES_FOLDER = "figures"
_BASE64 = 4 / 3  # characters a byte
_DOTS = 2  # of a picture on a pixel of the page, so that it is sharp on screens with two dots a pixel
_COLUMN_PIXELS = 900  # of the page
_LONGEST_CAPTION = 130  # characters
_MOVING = (".gif", ".mp4", ".webm")
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
    stage: str = ""  # beside whose tables it is shown
    size: tuple[int, int] | None = None  # width and height, px of a PNG or GIF; None for others
    is_film: bool = False

    @property
    def is_wide(self) -> bool:
        """Whether it is too wide to be read in a column of the page."""
        return self.size is not None and not self.is_film and self.size[0] > _DOTS * _COLUMN_PIXELS

    @property
    def caption_parts(self) -> tuple[str, str]:
        """The caption, and what of a long one is folded: all but its first sentence."""
        if len(self.caption) <= _LONGEST_CAPTION:
            return self.caption, ""
        first, _, rest = self.caption.partition(". ")
        return (f"{first}.", rest) if rest else (self.caption, "")

    @property
    def shown_size(self) -> tuple[int, int] | None:
        """Largest width and height on the page: two dots of a picture a pixel, one of a film."""
        dots = 1 if self.is_film else _DOTS
        return None if self.size is None else (max(1, self.size[0] // dots), max(1, self.size[1] // dots))

    @property
    def embedded_bytes(self) -> int:
        """Its bytes in the page; 0 where it lies beside the page."""
        return len(self.source) if self.source.startswith("data:") else 0


def gather_figures(
    stage: str, folder: Path, report: Path, *, embed_limit: int, free_bytes: float = math.inf
) -> list[ShownFigure]:
    """Collects the figures of one stage folder.

    Args:
        stage: name of the folder, ``expert`` or ``expert@seed=1``; it heads figures without a group of their own.
        report: the report's folder; large files are copied below it, so that it can be moved as a whole.
        embed_limit: size in bytes up to which a file goes inside the page.
        free_bytes: of the page that its figures may take together; what does not fit lies beside it.
    """
    figures = []
    for figure in read_figures(folder):
        file = folder / figure.file
        media_type = _MEDIA_TYPES.get(file.suffix.lower())
        if media_type is None:
            continue
        size = file.stat().st_size
        if size <= embed_limit and _BASE64 * size <= free_bytes:
            source = f"data:{media_type};base64,{base64.b64encode(file.read_bytes()).decode()}"
            free_bytes -= len(source)
        else:
            relative = Path(FIGURES_FOLDER, stage, figure.file)
            with atomic_path(report / relative) as temporary:
                shutil.copyfile(file, temporary)
            source = relative.as_posix()
        figures.append(ShownFigure(
            in_words(figure.title), in_words(figure.caption), in_words(figure.group or stage),
            source, media_type, stage=figure.stage or stage.partition("@")[0], size=_size(file),
            is_film=file.suffix.lower() in _MOVING,
        ))  # fmt: skip
    return figures


def _size(file: Path) -> tuple[int, int] | None:
    """Width and height of a PNG or GIF, which its head gives; None for other kinds."""
    with file.open("rb") as stream:
        head = stream.read(24)
    if head.startswith(b"\x89PNG"):
        return int.from_bytes(head[16:20], "big"), int.from_bytes(head[20:24], "big")
    if head.startswith(b"GIF8"):
        return int.from_bytes(head[6:8], "little"), int.from_bytes(head[8:10], "little")
    return None
