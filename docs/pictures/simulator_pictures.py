"""Makes the pictures of the documentation: python docs/pictures/simulator_pictures.py."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from cathsim import PHANTOMS, NavigateEnv, load_phantom
from cathsim.blood.picture import picture as blood_picture
from cathsim.viewing.camera_view import View

FOLDER = Path(__file__).parent
SIZE = 360


def phantoms() -> None:
    """All named phantoms from the front, with the wire's way in."""
    columns = []
    for name in PHANTOMS:
        environment = NavigateEnv(name, observation="tip")
        environment.reset(seed=0)
        for _ in range(20):
            environment.step(np.array([1.0, 0.0]))
        view = View(load_phantom(name), width=260, height=SIZE)
        picture = Image.fromarray(view.render(environment.simulation))
        ImageDraw.Draw(picture).text((8, SIZE - 26), name, fill=(40, 40, 40), font_size=18)
        view.close()
        columns.append(np.asarray(picture))
    rows = [np.concatenate(columns[i : i + 3], axis=1) for i in (0, 3)]
    save(np.concatenate(rows), "phantoms.png")


def blood() -> None:
    """The pulsatile flow in the Type I arch."""
    figure = blood_picture(load_phantom("type_1"))
    figure.canvas.draw()  # type: ignore[attr-defined]
    save(np.asarray(figure.canvas.buffer_rgba())[:, :, :3], "blood.png")  # type: ignore[attr-defined]


def robot() -> None:
    """The follower robot driving, returning with its rear clamp open, and in its second stroke; one view from aside."""
    environment = NavigateEnv("type_1", "bca", observation="tip", drive="robot")
    front, aside = (
        View(
            environment.phantom,
            width=300,
            height=620,
            azimuth_deg=azimuth,
            elevation_deg=elevation,
            robot=environment.robot,
        )
        for azimuth, elevation in ((90.0, 0.0), (55.0, -18.0))
    )
    columns = []
    environment.reset(seed=0)
    for steps, said in ((12, "advance"), (13, "return"), (27, "advance, 2nd stroke")):
        for _ in range(steps):
            *_, info = environment.step(np.array([1.0, 0.1]))
        picture = Image.fromarray(front.render(environment.simulation))
        text = f"{said}\n{1e3 * info['insertion']:.0f} mm inserted"
        ImageDraw.Draw(picture).text((8, 560), text, fill=(40, 40, 40), font_size=16)
        columns.append(np.asarray(picture))
    columns.append(aside.render(environment.simulation))
    for view in (front, aside):
        view.close()
    save(np.concatenate(columns, axis=1), "robot.png")


def save(picture: np.ndarray, name: str) -> None:
    """Writes a PNG of few colours, as it lies in the repository."""
    FOLDER.mkdir(exist_ok=True)
    Image.fromarray(picture).quantize(160, dither=Image.Dither.NONE).save(FOLDER / name, optimize=True)


if __name__ == "__main__":
    phantoms()
    blood()
    robot()
