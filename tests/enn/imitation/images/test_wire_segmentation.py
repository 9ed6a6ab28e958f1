"""Segmenters of wires and lumens find what they have not seen."""

from typing import Any

import gymnasium
import numpy as np
import pytest

from enn.imitation.images.lumen_segmentation import fit_segmenter, overlap
from enn.imitation.images.wire_segmentation import (
    WireSegmenter,
    dice,
    fit_wire_segmenter,
    wire_frames,
)
from tests.enn.imitation.straight_wire import Expert, vessels

SIZE = 64


def wires(count: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Noisy images of bent lines that come in from below, the same without them, and where they are."""
    generator = np.random.default_rng(seed)
    images, plains, masks = [], [], []
    rows = np.arange(SIZE)[:, None]
    for column, slope, bend, top in generator.uniform((16, -0.3, -0.004, 8), (48, 0.3, 0.004, 40), (count, 4)):
        from_below = SIZE - 1 - rows
        middle = column + slope * from_below + bend * from_below**2
        mask = (np.abs(np.arange(SIZE) - middle) < 0.8) & (rows > top)
        grey = 120 + 20 * np.sin(np.arange(SIZE) / 9)[None, :] + np.zeros((SIZE, 1))
        noise = generator.normal(0.0, 2.0, (2, SIZE, SIZE))
        plains.append(np.clip(np.rint(grey + noise[0]), 0, 255).astype(np.uint8))
        images.append(np.clip(np.rint(grey - 14 * mask + noise[1]), 0, 255).astype(np.uint8))
        masks.append(mask.astype(np.uint8))
    return np.stack(images), np.stack(plains), np.stack(masks)


@pytest.fixture(scope="module")
def network() -> WireSegmenter:
    return fit_wire_segmenter(*wires(60, 0), epochs=30)[0]


def test_it_finds_wires_it_has_not_seen(network: WireSegmenter) -> None:
    images, plains, masks = wires(20, 1)
    assert dice(network, images, plains, masks) > 0.85
    assert network.mask(plains[0], plains[1]).sum() < 3 * 255  # no wire, no mask
    assert set(np.unique(network.mask(images[0], plains[0]))) == {0, 255}


def test_a_gap_is_closed(network: WireSegmenter) -> None:
    images, plains, masks = wires(1, 2)
    row = int(np.flatnonzero(masks[0].any(axis=1)).mean())
    images[0, row : row + 2] = plains[0, row : row + 2]
    assert (network.mask(images[0], plains[0])[row : row + 2].max(axis=1) == 255).all()


class DrawnWires(gymnasium.Env):
    """A wire that is there from the start, in the image and the mask of a case; an episode takes 24 steps."""

    action_space = gymnasium.spaces.Box(-1, 1, (2,), np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.steps = 0
        image, plain, mask = wires(1, (options or {})["case"])
        noise = self.np_random.integers(0, 2, image.shape, np.uint8)
        self.seen = {"image": image + noise, "plain": plain, "mask": mask, "roadmap": np.zeros(3, np.float32)}
        return self.seen, {}

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.steps += 1
        return self.seen, 0.0, False, self.steps >= 24, {}


def test_frames_come_from_every_case_and_repeat_themselves() -> None:
    frames, again = (wire_frames(DrawnWires(), Expert(), (3, 5), np.random.default_rng(4)) for _ in range(2))
    for one, other in zip(frames, again, strict=True):
        assert one.shape == (6, SIZE, SIZE)
        np.testing.assert_array_equal(one, other)
    for place, case in ((0, 3), (3, 5)):
        np.testing.assert_array_equal(frames[2][place], wires(1, case)[2][0])


def test_a_faint_wire_is_found_in_the_dark_where_there_is_little_noise(network: WireSegmenter) -> None:
    images, plains, masks = wires(20, 3)
    faint, dark = (np.rint(0.4 * one.astype(float)).astype(np.uint8) for one in (images, plains))
    assert dice(network, faint, dark, masks) > 0.85
    assert network.mask(dark[0], dark[1]).sum() < 3 * 255  # no wire, no mask


def test_segmenter_finds_lumens_it_has_not_seen() -> None:
    images, lumens = vessels(24, 0)
    segmenter, _ = fit_segmenter(images, lumens, epochs=12, working_size=images.shape[-1])
    images, lumens = vessels(8, 1)
    assert overlap(segmenter, images, lumens) > 0.8
    assert overlap(segmenter, 0.5 * images + 60, lumens) > 0.8  # brightness and contrast do not matter
