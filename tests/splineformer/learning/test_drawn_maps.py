"""Maps drawn without an image: wires lie along their curves, and seeds decide everything."""

from __future__ import annotations

import numpy as np

from splineformer.learning.drawn_maps import drawn_map

SIDE = 128


def test_a_seed_gives_the_same_map() -> None:
    one, two = (drawn_map(np.random.default_rng(5), SIDE) for _ in range(2))
    assert np.array_equal(one.picture, two.picture)
    assert one.wires == two.wires
    assert not np.array_equal(one.picture, drawn_map(np.random.default_rng(6), SIDE).picture)


def test_wires_lie_along_their_curves() -> None:
    generator = np.random.default_rng(0)
    drawn = [drawn_map(generator, SIDE) for _ in range(120)]
    assert {one.wires for one in drawn} == {0, 1, 2}
    dark, length = [], []
    for one in drawn:
        assert one.picture.shape == (SIDE, SIDE)
        assert (one.curve is None) == (one.wires == 0)
        if one.curve is not None:
            assert ((one.curve >= -1e-9) & (one.curve <= 1 + 1e-9)).all()
            column, row = np.clip(one.curve * SIDE, 0, SIDE - 1).astype(int).T
            dark.append(float(np.median(one.picture[row, column])))
            length.append(len(one.curve))
    # most of a wire is dark; gaps and what is missing are some of it
    assert np.mean(np.array(dark) < 200) > 0.9
    assert max(length) > 3 * min(length)
    assert np.mean([(one.picture > 250).mean() for one in drawn]) > 0.9
