"""Statistics that a LeRobotDataset keeps of every feature: of each episode, and of all of them together."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

QUANTILES = (0.01, 0.10, 0.50, 0.90, 0.99)
_GREYS = 256

Statistics = dict[str, NDArray[np.float64]]


def quantile_name(quantile: float) -> str:
    """Name a quantile as LeRobot does: q01, q50."""
    return f"q{round(quantile * 100):02d}"


def of_rows(values: NDArray[np.generic]) -> Statistics:
    """Statistics over the first axis.

    Args:
        values: shape (n,) or (n, k); NaN is left out, and a part that is NaN alone gives zeros.

    Returns:
        min, max, mean, std and quantiles, shape (1,) or (k,); count, shape (1,).
    """
    rows = np.asarray(values, np.float64)
    rows = rows[:, None] if rows.ndim == 1 else rows
    masked = np.where(np.isnan(rows).all(axis=0), 0.0, rows)
    quantiles = np.nanquantile(masked, QUANTILES, axis=0)
    return {
        "min": np.nanmin(masked, axis=0),
        "max": np.nanmax(masked, axis=0),
        "mean": np.nanmean(masked, axis=0),
        "std": np.nanstd(masked, axis=0),
        "count": np.array([len(rows)], np.int64),
        **{quantile_name(share): row for share, row in zip(QUANTILES, quantiles, strict=True)},
    }


class GreyStatistics:
    """Statistics of pictures, exact, from the counts of their grey values."""

    def __init__(self) -> None:
        self.counts = np.zeros(_GREYS, np.int64)
        self.pictures = 0

    def add(self, picture: NDArray[np.uint8]) -> None:
        """Count a picture."""
        self.counts += np.bincount(picture.ravel(), minlength=_GREYS)
        self.pictures += 1

    def values(self) -> Statistics:
        """Statistics of grey values as shares of 255, of three equal channels: shape (3, 1, 1); count, (1,)."""
        greys = np.arange(_GREYS) / (_GREYS - 1)
        share = self.counts / self.counts.sum()
        mean = float(greys @ share)
        present, total = np.flatnonzero(self.counts), np.cumsum(share)
        scalars = {
            "min": greys[present[0]],
            "max": greys[present[-1]],
            "mean": mean,
            "std": np.sqrt(max(float(greys**2 @ share) - mean**2, 0.0)),
            **{quantile_name(q): greys[min(int(np.searchsorted(total, q)), _GREYS - 1)] for q in QUANTILES},
        }
        spread = {name: np.full((3, 1, 1), value) for name, value in scalars.items()}
        return spread | {"count": np.array([self.pictures], np.int64)}


def together(episodes: Sequence[Statistics]) -> Statistics:
    """Statistics of several episodes from those of each; quantiles are means weighted by the counts, as LeRobot's."""
    counts = np.array([one["count"][0] for one in episodes], np.float64)
    weights = counts / counts.sum()

    def weighted(values: list[NDArray[np.float64]]) -> NDArray[np.float64]:
        return np.tensordot(weights, np.stack(values), axes=1)

    mean = weighted([one["mean"] for one in episodes])
    variance = weighted([one["std"] ** 2 + (one["mean"] - mean) ** 2 for one in episodes])
    names = [quantile_name(share) for share in QUANTILES]
    return {
        "min": np.min([one["min"] for one in episodes], axis=0),
        "max": np.max([one["max"] for one in episodes], axis=0),
        "mean": mean,
        "std": np.sqrt(variance),
        "count": np.array([int(counts.sum())], np.int64),
        **{name: weighted([one[name] for one in episodes]) for name in names},
    }


CODEC = "h264"
_ENCODER = "libx264"
_WHOLE_EVERY = 2  # frames: a reader that looks for one frame decodes at most two
_CONSTANT_RATE_FACTOR = 4  # of libx264: grey values within a few of 255


def pixel_format(size: Sequence[int]) -> str:
    """How pixels of pictures of a size (height, width) are stored."""
    return "yuv444p" if size[0] % 2 or size[1] % 2 else "yuv420p"


class GreyVideo:
    """Writes pictures of one size (height, width, px) into an mp4 file."""

    def __init__(self, path: Path, size: tuple[int, int], fps: float) -> None:
        import imageio_ffmpeg

        self.path, self.frames = path, 0
        path.parent.mkdir(parents=True, exist_ok=True)
        options = ["-crf", str(_CONSTANT_RATE_FACTOR), "-g", str(_WHOLE_EVERY), "-bf", "0", "-preset", "veryfast"]
        self._ffmpeg: Any = imageio_ffmpeg.write_frames(
            str(path),
            (size[1], size[0]),
            fps=fps,
            codec=_ENCODER,
            pix_fmt_in="gray",
            pix_fmt_out=pixel_format(size),
            macro_block_size=1,
            quality=None,
            ffmpeg_log_level="error",
            output_params=[*options, "-movflags", "+faststart"],
        )
        self._ffmpeg.send(None)

    @property
    def written_bytes(self) -> int:
        """Size of the file so far; the encoder makes it some time after the first frames came."""
        return self.path.stat().st_size if self.path.exists() else 0

    def add(self, picture: NDArray[np.uint8]) -> None:
        """Write the next frame, (height, width) uint8."""
        self._ffmpeg.send(np.ascontiguousarray(picture))
        self.frames += 1

    def close(self) -> None:
        """Finish the file; closing again does nothing."""
        self._ffmpeg.close()
