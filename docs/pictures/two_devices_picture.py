"""Makes the picture of a wire in a catheter: python docs/pictures/two_devices_picture.py.

Rows: vertebral and Simmons 2 catheter over the wire in type_1. Columns: frontal view, camera a, camera b, 3-D.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image, ImageOps

from cathsim import NavigateEnv
from cathsim.devices.simulation import DualSimulation
from cathsim.fluoroscopy import BiplaneFluoroscope
from cathsim.observations.fluoroscopes import BiplaneView, Fluoroscope
from cathsim.viewing.camera_view import View

SIDE = 220  # px of a tile
ADVANCED, LEAD = 0.16, 0.045  # m: the catheter's insertion, and how far the wire is ahead
SEEN_PX = {"frontal": 110, "a": 170, "b": 170}  # side of the cut about the catheter's tip


def moved(catheter: str) -> DualSimulation:
    """Both devices, brought into the arch."""
    environment = NavigateEnv("type_1", "lcca", catheter=catheter, observation="tip")
    environment.reset(seed=0)
    simulation = environment.simulation
    assert isinstance(simulation, DualSimulation)
    while simulation.device_insertions()[1] < ADVANCED:
        ahead = simulation.device_lead
        pushed = 0.0 if ahead < LEAD - 0.015 else 0.0015
        simulation.advance(0.002 if ahead < LEAD else 0.001, 0.05, catheter=(pushed, 0.05))
    return simulation


def cut(image: np.ndarray, pixel: np.ndarray, side: int) -> np.ndarray:
    """A square about a pixel, as a tile."""
    height, width = image.shape[:2]
    left, top = (
        int(np.clip(round(at) - side // 2, 0, most - side)) for at, most in zip(pixel, (width, height), strict=True)
    )
    part = Image.fromarray(image).crop((left, top, left + side, top + side))
    part = ImageOps.autocontrast(part) if image.ndim == 2 else part
    return np.asarray(part.resize((SIDE, SIDE), Image.Resampling.LANCZOS).convert("RGB"))


def row(catheter: str) -> np.ndarray:
    """The four tiles of a catheter."""
    simulation = moved(catheter)
    tip = simulation.device_points("catheter")[:1]
    frontal = Fluoroscope(simulation, 512)
    tiles = [cut(frontal.image(), frontal.renderer.projector.project(tip)[0], SEEN_PX["frontal"])]
    biplane = BiplaneView(simulation, BiplaneFluoroscope.of(simulation.phantom))
    biplane.update(seed=1)
    for name, camera in biplane.fluoroscope.cameras.items():
        tiles.append(cut(biplane.frame(name).image, camera.pixels(tip)[0], SEEN_PX[name]))
    view = View(simulation.phantom, width=1200, height=1600)
    picture = view.render(simulation)
    view.close()
    blue = picture[..., 2].astype(int) - picture[..., 0] > 25  # the catheter's colour; its highest pixel is its tip
    y, x = np.argwhere(blue)[0]
    tiles.append(cut(picture, np.array([x, y + 60]), 420))
    return np.concatenate(tiles, axis=1)


def palette(sheet: np.ndarray) -> Image.Image:
    """Greys for the X-ray images, and the colours of the 3-D view."""
    greys = np.repeat(np.linspace(0, 255, 24).round().astype(np.uint8), 3).tolist()
    coloured = Image.fromarray(sheet[:, 3 * SIDE :]).quantize(40, method=Image.Quantize.MAXCOVERAGE).getpalette()
    colours = Image.new("P", (1, 1))
    colours.putpalette(greys + (coloured or [])[:120])
    return colours


if __name__ == "__main__":
    sheet = np.ascontiguousarray(np.concatenate([row(name) for name in ("vertebral", "simmons2")]))
    quantized = Image.fromarray(sheet).quantize(palette=palette(sheet), dither=Image.Dither.NONE)
    quantized.save(Path(__file__).parent / "two_devices.png", optimize=True)
