"""Sensor: from attenuation to the grey values of a recorded image, with field, blur, noise, gamma and compression."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from guide3d.opencv import cv2
from guide3d.random_fluoroscopy.canvas import Canvas, Image, Points
from guide3d.random_fluoroscopy.phantom_clutter import log_uniform
from guide3d.random_fluoroscopy.settings import FluoroscopySettings

Generator = np.random.Generator

_MOST = 3.0  # attenuation above which an image is as good as black
_VISIBLE = 0.12  # share of the light above which a place belongs to the field


def light_field(canvas: Canvas, generator: Generator, settings: FluoroscopySettings) -> tuple[Image, str]:
    """The light (height, width), 0 to 1, that the beam and its apertures leave in a window, and the field's shape.

    Round fields, squares with round corners and octagons are the intensifier's or the detector's; straight blades at
    any side and angle are the collimator's, through which a little light comes.
    """
    side = settings.image_px
    light = np.ones((canvas.height, canvas.width), np.float32)
    x = np.arange(canvas.width, dtype=np.float32) + canvas.left
    y = (np.arange(canvas.height, dtype=np.float32) + canvas.top)[:, None]
    centre = side * (0.5 + generator.normal(0, 0.04, 2))
    slope = generator.normal(0, 0.12, 2) / side
    vignette = generator.uniform(0, 0.8)
    shape = "open"
    draw = generator.random(2)
    leak, soft = generator.uniform(0.0, 0.06), log_uniform(generator, 1.0, 14.0)
    radius = side * generator.uniform(0.45, 0.62)
    corner = generator.uniform(0.0, 1.0)
    dx, dy = x - np.float32(centre[0]), y - np.float32(centre[1])
    squares = dx * dx + dy * dy
    light *= 1 + slope[0] * dx + slope[1] * dy
    light *= 1 - np.float32(vignette * 1.1 / side**2) * squares
    if draw[0] < settings.field:
        inside: Image | None = None
        if draw[1] < 0.5:
            shape, inside = "round", radius - np.sqrt(squares)
        elif draw[1] < 0.65:
            shape = "square"
            half = side * generator.uniform(0.38, 0.5)
            rounded = half * (0.05 + 0.5 * corner)
            ex, ey = np.maximum(np.abs(dx) - half + rounded, 0), np.maximum(np.abs(dy) - half + rounded, 0)
            inside = rounded - np.sqrt(ex * ex + ey * ey)
        elif draw[1] < 0.75:
            shape = "octagon"
            inside = np.minimum(radius - np.maximum(np.abs(dx), np.abs(dy)), 1.35 * radius - np.abs(dx) - np.abs(dy))
        if inside is not None:
            light *= edge(inside, soft, leak)
        if draw[1] > 0.75 or generator.random() < 0.12:
            shape = "collimated" if shape == "open" else shape
            turn = generator.normal(0, 0.15)
            leak = generator.uniform(0.0, 0.05) if generator.random() < 0.6 else generator.uniform(0.25, 0.5)
            for number in range(4):
                angle = turn + number * np.pi / 2
                distance = side * generator.uniform(0.34, 0.7)
                blade = distance - np.float32(np.cos(angle)) * dx - np.float32(np.sin(angle)) * dy
                light *= edge(blade, log_uniform(generator, 0.6, 5.0), leak)
    return np.maximum(light, 0.0).astype(np.float32), shape


def edge(inside_px: Image, soft_px: float, leak: float) -> Image:
    """The light, from `leak` to 1, at a signed distance (h, w) px inside an aperture's edge."""
    share = np.clip(inside_px / np.float32(2 * soft_px) + np.float32(0.5), 0, 1)
    return np.asarray(leak + (1 - leak) * share * share * (3 - 2 * share), np.float32)


def visible(light: Image) -> NDArray[np.bool_]:
    """Where a wire can be seen at all: inside the field."""
    return np.asarray(light > _VISIBLE)


