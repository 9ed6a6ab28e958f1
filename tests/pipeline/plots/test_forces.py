"""Plots of contact forces: the heat map is drawn from the contacts of episodes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from PIL import Image

from pipeline.evaluations.forces import EpisodeForces
from pipeline.plots.forces import draw_heat


def test_a_heat_map_has_the_colour_of_force_only_where_contacts_are(tmp_path: Path) -> None:
    vertices = np.asarray(trimesh.creation.icosphere(subdivisions=4, radius=0.02).vertices)
    points = np.array([[0.0, 0.0, 0.02], [0.0, 0.0, 0.02], [0.02, 0.0, 0.0]])
    coloured = []
    for count in (0, 3):
        forces = np.array([0.3, 0.1, 0.2])[:count]
        episode = EpisodeForces("type_1", "bca", "sampling_expert", 0.15, np.ones(4), points[:count], forces)
        draw_heat(vertices, [episode], tmp_path / "heat.png", title="sphere")
        image = np.asarray(Image.open(tmp_path / "heat.png").convert("RGB"), dtype=int)[:, : image_half(tmp_path)]
        coloured.append(((image[..., 0] > 200) & (image[..., 1] < 60)).sum())
    assert coloured[1] > coloured[0]


def image_half(folder: Path) -> int:
    """Columns up to the colour bar of the left picture."""
    return int(0.38 * Image.open(folder / "heat.png").width)
