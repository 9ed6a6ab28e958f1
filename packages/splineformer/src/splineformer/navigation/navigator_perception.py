"""Navigator's perception: images that a frozen SplineFormer reads, as features of a recurrent policy.

It meets `enn.imitation.recurrent_policy.Perception`, a protocol of arrays; the policy itself is not imported.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from guide3d.setting_kinds import Units, settings
from splineformer.navigation.camera_view import CameraView, ViewSettings
from splineformer.navigation.perception import PerceptionNetwork, WireReading
from splineformer.navigation.space_map import SpaceMap
from splineformer.navigation.space_view import SIZE as SPACE
from splineformer.navigation.space_view import SpaceView
from splineformer.navigation.vessel_map import VesselMap

ACTIONS = 2  # translation and rotation, as shares of the most in a step


@settings
class NavigatorPerceptionSettings:
    """What a navigator sees.

    Attributes:
        tokens: spline tokens of a camera's reading.
        encoded: numbers of the encoder's output in a reading.
        guided: whether it is guided by a contrast run, or by the target's mark alone.
        space: whether it knows its two cameras' geometry and measures wire and vessels in space.
    """

    cameras: tuple[str, ...] = ("a",)
    tokens: Units = 20
    encoded: Units = 192
    guided: bool = True
    space: bool = False

    def __post_init__(self) -> None:
        """Refuses no camera, one named twice, and a space that nothing measures."""
        if not self.cameras or len(set(self.cameras)) < len(self.cameras):
            raise ValueError(f"cameras: expected at least one name, each once, got {list(self.cameras)}")
        if self.space and (len(self.cameras) != 2 or not self.guided):
            raise ValueError("space: measured by two cameras and their contrast runs: set guided, too")

    @property
    def view(self) -> ViewSettings:
        """Of each camera."""
        return ViewSettings(self.tokens, self.encoded, self.guided)

    @property
    def size(self) -> int:
        """Features: every camera's view, both together in space, then the last two actions."""
        return len(self.cameras) * self.view.size + (SPACE if self.space else 0) + 2 * ACTIONS

    @property
    def encoder_blocks(self) -> tuple[tuple[int, int], ...]:
        """First index and length of each camera's encoder output among the features."""
        size = self.view.size
        return tuple((number * size + self.view.geometry, self.encoded) for number in range(len(self.cameras)))


class NavigatorPerception:
    """Images of several episodes to features, read together.

    Raises:
        ValueError: the network gives other numbers of tokens or encoder outputs than the settings say.
    """

    def __init__(self, settings: NavigatorPerceptionSettings, network: PerceptionNetwork) -> None:
        if (network.tokens, network.encoded) != (settings.tokens, settings.encoded):
            raise ValueError(
                f"the navigator takes {settings.tokens} tokens and {settings.encoded} encoder outputs, this "
                f"SplineFormer gives {network.tokens} and {network.encoded}: take the one that it was trained with"
            )
        self.settings, self.network = settings, network

    def __call__(
        self, views: Sequence[EpisodeView], observations: Sequence[Any], actions: Sequence[ArrayLike]
    ) -> NDArray[np.float32]:
        """Features of N episodes' moment; called once a decision.

        Args:
            observations: not looked at.
            actions: (2,) each, carried out since the last decision; zeros at first.

        Returns:
            (N, settings.size).
        """
        images = [view.images() for view in views]
        readings = self.network([image for several in images for image in several])
        count = len(self.settings.cameras)
        return np.stack(
            [
                view.look(readings[number * count : (number + 1) * count], action)
                for number, (view, action) in enumerate(zip(views, actions, strict=True))
            ]
        )


class EpisodeView:
    """What the navigator has seen of an episode.

    Args:
        images: gives the moment's (h, w) image of each of `settings.cameras`; asked once a decision.
        marks: camera to (2,) the target's mark, x and y as shares of the image's side.
        vessels: camera to its map, where the navigator is guided.
        space: the map in space, where it knows its cameras.

    Raises:
        ValueError: a camera without a mark, or without a map that is needed.
    """

    def __init__(
        self,
        settings: NavigatorPerceptionSettings,
        images: Callable[[], Sequence[ArrayLike]],
        marks: Mapping[str, ArrayLike],
        vessels: Mapping[str, VesselMap] | None = None,
        space: SpaceMap | None = None,
    ) -> None:
        missing = [name for name in settings.cameras if name not in marks]
        if missing:
            raise ValueError(f"the navigator looks through camera {', '.join(missing)}: give the target's mark there")
        if settings.space and space is None:
            raise ValueError("this navigator measures vessels in space: give the map that both contrast runs make")
        self.images = images
        maps = vessels or {}
        self._space = SpaceView(space) if settings.space and space is not None else None
        self._views = [CameraView(settings.view, marks[name], maps.get(name)) for name in settings.cameras]
        self._before: NDArray[np.float64] = np.zeros(ACTIONS)

    def look(self, readings: Sequence[WireReading], action: ArrayLike) -> NDArray[np.float32]:
        """The (size,) features of a decision, from each camera's reading and the action carried out since the last."""
        views = [view.look(reading) for view, reading in zip(self._views, readings, strict=True)]
        together = [] if self._space is None else [self._space.look(readings)]
        last = np.asarray(action, float)
        features = np.concatenate([*views, *together, last, self._before]).astype(np.float32)
        self._before = last
        return features
