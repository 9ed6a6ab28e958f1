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


def of_greys(pictures: Sequence[NDArray[np.uint8]]) -> Statistics:
    """Statistics of pictures as shares of 255, exact, of three equal channels: shape (3, 1, 1); count, (1,)."""
    counts = np.sum([np.bincount(picture.ravel(), minlength=_GREYS) for picture in pictures], axis=0)
    greys, share = np.arange(_GREYS) / (_GREYS - 1), counts / counts.sum()
    mean = float(greys @ share)
    present, total = np.flatnonzero(counts), np.cumsum(share)
    scalars = {
        "min": greys[present[0]],
        "max": greys[present[-1]],
        "mean": mean,
        "std": np.sqrt(max(float(greys**2 @ share) - mean**2, 0.0)),
        **{quantile_name(q): greys[min(int(np.searchsorted(total, q)), _GREYS - 1)] for q in QUANTILES},
    }
    spread = {name: np.full((3, 1, 1), value) for name, value in scalars.items()}
    return spread | {"count": np.array([len(pictures)], np.int64)}


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


def write_grey_video(path: Path, pictures: Sequence[NDArray[np.uint8]], fps: float) -> None:
    """Writes pictures of one size, (height, width), into an mp4 file."""
    import imageio_ffmpeg

    height, width = pictures[0].shape
    options = ["-crf", str(_CONSTANT_RATE_FACTOR), "-g", str(_WHOLE_EVERY), "-bf", "0", "-preset", "veryfast"]
    film: Any = imageio_ffmpeg.write_frames(
        str(path),
        (width, height),
        fps=fps,
        codec=_ENCODER,
        pix_fmt_in="gray",
        pix_fmt_out=pixel_format((height, width)),
        macro_block_size=1,
        quality=None,
        ffmpeg_log_level="error",
        output_params=[*options, "-movflags", "+faststart"],
    )
    film.send(None)
    for picture in pictures:
        film.send(np.ascontiguousarray(picture))
    film.close()
