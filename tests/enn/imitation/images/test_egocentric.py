"""The egocentric view: tracing the wire, ways through the lumen, and a look that does not depend on where it is."""

import itertools

import numpy as np
import pytest

from enn.imitation.images.egocentric import CATHETER_SIZE, LENGTH_SCALE, VIEW_SIZE, WAY_ARCS, WIRE_ARCS, EgocentricView
from enn.imitation.images.wire_tracing import trace_wire

SIZE = 128
REST = (0.0, 0.0)


def drawn(points: np.ndarray, size: int = SIZE, radius: float = 0.8) -> np.ndarray:
    """Mask of a polyline, rows and columns in px."""
    pairs = itertools.pairwise(points)
    fine = np.concatenate([np.linspace(a, b, max(int(np.hypot(*(b - a)) / 0.8), 2)) for a, b in pairs])
    rows, columns = np.mgrid[:size, :size]
    grid = np.stack((rows, columns), axis=-1).reshape(-1, 1, 2)
    near = np.concatenate([np.hypot(*(part - fine).transpose(2, 0, 1)).min(1) for part in np.array_split(grid, 32)])
    return (near.reshape(size, size) <= radius).astype(np.uint8) * 255


class Scene:
    """A vertical vessel with a branch to the right, a wire in it, and the target at the branch's end."""

    def __init__(self, shift: tuple[int, int] = (0, 0)) -> None:
        moved = np.array(shift, float)
        self.wire = np.array([(50.0, 46.0), (60.0, 40.0), (80.0, 40.0), (120.0, 40.0)]) + moved
        rows, columns = np.mgrid[:SIZE, :SIZE] - moved[:, None, None]
        trunk = (np.abs(columns - 40) < 8) & (rows > 24)
        branch = (np.abs(rows - 44) < 5) & (columns > 40) & (columns < 100)
        self.lumen = (trunk | branch).astype(float)
        self.target = np.array([44.0, 92.0]) + moved
        self.dot = (np.hypot(rows - 44.0, columns - 92.0) < 3).astype(np.uint8)[None] * 255
        self.mask = drawn(self.wire)[None]
        self.first_mask = drawn(self.wire[2:])[None]

    def image(self, mask: np.ndarray) -> np.ndarray:
        grey = 160.0 - 30 * self.lumen
        return np.where(mask > 0, 20, grey).astype(np.uint8).reshape(1, SIZE, SIZE)

    def view(self) -> EgocentricView:
        view = EgocentricView()
        view.start(self.image(self.first_mask), self.first_mask, self.dot, self.lumen)
        return view

    def look(self) -> np.ndarray:
        return self.view().look(self.image(self.mask), self.mask, REST)


def test_traces_the_wire_from_the_tip_through_a_loop() -> None:
    angle = np.linspace(np.pi, -0.8 * np.pi, 40)
    loop = np.stack((40 + 18 * np.sin(-angle), 60 + 18 * np.cos(angle)), axis=1)
    way = np.concatenate((loop[::-1], [(120.0, 42.0)]))
    traced = trace_wire(drawn(way) > 0)
    assert np.hypot(*(traced[0] - way[0])) < 2.0
    assert np.hypot(*(traced[-1] - way[-1])) < 2.0
    assert np.abs(np.diff(traced, axis=0)).max() == 1
    assert len(traced) > 0.8 * (18 * 1.8 * np.pi + 78) / 1.42


def test_a_look_is_of_the_order_of_one_and_says_where_to_go() -> None:
    seen = Scene().look()
    assert seen.shape == (VIEW_SIZE,)
    assert seen.dtype == np.float32
    assert np.isfinite(seen).all()
    assert np.abs(seen).max() <= 5.0
    ahead = seen[: 2 * len(WAY_ARCS)].reshape(-1, 2)
    assert (ahead[2:, 0] > 0.5).all()  # the wire points into the branch
    behind = seen[2 * len(WAY_ARCS) + 5 :][: 2 * len(WIRE_ARCS)].reshape(-1, 2)
    assert (behind[:, 0] < 0).all()
    assert np.abs(np.hypot(*behind[0])) == pytest.approx(1.0, abs=0.1)


def test_refuses_images_that_do_not_fit() -> None:
    scene = Scene()
    view = EgocentricView()
    with pytest.raises(ValueError, match="expected images of one shape"):
        view.start(scene.image(scene.mask), scene.mask[:, 1:], scene.dot, scene.lumen)
    with pytest.raises(ValueError, match="shows no dot"):
        view.start(scene.image(scene.mask), scene.mask, np.zeros_like(scene.dot), scene.lumen)


def test_a_catheters_end_is_seen_from_the_tip() -> None:
    """The wire comes 20 px upwards out of the catheter and 12 px to the upper right."""
    scene = Scene()
    tube = drawn(scene.wire[2:], radius=1.6)[None]
    look = scene.view().look(scene.image(scene.mask), scene.mask, REST, tube)
    np.testing.assert_array_equal(look[:VIEW_SIZE], scene.look())
    seen, far, near, along, across, *direction = look[VIEW_SIZE:]
    assert len(look) == VIEW_SIZE + CATHETER_SIZE
    assert seen == 1
    assert 5 * LENGTH_SCALE * far * SIZE == pytest.approx(31.7, abs=4)
    assert near == pytest.approx(np.tanh(5 * far), abs=1e-5)
    up_right = (scene.wire[0] - scene.wire[1]) / np.hypot(*(scene.wire[0] - scene.wire[1]))
    place = (scene.wire[2] - scene.wire[0]) / SIZE / LENGTH_SCALE
    sideways = np.array([-up_right[1], up_right[0]])
    np.testing.assert_allclose((along, across), (place @ up_right, place @ sideways), atol=0.35)
    np.testing.assert_allclose(direction, (-up_right[0], -sideways[0]), atol=0.2)  # upwards
    nothing = scene.view().look(scene.image(scene.mask), scene.mask, REST, 0 * tube)[VIEW_SIZE:]
    assert nothing[0] == 0
    assert 5 * LENGTH_SCALE * nothing[1] * SIZE == pytest.approx(71.7, abs=6)
    covered = scene.view().look(scene.image(scene.mask), scene.mask, REST, scene.mask)[VIEW_SIZE:]
    assert tuple(covered[:3]) == (1, 0, 0)


def test_a_wire_that_comes_in_later_is_traced_from_where_it_comes_in_whatever_the_first_image_shows() -> None:
    scene = Scene()
    speck = np.zeros_like(scene.mask)
    speck[0, 5, 100:103] = 255  # taken for a wire before there is one
    for first in (np.zeros_like(scene.mask), speck):
        view = EgocentricView()
        view.start(scene.image(first), first, scene.dot, scene.lumen)
        np.testing.assert_allclose(view.wire(scene.image(first), first), [[126 / SIZE, 0.5], [127 / SIZE, 0.5]])
        short = drawn(np.array([(122.0, 40.0), (127.0, 40.0)]))[None]
        assert len(view.wire(scene.image(short), short)) > 2  # seen, but too short to tell its tip from its entry
        both = np.maximum(scene.mask, speck)
        found = view.wire(scene.image(both), both)
        assert np.hypot(*(found[0] * SIZE - 0.5 - scene.wire[0])) < 2.0
        assert np.hypot(*(found[-1] * SIZE - 0.5 - scene.wire[-1])) < 2.0
