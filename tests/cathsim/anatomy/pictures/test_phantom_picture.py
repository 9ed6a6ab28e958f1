"""The phantom's picture."""

import numpy as np

from cathsim.anatomy.pictures.phantom_picture import VIEWS, draw_phantom, render_lumen


def test_the_picture_shows_the_vessel_from_every_side(phantom, tmp_path):
    path = tmp_path / "type_1.png"
    figure = draw_phantom(phantom, path, pixel=2e-3)
    assert path.read_bytes().startswith(b"\x89PNG")
    assert [axes.get_title() for axes in figure.axes] == list(VIEWS)
    silhouettes = []
    for axes in figure.axes:
        image = axes.images[0].get_array()
        vessel = np.any(np.asarray(image) < 0.99, axis=-1)
        silhouettes.append(vessel.mean())
        texts = {text.get_text() for text in axes.texts}
        assert set(phantom.targets) <= texts
    # From the front the shadow is that of the lumen: its area in the grid, seen along y.
    shadow = np.count_nonzero((phantom.grid.values > 0).any(axis=1)) * phantom.grid.spacing**2
    rows, columns = np.asarray(figure.axes[0].images[0].get_array()).shape[:2]
    assert abs(silhouettes[0] * rows * columns * 4e-6 / shadow - 1) < 0.05
    assert silhouettes[0] != silhouettes[2]


def test_a_lumen_is_rendered_alone(phantom):
    image = render_lumen(phantom, 25.0, 0.05, 0.08, 1e-3)
    assert image.shape == (160, 100, 3)
    assert (image[0, 0] == 1).all()  # white beside the vessel
    assert image.min() < 0.5