def exposed(attenuation: Image, light: Image, generator: Generator, settings: FluoroscopySettings) -> NDArray[np.uint8]:
    """Grey values (h, w) uint8 of what the detector receives behind an attenuation (h, w)."""
    limited = np.minimum(attenuation, _MOST)
    received: NDArray[np.floating] = np.exp(-limited) * light
    bright = float(np.percentile(received[::8, ::8], 99)) or 1.0
    draw = generator.random(6)
    focus = generator.uniform(0.0, settings.blur_px)
    if focus > 0.25:
        received = np.asarray(cv2.GaussianBlur(received, (0, 0), focus, borderType=cv2.BORDER_REPLICATE), np.float32)
    received *= np.float32(1 / max(bright, 0.02))
    gamma = generator.uniform(0.65, 1.5) if draw[0] < 0.6 else 1.0
    gain, black = generator.uniform(0.2, 1.0) * 255, generator.uniform(0, 0.15) * (draw[1] < 0.4)
    grain = log_uniform(generator, 0.3, max(settings.noise, 0.31)) / 255 * (0.35 + 0.65 * gain / 255)
    # standard deviation: of quanta with the root of the light, of the electronics everywhere
    quanta = generator.uniform(0.4, 1.0)
    sigma = np.sqrt(np.maximum(received, 0)) * np.float32(quanta * grain) + np.float32((1 - quanta) * grain)
    noise: NDArray[np.floating] = generator.standard_normal(received.shape, np.float32)
    if draw[2] < 0.5:
        correlated = generator.uniform(0.35, 0.9)
        noise = np.asarray(cv2.GaussianBlur(noise, (0, 0), correlated), np.float32)
        noise *= np.float32(2 * np.sqrt(np.pi) * max(correlated, 0.45))  # as strong as before
    image = received if gamma == 1.0 else cv2.pow(np.maximum(received, 0), gamma)
    image = gain * (black + (1 - black) * image) + 255 * sigma * noise
    if draw[3] < 0.25:  # edges are enhanced by many consoles
        smooth = cv2.GaussianBlur(image, (0, 0), generator.uniform(0.8, 3.0))
        image += np.float32(generator.uniform(0.2, 1.2)) * (image - smooth)
    grey = np.clip(image + np.float32(0.5), 0, 255).astype(np.uint8)
    if draw[4] < 0.06:
        tiles = max(2, grey.shape[0] // 128)
        grey = cv2.createCLAHE(generator.uniform(1.0, 3.0), (tiles, tiles)).apply(grey)
    if draw[5] < settings.jpeg:
        quality = int(generator.integers(35, 95))
        _, code = cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_QUALITY, quality])
        grey = cv2.imdecode(code, cv2.IMREAD_GRAYSCALE)
    return np.asarray(grey, np.uint8)


def background_grid(generator: Generator, background: NDArray[np.floating], canvas: Canvas, side_px: int) -> Image:
    """A window of a given attenuation (h, w), turned, scaled and moved at random so that it fills the whole image."""
    height, width = background.shape
    turn = generator.normal(0, 0.3) + np.pi / 2 * int(generator.integers(4)) * (generator.random() < 0.3)
    scale = side_px / min(height, width) * generator.uniform(1.0, 1.8)
    flip = generator.choice((-1.0, 1.0))
    matrix = scale * np.array([[flip * np.cos(turn), -np.sin(turn)], [flip * np.sin(turn), np.cos(turn)]])
    centre: Points = np.array([side_px, side_px]) / 2 + generator.normal(0, 0.06 * side_px, 2)
    shift = centre - matrix @ (np.array([width, height]) / 2) - (canvas.left, canvas.top)
    values = generator.uniform(0.5, 1.3) * np.asarray(background, np.float32)
    return np.asarray(
        cv2.warpAffine(
            values, np.column_stack((matrix, shift)), (canvas.width, canvas.height), flags=cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REFLECT_101,
        )
    )  # fmt: skip
