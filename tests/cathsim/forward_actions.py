"""Random actions that mostly feed forwards."""

import numpy as np


def forward_actions(count: int, size: int, seed: int = 0) -> np.ndarray:
    """Actions (count, size): 2 of one device, 4 of two devices, or more of tip motors, whose last one feeds."""
    drawn = np.random.default_rng(seed).uniform(-1, 1, (count, size))
    feeders = {2: [0], 4: [0, 2]}.get(size, [-1])
    drawn[:, feeders] = 0.4 + 0.6 * np.abs(drawn[:, feeders])
    return drawn.astype(np.float32)
