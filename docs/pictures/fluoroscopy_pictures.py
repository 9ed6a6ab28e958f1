"""Makes the fluoroscopy page's pictures: python docs/pictures/fluoroscopy_pictures.py."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from cathsim import NavigateEnv
from cathsim.fluoroscopy import BiplaneFluoroscope, Box, Ellipsoid, Projector, XRayCamera, expose_depth, guide3d_pair
from cathsim.fluoroscopy.materials import ATTENUATION
from cathsim.fluoroscopy.radiograph import DepthFunction
from cathsim.fluoroscopy.scene import XRayScene, body_depth
from cathsim.observations.fluoroscopes import points_to_border
from cathsim.planning.sampling import SamplingExpert

FOLDER = Path(__file__).parent
SHOWN = 380  # px, side of an image on the page
BEAD_PITCH, BEAD_RADIUS = 0.065, 0.00145  # m
BEAD_ATTENUATION = 2060.0  # 1/m, steel at 45 keV: nothing thick is in the beam
SHEET_PITCH_PX, SHEET_HOLE, SHEET_DEPTH = {"a": 15.0, "b": 14.1}, 0.72, 4.0  # hole's diameter over the pitch


def expert_wire() -> tuple[NavigateEnv, np.ndarray]:
    """An environment whose wire an expert has brought into the BCA, and the wire's nodes."""
    environment = NavigateEnv("type_1", "bca", observation="tip")
    expert = SamplingExpert(environment, seed=0)
    environment.reset(seed=0)
    while not any(environment.step(expert.action())[2:4]):
        pass
    expert.close()
    return environment, points_to_border(environment.simulation)


def bead_cube(camera: XRayCamera) -> np.ndarray:
    """X-ray image of 64 steel beads in four acrylic walls, turned a little; (height, width)."""
    tilt, turn = np.radians(4.0), np.radians(-19.0)
    R = np.array([[1, 0, 0], [0, np.cos(turn), -np.sin(turn)], [0, np.sin(turn), np.cos(turn)]])
    R = R @ np.array([[np.cos(tilt), -np.sin(tilt), 0], [np.sin(tilt), np.cos(tilt), 0], [0, 0, 1]])
    lattice = (np.stack(np.meshgrid(*[np.arange(4) - 1.5] * 3), axis=-1).reshape(-1, 3) * BEAD_PITCH) @ R.T
    radius = (BEAD_RADIUS,) * 3
    beads = [Ellipsoid((x, y, z), radius, BEAD_ATTENUATION) for x, y, z in lattice.tolist()]
    acrylic = ATTENUATION["acrylic"]
    walls = [Box((0, side * 0.104, 0.02), (0.14, 0.005, 0.09), acrylic) for side in (-1.0, 1.0)]
    walls += [Box((0, 0.02, side * 0.104), (0.14, 0.09, 0.005), acrylic) for side in (-1.0, 1.0)]
    rail = Box((-0.099, 0.0, 0.0), (0.007, 0.09, 0.005), 30.0)
    origin = np.zeros(3)
    empty = XRayScene("cube", (), 0.0, 0.0, 0.0, 0.0, scatter=0.05)
    return _seen(camera, empty, lambda projector: body_depth(projector, (*beads, *walls, rail), origin))


