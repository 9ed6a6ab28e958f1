"""Plots of learning: what is given is drawn."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from pipeline.report.learning_plots import Curve, Point, draw_front, draw_generalisation, draw_training


def curve(x: list[float], y: list[float]) -> Curve:
    values = {"decisions": np.array(x), "env_steps": np.array(x), "reward": np.array(y)}
    return Curve("enn", "type_1", "bca", "V", "seed0", values)


def image(path: Path) -> np.ndarray:
    return np.asarray(Image.open(path).convert("RGB"))


def test_plots_show_what_they_are_given(tmp_path: Path) -> None:
    """A curve more, a weight more, an anatomy more: each darkens more pixels."""
    one, two = (
        {"V": [curve([0, 1, 2], [0, 1, 0])]},
        {"V": [curve([0, 1, 2], [0, 1, 0])], "I": [curve([0, 1, 2], [1, 0, 1])]},
    )
    for name, rows in (("one", one), ("two", two)):
        draw_training({"task": rows}, {"I": "Internal"}, tmp_path / f"{name}.png")
    assert (image(tmp_path / "one.png") < 250).sum() < (image(tmp_path / "two.png") < 250).sum()
    points = [
        Point("a", "I+V+M", None, (0.2, 0.01), (100.0, 0.0), (0.9, 0.1), (90.0, 3.0)),
        Point("a", "safe 1", 1.0, (0.1, 0.01), (95.0, 2.0), (0.4, 0.1), (100.0, 2.0)),
    ]
    draw_front(points[:1], tmp_path / "front_1.png")
    draw_front(points, tmp_path / "front_2.png")
    assert (image(tmp_path / "front_1.png") != 255).sum() < (image(tmp_path / "front_2.png") != 255).sum()
    draw_generalisation({"roadmap": [(4, 80.0, 1.0), (1, 50.0, 0.0)]}, tmp_path / "generalisation.png")
    assert image(tmp_path / "generalisation.png").std() > 5
