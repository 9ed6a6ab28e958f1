"""Wire walker: from where the wire enters the image it is followed to its tip, step by step, by glimpses and a GRU.

At every step the walker sees the image about its place, turned into its heading, finely and coarsely, and knows where
in space it is and heads to. A GRU remembers the way; two heads tell the next step of fixed length (spherical offsets of
the heading, or its Cartesian twin: the step itself) and whether the tip is reached. What is learnt is local, so few
acquisitions hold many lessons.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

FORMS = ("spherical", "cartesian")
_SMALL = 1e-6
_TURN = 0.3  # rad an output of 1 means
_FAINT = 0.03  # contrast of a glimpse that is hardly more than noise
_RARELY = -4.0  # logit of having arrived, at first
_WAVES = (1.0, 2.0, 4.0, 8.0, 16.0)  # of the place's embedding


@dataclass(frozen=True)
class WalkerSize:
    """Sizes of the walker.

    Attributes:
        image_px: side of the picture.
        ahead_px: reach of a fine glimpse along the heading, px of the picture: behind and ahead.
        aside_px: its reach to either side.
        coarser: spacing of the coarse glimpse's samples, of which there are as many.
        width: of what a glimpse becomes.
        state: of the GRU.
    """

    image_px: int = 256
    ahead_px: tuple[int, int] = (6, 16)
    aside_px: int = 10
    coarser: int = 4
    width: int = 128
    state: int = 128


@dataclass
class Walked:
    """Walks in the camera's frame.

    Attributes:
        places_mm: (n, k + 1, 3), the start first.
        headings: (n, k, 3) unit, before each step.
        seen: (n, k, inputs) what the walker saw before each step.
        steps_mm: (n, k, 3).
        stop: (n, k, 2) logit of having arrived, before each step, and what is left to the tip along the heading, in
            steps.
    """

    places_mm: Tensor
    headings: Tensor
    seen: Tensor
    steps_mm: Tensor
    stop: Tensor


class WireWalker(nn.Module):
    """Pictures to curves."""

    samples: Tensor
    intrinsics: Tensor
    rotation: Tensor
    translation_mm: Tensor
    start_mm: Tensor
    start_heading: Tensor
    pixel_scale: Tensor
    place_mean: Tensor
    place_scale: Tensor
    step_mean: Tensor
    step_scale: Tensor

    def __init__(self, size: WalkerSize, form: str, *, positions: int, step_mm: float, source_px: int) -> None:
        """Args:
        size: of its parts.
        form: "spherical" or "cartesian".
        positions: M, points of the longest curve.
        step_mm: length of a step.
        source_px: side of the camera's image, which its matrix belongs to.
        """
        super().__init__()
        if form not in FORMS:
            raise ValueError(f"unknown form '{form}'; there are {', '.join(FORMS)}")
        self.size, self.form, self.positions, self.step_mm, self.source_px = size, form, positions, step_mm, source_px
        self.frames = 1
        behind, ahead = size.ahead_px
        along = torch.arange(-behind, ahead + 1.0)
        aside = torch.arange(-size.aside_px, size.aside_px + 1.0)
        samples = torch.cartesian_prod(along, aside)
        self.register_buffer("samples", samples, persistent=False)
        count = len(samples)
        self.known = 7 + 6 * len(_WAVES)
        self.inputs = 2 * count + 2 + self.known
        # apart, or the many samples of the glimpses drown the few numbers that say where the walker is
        self.glimpse_encoder = nn.Sequential(nn.Linear(self.inputs - self.known, size.width), nn.GELU())
        self.place_encoder = nn.Sequential(nn.Linear(self.known, size.width), nn.GELU())
        self.joint_encoder = nn.Sequential(nn.Linear(2 * size.width, size.width), nn.GELU())
        self.recurrent = nn.GRU(size.width, size.state, batch_first=True)
        joined = size.width + size.state
        columns = 2 if form == "spherical" else 3
        self.step_head = nn.Sequential(nn.Linear(joined, size.width), nn.GELU(), nn.Linear(size.width, columns))
        self.stop_head = nn.Sequential(
            nn.Linear(joined + 2 * count + 2, size.width // 2), nn.GELU(), nn.Linear(size.width // 2, 2)
        )
        for head in (self.step_head, self.stop_head):
            for weight in head[-1].parameters():
                nn.init.zeros_(weight)
        # few places are the tip
        with torch.no_grad():
            self.stop_head[-1].bias.copy_(torch.tensor([_RARELY, 0.0]))  # type: ignore[operator]
        for name, value in (
            ("intrinsics", torch.eye(3)), ("rotation", torch.eye(3)), ("translation_mm", torch.zeros(3)),
            ("start_mm", torch.zeros(3)), ("start_heading", torch.tensor([1.0, 0.0, 0.0])),
            ("pixel_scale", torch.ones(())), ("place_mean", torch.zeros(3)), ("place_scale", torch.ones(3)),
            ("step_mean", torch.zeros(3)), ("step_scale", torch.ones(3)),
        ):  # fmt: skip
            self.register_buffer(name, value)

    def forward(self, seen: Tensor, headings: Tensor) -> tuple[Tensor, Tensor]:
        """Tells the next step at each place of walks that are known.

        Args:
            seen: (n, k, inputs) as `look` gives it.
            headings: (n, k, 3) unit, the camera's frame.

        Returns:
            (n, k, 3) steps in mm, the camera's frame, and (n, k, 2) as `Walked.stop`.
        """
        encoded = self._encoded(seen)
        states, _ = self.recurrent(encoded)
        return self._heads(seen, encoded, states, headings)

    def _encoded(self, seen: Tensor) -> Tensor:
        glimpses, known = seen.split((self.inputs - self.known, self.known), dim=-1)
        joined = torch.cat((self.glimpse_encoder(glimpses), self.place_encoder(known)), dim=-1)
        result: Tensor = self.joint_encoder(joined)
        return result

    def _heads(self, seen: Tensor, encoded: Tensor, states: Tensor, headings: Tensor) -> tuple[Tensor, Tensor]:
        joined = torch.cat((encoded, states), dim=-1)
        told = self.step_head(joined).float()
        # The stop looks at the glimpses itself: what it learns first would spoil what steps are learnt from.
        glimpses = seen[..., : self.inputs - self.known]
        stop = self.stop_head(torch.cat((joined.detach(), glimpses), dim=-1)).float()
        if self.form == "cartesian":
            return self.step_mean + self.step_scale * told, stop
        # The frame moves with the heading: a wire that turns through the line of sight meets no pole.
        aside = torch.stack((-headings[..., 1], headings[..., 0], torch.zeros_like(headings[..., 0])), dim=-1)
        aside = aside / aside.norm(dim=-1, keepdim=True).clamp(min=_SMALL)
        above = torch.cross(headings, aside, dim=-1)
        azimuth, polar = _TURN * told[..., :1], _TURN * told[..., 1:]
        level = azimuth.cos() * headings + azimuth.sin() * aside
        return self.step_mm * (polar.cos() * level + polar.sin() * above), stop

    @torch.no_grad()
    def levels(self, pictures: Tensor) -> tuple[Tensor, Tensor]:
        """(n, h, w) grey values of 0 to 255 to the fine and the coarse picture that `look` takes."""
        fine = torch.log1p(pictures[:, None] / self.pixel_scale)
        return fine, functional.max_pool2d(fine, self.size.coarser)

    @torch.no_grad()
    def look(self, levels: tuple[Tensor, Tensor], places_mm: Tensor, headings: Tensor) -> Tensor:
        """What the walker sees and knows at places.

        Args:
            levels: of n pictures.
            places_mm: (n, k, 3) the camera's frame.
            headings: (n, k, 3) unit.

        Returns:
            (n, k, inputs).
        """
        depth = places_mm[..., 2:].clamp(min=1.0)
        seen_at = places_mm @ self.intrinsics.T / depth
        pixels = seen_at[..., :2]
        # where the heading points in the image
        moved = (headings @ self.intrinsics.T)[..., :2] - pixels * headings[..., 2:]
        along = moved / moved.norm(dim=-1, keepdim=True).clamp(min=_SMALL)
        aside = torch.stack((-along[..., 1], along[..., 0]), dim=-1)
        ahead, side = self.samples[:, 0], self.samples[:, 1]
        around = ahead[:, None] * along[..., None, :] + side[:, None] * aside[..., None, :]
        middle = (2.0 * (pixels + 0.5) / self.source_px - 1.0)[..., None, :]
        scale = 2.0 / self.size.image_px
        glimpses = [
            functional.grid_sample(picture, middle + reach * scale * around, align_corners=False)[:, 0]
            for picture, reach in zip(levels, (1.0, float(self.size.coarser)), strict=True)
        ]
        # each glimpse at the same contrast: a faint wire leads as well as a dark one
        contrasts = [glimpse.square().mean(dim=-1, keepdim=True).sqrt() for glimpse in glimpses]
        glimpses = [glimpse / (by + _FAINT) for glimpse, by in zip(glimpses, contrasts, strict=True)]
        place = (places_mm - self.place_mean) / self.place_scale
        waves = torch.cat([f(wave * place) for wave in _WAVES for f in (torch.sin, torch.cos)], dim=-1)
        return torch.cat((*glimpses, *contrasts, place, waves, headings, depth / 1000.0), dim=-1)

    @torch.no_grad()
    def walk(self, pictures: Tensor, steps: int) -> Walked:
        """Walks from the start.

        Args:
            pictures: (n, image_px, image_px) grey values of 0 to 255.
            steps: that are made, also beyond the tip.
        """
        count, levels = len(pictures), self.levels(pictures)
        place, heading = self.start_mm.expand(count, 3), self.start_heading.expand(count, 3)
        hidden: Tensor | None = None
        rows: list[tuple[Tensor, ...]] = []
        for _ in range(steps):
            seen = self.look(levels, place[:, None], heading[:, None])
            encoded = self._encoded(seen)
            states, hidden = self.recurrent(encoded, hidden)
            step, stop = self._heads(seen, encoded, states, heading[:, None])
            rows.append((place, heading, seen[:, 0], step[:, 0], stop[:, 0]))
            place = place + step[:, 0]
            heading = step[:, 0] / step[:, 0].norm(dim=-1, keepdim=True).clamp(min=_SMALL)
        places, headings, looks, made, stops = (torch.stack(part, dim=1) for part in zip(*rows, strict=True))
        return Walked(torch.cat((places, place[:, None]), dim=1), headings, looks, made, stops)

    @torch.no_grad()
    def curves(self, windows: Tensor) -> list[Tensor]:
        """Predicts the wires of windows of pictures.

        Args:
            windows: (n, 1, image_px, image_px) grey values of 0 to 255.

        Returns:
            A curve a window, (m, 3) mm, world, tip first.
        """
        found = self.found(windows[:, -1])
        return [(curve - self.translation_mm) @ self.rotation for curve in found]

    @torch.no_grad()
    def found(self, pictures: Tensor) -> list[Tensor]:
        """Predicts wires in the camera's frame.

        Args:
            pictures: (n, image_px, image_px) grey values of 0 to 255.

        Returns:
            A curve a picture, (m, 3) mm, tip first.
        """
        walked = self.walk(pictures, self.positions)
        logits = walked.stop[..., 0]
        # the median of where it stops: the chance of going on is that of having stopped at no place so far
        going = functional.logsigmoid(-logits).cumsum(dim=1).exp()
        going[:, -1] = 0.0
        ends = (going < 0.5).int().argmax(dim=1)
        found = []
        for places, headings, stop, end in zip(walked.places_mm, walked.headings, walked.stop, ends, strict=True):
            last = max(int(end), 1)
            left = self.step_mm * stop[last, 1].clamp(-1.0, 1.0)
            tip = places[last] + left * headings[last]
            kept = places[: last + 1] if left > 0 else places[:last]
            found.append(torch.cat((kept, tip[None])).flip(0))
        return found