def perforated_sheet(camera: XRayCamera) -> np.ndarray:
    """X-ray image of a steel sheet with a hexagonal pattern of round holes on the detector; (height, width)."""
    pitch = SHEET_PITCH_PX[camera.name]
    middle = camera.projector.K[:2, 2]

    def depth(projector: Projector) -> np.ndarray:
        # holes are placed in the ideal image of the camera, whatever window of it is asked for
        shift = projector.K[:2, 2] - middle
        u, v = np.meshgrid(np.arange(projector.width) - shift[0], np.arange(projector.height) - shift[1])
        cover = np.zeros(u.shape)
        for du, dv in np.stack(np.meshgrid([-0.33, 0, 0.33], [-0.33, 0, 0.33]), axis=-1).reshape(-1, 2):
            x, y = (u + du) * np.cos(0.42) + (v + dv) * np.sin(0.42), (v + dv) * np.cos(0.42) - (u + du) * np.sin(0.42)
            nearest = np.full(u.shape, np.inf)
            for offset in (0.0, 0.5):
                a, b = x / pitch - offset, y / (pitch * np.sqrt(3)) - offset
                nearest = np.minimum(nearest, np.hypot((a - np.rint(a)) * pitch, (b - np.rint(b)) * pitch * np.sqrt(3)))
            cover += np.exp(-SHEET_DEPTH * (nearest > SHEET_HOLE * pitch / 2)) / 9
        return -np.log(cover).astype(np.float32)

    return _seen(camera, XRayScene("sheet", (), 0.0, 0.0, 0.0, 0.0, scatter=0.03, middle=115.0), depth)


def _seen(camera: XRayCamera, scene: XRayScene, depth: DepthFunction) -> np.ndarray:
    fluoroscope = BiplaneFluoroscope([camera], [expose_depth(camera, scene, depth)])
    return fluoroscope.render(np.zeros((0, 3)), 7)[camera.name].image


def pair() -> None:
    """One moment in the public data set's geometry, the tip with its mask, and the same wire in other scenes."""
    environment, wire = expert_wire()
    fluoroscope = BiplaneFluoroscope.of(environment.phantom)
    frames = fluoroscope.render(wire, 0)
    rows = [shrunk(frame.image) for frame in frames.values()]
    save(np.concatenate(rows, axis=1), "fluoroscopy_pair.png")
    tips = []
    for name, frame in frames.items():
        u, v = fluoroscope.centreline(wire, name)[0]
        left, top = (int(np.clip(x - SHOWN / 4, 0, 1024 - SHOWN // 2)) for x in (u, v))
        window = slice(top, top + SHOWN // 2), slice(left, left + SHOWN // 2)
        image = frame.image[window].repeat(2, 0).repeat(2, 1)
        tips.append(np.concatenate((image, 255 * frame.mask[window].repeat(2, 0).repeat(2, 1)), axis=1))
    save(np.concatenate(tips, axis=0), "fluoroscopy_tip.png")
    scenes = []
    for geometry, surroundings, filling in (
        ("guide3d", "bath", "air"),
        ("guide3d", "bath", "contrast"),
        ("clinical", "patient", "fluid"),
        ("clinical", "patient", "contrast"),
    ):
        fluoroscope = BiplaneFluoroscope.of(
            environment.phantom, geometry, surroundings=surroundings, filling=filling, size=1024
        )
        both = fluoroscope.render(wire, 0)
        scenes.append(np.concatenate([shrunk(frame.image) for frame in both.values()], axis=1))
    save(
        np.concatenate([np.concatenate(scenes[:2], axis=1), np.concatenate(scenes[2:], axis=1)]),
        "fluoroscopy_scenes.png",
    )


def calibration() -> None:
    """The calibration objects as both simulated cameras see them."""
    cameras = guide3d_pair(np.zeros(3))
    rows = [
        np.concatenate([shrunk(make(camera)) for camera in cameras], axis=1) for make in (perforated_sheet, bead_cube)
    ]
    save(np.concatenate(rows, axis=1), "fluoroscopy_calibration.png")


def shrunk(image: np.ndarray) -> np.ndarray:
    """An image at the page's size."""
    return np.asarray(Image.fromarray(image).resize((SHOWN, SHOWN), Image.Resampling.LANCZOS))


def save(picture: np.ndarray, name: str) -> None:
    """Writes a PNG of few greys, as it lies in the repository."""
    FOLDER.mkdir(exist_ok=True)
    Image.fromarray(picture).quantize(64, dither=Image.Dither.NONE).save(FOLDER / name, optimize=True)


if __name__ == "__main__":
    pair()
    calibration()
