"""Draw the picture of two views in space: wire, way and target as found in two noisy X-ray images of an arch.

python docs/pictures/stereo_picture.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import enn
from cathsim.arch_variety import ArchVarietyEnv
from cathsim.observations.framing import field_projections
from cathsim.observations.xray import XrayEnvironment
from enn.imitation.images.stereo_geometry import StereoGeometry, projected
from enn.imitation.images.stereo_view import StereoView
from enn.imitation.images.visual_hull import SeenVoxels
from pipeline.task import task_in_random_arches

SEED, STEPS = 30, 36  # of the arches of both types; steps that the roadmap policy has steered

navigator, teacher = enn.load("navigator_arch_variety"), enn.load("arch_variety")
perception, side = navigator.perception, task_in_random_arches().image_size_px
geometry = StereoGeometry(field_projections(navigator.cameras, perception.field), perception.field)
voxels = SeenVoxels(geometry)
seen = ("goal_image", *teacher.keys)
bare = ArchVarietyEnv(["II", "VI"], [SEED], max_steps=2 * STEPS, image_size=side, observation=seen)
environment = XrayEnvironment(bare, side, **navigator.imaging)

figure = Figure(figsize=(9.0, 6.2), dpi=100, facecolor="white", layout="constrained")
FigureCanvasAgg(figure)
for row, (panels, kind) in enumerate(zip(figure.subplots(2, 3), ("II", "VI"), strict=True)):
    observation, info = environment.reset(seed=row, options={"case": bare.case_of(row)})
    controller, views = teacher.controller(seed=0), perception.begin(observation).cameras
    dots = [view.target + 0.5 / side for view in views]
    stereo = StereoView(voxels, [view.lumen for view in views], dots)
    contrast = observation["contrast"]
    for _ in range(STEPS):
        observation, _, _, _, info = environment.step(controller(observation, info))
    masks = perception.mask(observation)
    axes = [view.wire(observation["image"][k : k + 1], masks[k : k + 1]) for k, view in enumerate(views)]
    wire = stereo.wire(axes)[0]
    way = stereo.hull.way(wire[0])[0]
    for k, panel in enumerate(panels[:2]):
        panel.imshow(np.where(masks[k] > 0, observation["image"][k], contrast[k]), cmap="gray")
        for points, colour in ((wire, "#19c3d6"), (way, "#f2c230")):
            panel.plot(*(projected(geometry.projections[k], points) * side - 0.5).T, color=colour, lw=1.4)
        panel.plot(*(dots[k][::-1] * side - 0.5), "+", color="#e0352b", ms=10)
        panel.set_title(
            f"type {kind}, {navigator.cameras[k]}: target in {bare.phantom.target(bare.task.target).branch}", fontsize=8
        )
        panel.set_axis_off()
    hull = 1e3 * voxels.place(np.argwhere(stereo.hull.inside))
    side_view = panels[2]
    side_view.plot(hull[:, 1], hull[:, 2], ",", color="#9aa4ad")
    for points, colour in ((wire, "#19c3d6"), (way, "#d09a00")):
        side_view.plot(1e3 * points[:, 1], 1e3 * points[:, 2], color=colour, lw=1.4)
    side_view.plot(*(1e3 * stereo.hull.target[1:]), "+", color="#e0352b", ms=10)
    side_view.set(aspect="equal", xlabel="posterior, mm from the isocentre", ylabel="superior, mm")
    side_view.set_title("hull, wire and way from the side", fontsize=8)
path = Path(__file__).parent / "stereo.png"
figure.savefig(path)
print(path)
