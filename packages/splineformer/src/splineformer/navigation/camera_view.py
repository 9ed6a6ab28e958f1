"""View of a navigator: one camera's reading as numbers measured from the wire's tip, with what it was before.

Lengths are shares of the image's side, directions those of the tip's frame: x along the wire and out of its tip, y
across it. The tokens and the encoder's output come along as they are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from guide3d.setting_kinds import Units, settings
from splineformer.navigation.perception import WireReading
from splineformer.navigation.vessel_map import VesselMap

Array = NDArray[np.float64]

WIRE_ARCS = np.array([0.01, 0.02, 0.03, 0.045, 0.065, 0.09, 0.14, 0.2, 0.3])  # behind the tip
WAY_ARCS = np.array([0.015, 0.03, 0.05, 0.08, 0.12, 0.18, 0.25])  # ahead
RAYS, RAY_REACH, RAY_SAMPLES = 8, 0.12, 16
HEADING_ARC = 0.02  # the tip's direction is that of this much of the wire
AGO = (1, 2)  # decisions: readings that are compared with the present one
_LENGTH, _MOTION = 0.1, 0.02  # what counts as 1
_LIMIT = 5.0
_SHORTEST = 1e-4

_WIRE = 2 * len(WIRE_ARCS) + 6
_CHANGE = 5
_MARK = 5
_WAY = 2 * len(WAY_ARCS) + 2 + 2 * RAYS


@settings
class ViewSettings:
    """What a view holds.

    Attributes:
        encoded: numbers of the encoder's output in a reading.
        guided: whether a contrast run's map is at hand, or the target's mark alone.
    """

    tokens: Units = 20
    encoded: Units = 192
    guided: bool = True

    @property
    def geometry(self) -> int:
        """Numbers beside the encoder's output."""
        return 3 * self.tokens + _WIRE + _CHANGE * len(AGO) + _MARK + (_WAY if self.guided else 0)

    @property
    def size(self) -> int:
        """Numbers in all; the encoder's output comes last."""
        return self.geometry + self.encoded


@dataclass(frozen=True, eq=False)
class _Pose:
    tip: Array
    heading: Array
    length: float


class CameraView:
    """What one camera shows over an episode.

    Args:
        target: (2,) the mark, x and y as shares of the image's side.
        vessels: of the contrast run; needed where the view is guided.

    Raises:
        ValueError: a guided view without a map.
    """

    def __init__(self, settings: ViewSettings, target: ArrayLike, vessels: VesselMap | None = None) -> None:
        if settings.guided and vessels is None:
            raise ValueError("this navigator is guided by a contrast run: give the map of its vessels")
        self.settings, self.target, self.vessels = settings, np.asarray(target, float), vessels
        self._poses: list[_Pose] = []

    def look(self, reading: WireReading) -> NDArray[np.float32]:
        """What a reading shows; to be called once a decision.

        Returns:
            Tokens (3 a token); the wire behind the tip over its distances, confidence, length, and the tip's place and
            direction (24); for one and two decisions ago, the tip's motion since, its turn, and the change of length
            (10); the mark over its distance, its distance and place (5); if guided, the way ahead over its distances,
            the way's length twice, and what eight rays see of the lumen (32); the encoder's
            output. Shape (settings.size,).

        Raises:
            ValueError: a reading of another network.
        """
        s = self.settings
        if len(reading.tokens) != s.tokens or len(reading.encoded) != s.encoded:
            raise ValueError(
                f"the navigator takes {s.tokens} tokens and {s.encoded} encoder outputs, the reading has "
                f"{len(reading.tokens)} and {len(reading.encoded)}: give the network that it was trained with"
            )
        points = np.asarray(reading.points, float)
        arc = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))))
        tip = points[0]
        heading = tip - _at(points, arc, np.array([HEADING_ARC]))[0]
        heading = heading / max(float(np.hypot(*heading)), _SHORTEST)
        axes = np.array([heading, (-heading[1], heading[0])]).T  # columns: along the wire, across it
        pose = _Pose(tip, heading, float(arc[-1]))
        self._poses = [*(self._poses or [pose] * max(AGO)), pose][-max(AGO) - 1 :]
        wire = (_at(points, arc, WIRE_ARCS) - tip) @ axes / WIRE_ARCS[:, None]
        goal = (self.target - tip) @ axes
        away = float(np.hypot(*goal))
        parts = [
            (reading.tokens - 0.5).ravel(),
            wire.ravel(),
            (reading.confidence, arc[-1]),
            2 * tip - 1,
            heading,
            *(_change(self._poses[-1 - ago], pose, axes) for ago in AGO),
            goal / max(away, 1e-3),
            (np.tanh(away / _LENGTH),),
            2 * self.target - 1,
        ]
        if s.guided:
            parts.append(self._way(tip, axes))
        parts.append(reading.encoded)
        return np.concatenate([np.ravel(part) for part in parts]).astype(np.float32)

    def _way(self, tip: Array, axes: Array) -> Array:
        assert self.vessels is not None
        inside = np.clip(tip, 0.0, 1.0 - 1e-6)
        way = self.vessels.way(inside)
        along = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(way, axis=0).T))))
        ahead = (_at(way, along, WAY_ARCS) - tip) @ axes / WAY_ARCS[:, None]
        remaining = self.vessels.remaining(inside)
        angle = np.arange(RAYS) * 2 * np.pi / RAYS
        directions = np.stack((np.cos(angle), np.sin(angle)), axis=1) @ axes.T
        reach = np.arange(1, RAY_SAMPLES + 1) * RAY_REACH / RAY_SAMPLES
        seen = self.vessels.sample(tip + directions[:, None] * reach[:, None])
        open_ = np.minimum.accumulate(seen > 0.5, axis=1).mean(axis=1)
        lengths = (remaining / (5 * _LENGTH), np.tanh(remaining / _LENGTH))
        return np.concatenate((ahead.ravel(), lengths, 2 * open_, seen.mean(axis=1)))


def _change(before: _Pose, now: _Pose, axes: Array) -> Array:
    moved = np.clip((now.tip - before.tip) @ axes / _MOTION, -_LIMIT, _LIMIT)
    cosine = float(now.heading @ before.heading)
    sine = float(now.heading[1] * before.heading[0] - now.heading[0] * before.heading[1])
    longer = float(np.clip((now.length - before.length) / _MOTION, -_LIMIT, _LIMIT))
    return np.array([*moved, cosine, sine, longer])


def _at(points: Array, arc: Array, arcs: Array) -> Array:
    return np.stack([np.interp(arcs, arc, points[:, k]) for k in (0, 1)], axis=1)
