"""Draw the picture of the arch variety: one arch of each branching type, and six as scans show them.

python docs/pictures/arch_variety_picture.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from cathsim.anatomy import Phantom, load_phantom
from cathsim.anatomy.generator.variety_arch import ARCH_TYPES
from cathsim.anatomy.pictures.phantom_picture import render_lumen

SEED = 201
HALF_WIDTH, HALF_HEIGHT, PIXEL = 0.075, 0.125, 5e-4  # m
TURN = 25.0  # degrees of the view about the superior axis


def draw(panel, phantom: Phantom, title: str, *, names: bool) -> None:
    """One phantom, all to one scale, with the names of its branches at their ends."""
    centre = phantom.bounds.mean(axis=0)
    panel.imshow(render_lumen(phantom, TURN, HALF_WIDTH, HALF_HEIGHT, PIXEL), origin="lower", interpolation="bilinear")
    right = np.array([np.cos(np.radians(TURN)), np.sin(np.radians(TURN)), 0.0])
    for branch in phantom.tree.branches[1:] if names else ():
        offset = branch.points[-1 if branch.open_end else len(branch.points) // 2] - centre
        at = (HALF_WIDTH + offset @ right) / PIXEL, (HALF_HEIGHT + offset[2]) / PIXEL
        label = branch.name.replace("_", "\n") if not branch.open_end else branch.name
        panel.annotate(label, at, (0, 4), textcoords="offset points", fontsize=6, ha="center", color="#1c2a3a")
    panel.set_title(title, fontsize=8)
    panel.set_axis_off()


figure = Figure(figsize=(9.0, 5.6), dpi=110, facecolor="white", layout="constrained")
FigureCanvasAgg(figure)
panels = figure.subplots(2, 6)
for panel, kind in zip(panels[0], ARCH_TYPES, strict=True):
    draw(panel, load_phantom(f"arch_variety_{kind}", seed=SEED), f"type {kind}", names=True)
for panel, seed in zip(panels[1], range(6), strict=True):
    draw(panel, load_phantom("random_scan", seed=seed), f"random_scan, seed {seed}", names=False)
path = Path(__file__).parent / "arch_variety.png"
figure.savefig(path)
print(path)
