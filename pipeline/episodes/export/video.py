"""A grey mp4 film that is written frame by frame, so that a frame of any time can be found again.

H.264 with a whole picture every second frame. Width and height that are even are stored as yuv420p, others as yuv444p.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

CODEC = "h264"
_ENCODER = "libx264"
_WHOLE_EVERY = 2  # frames: a reader that looks for one frame decodes at most two
_CONSTANT_RATE_FACTOR = 4  # of libx264: grey values within a few of 255


class GreyVideo:
    """Writes pictures of one size (height, width, px) into an mp4 file."""

    def __init__(self, path: Path, size: tuple[int, int], fps: float) -> None:
        import imageio_ffmpeg

        self.path, self.frames, self._size = path, 0, size
        path.parent.mkdir(parents=True, exist_ok=True)
        options = ["-crf", str(_CONSTANT_RATE_FACTOR), "-g", str(_WHOLE_EVERY), "-bf", "0", "-preset", "veryfast"]
        self._ffmpeg: Any = imageio_ffmpeg.write_frames(
            str(path),
            (size[1], size[0]),
            fps=fps,
            codec=_ENCODER,
            pix_fmt_in="gray",
            pix_fmt_out=self.pixel_format,
            macro_block_size=1,
            quality=None,
            ffmpeg_log_level="error",
            output_params=[*options, "-movflags", "+faststart"],
        )
        self._ffmpeg.send(None)

    @property
    def pixel_format(self) -> str:
        """How pixels are stored."""
        return "yuv444p" if self._size[0] % 2 or self._size[1] % 2 else "yuv420p"

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
