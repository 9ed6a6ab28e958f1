"""Draw the contact sheet of random fluoroscopy: 64 tiles, the half on the right with what is in them.

python docs/pictures/random_fluoroscopy_picture.py
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from guide3d.random_fluoroscopy.random_fluoroscopy import RandomFluoroscopy, RandomImage

SEED, SIDE_PX, ROWS, COLUMNS = 20, 256, 8, 8
SHOWN_PX = 160  # of a tile


def shown(drawn: RandomImage, *, marked: bool) -> np.ndarray:
    """A tile as bright as a display shows it; wire red, catheter green, tip blue."""
    bright = max(float(np.percentile(drawn.image, 99.5)), 30.0)
    grey = np.clip(drawn.image * (255 / bright), 0, 255).astype(np.uint8)
    picture = cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)
    if marked:
        for channel, mask in ((2, drawn.wire), (1, drawn.catheter), (0, (255 * drawn.tip).astype(np.uint8))):
            picture[..., channel] = np.maximum(picture[..., channel], mask)
    picture = cv2.resize(picture, (SHOWN_PX, SHOWN_PX), interpolation=cv2.INTER_AREA)
    return cv2.copyMakeBorder(picture, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=(255, 255, 255))


fluoroscopy = RandomFluoroscopy(seed=SEED)
rows = [
    np.hstack(
        [
            shown(fluoroscopy.tile(row * COLUMNS + column, SIDE_PX), marked=column >= COLUMNS // 2)
            for column in range(COLUMNS)
        ]
    )
    for row in range(ROWS)
]
path = Path(__file__).parent / "random_fluoroscopy.png"
cv2.imwrite(str(path), np.vstack(rows), [cv2.IMWRITE_PNG_COMPRESSION, 9])
print(path)
