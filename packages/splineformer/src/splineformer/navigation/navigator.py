"""Navigator: a small recurrent policy on a frozen SplineFormer's memory and spline tokens, from images to actions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor, nn

from guide3d.learning.model_file import UNFIT, read_model, write_model
from guide3d.setting_kinds import Count, Dropout, Units, UnitsOrNone, settings
from splineformer.navigation.camera_view import CameraView, ViewSettings
from splineformer.navigation.perception import Reader
from splineformer.navigation.space_map import SpaceMap
from splineformer.navigation.space_view import SIZE as SPACE
from splineformer.navigation.space_view import SpaceView
from splineformer.navigation.vessel_map import VesselMap

KIND = "navigator"
ACTIONS = 2  # translation and rotation, as shares of the most in a step
_CLIP = 5.0


@settings
class NavigatorSettings:
    """The policy's network.

    Attributes:
        cameras: names of the cameras that it sees.
        tokens: spline tokens of a camera's reading.
        memory: numbers of the encoder's memory in a reading.
        guided: whether it is guided by a contrast run, or by the target's mark alone.
        space: whether it knows its two cameras' geometry and measures wire and vessels in space.
        hidden: units of the recurrent layer.
        memory_units: that a camera's memory is reduced to.
        dropout: of the memory, in training.
        hints: numbers of the teacher's own observation that the network learns to tell along with the action.
        action_repeat: steps for which an action is held.
    """

    cameras: tuple[str, ...] = ("a",)
    tokens: Units = 20
    memory: Units = 192
    guided: bool = True
    space: bool = False
    hidden: Units = 128
    memory_units: Units = 16
    dropout: Dropout = 0.2
    hints: UnitsOrNone = 0
    action_repeat: Count = 3

    def __post_init__(self) -> None:
        """Refuses what steers nothing."""
        if not self.cameras or len(set(self.cameras)) < len(self.cameras):
            raise ValueError(f"cameras: expected at least one name, each once, got {list(self.cameras)}")
        if self.space and (len(self.cameras) != 2 or not self.guided):
            raise ValueError("space: measured by two cameras and their contrast runs: set guided, too")

    @property
    def view(self) -> ViewSettings:
        """Of each camera."""
        return ViewSettings(self.tokens, self.memory, self.guided)

    @property
    def size(self) -> int:
        """Numbers of a look: every camera's view, both together in space, then the last two actions."""
        return len(self.cameras) * self.view.size + self.beside

    @property
    def beside(self) -> int:
        """Numbers beside the cameras' own views."""
        return (SPACE if self.space else 0) + 2 * ACTIONS


class NavigatorNetwork(nn.Module):
    """Looks of an episode so far to an action: memory reduced, a layer, a gated recurrent unit, a layer."""

    def __init__(self, settings: NavigatorSettings) -> None:
        super().__init__()
        self.settings = s = settings
        self.mean: Tensor
        self.scale: Tensor
        self.register_buffer("mean", torch.zeros(s.size))
        self.register_buffer("scale", torch.zeros(s.size))  # all zero: not yet fitted
        self.reduce = nn.Sequential(nn.Linear(s.memory, s.memory_units), nn.Tanh(), nn.Dropout(s.dropout))
        narrow = len(s.cameras) * (s.view.geometry + s.memory_units) + s.beside
        self.inner = nn.Sequential(nn.Linear(narrow, s.hidden), nn.ReLU())
        self.recall = nn.GRU(s.hidden, s.hidden, batch_first=True)
        self.outer = nn.Sequential(nn.Linear(2 * s.hidden, s.hidden), nn.ReLU())
        self.action, self.hint = nn.Linear(s.hidden, ACTIONS), nn.Linear(s.hidden, max(s.hints, 1))

    def forward(self, looks: Tensor, recalled: Tensor | None = None) -> tuple[Tensor, Tensor, Tensor]:
        """Actions and hints for sequences of looks, and what is remembered after them.

        Args:
            looks: (N, T, size).
            recalled: (1, N, hidden) from before; None: the episodes begin.

        Returns:
            (N, T, 2) in -1 to 1, (N, T, hints), (1, N, hidden).
        """
        s = self.settings
        even = ((looks - self.mean) * self.scale).clamp(-_CLIP, _CLIP)
        parts = []
        for number in range(len(s.cameras)):
            view = even[..., number * s.view.size : (number + 1) * s.view.size]
            parts += [view[..., : s.view.geometry], self.reduce(view[..., s.view.geometry :])]
        seen = self.inner(torch.cat([*parts, even[..., -s.beside :]], -1))
        remembered, recalled = self.recall(seen, recalled)
        thought = self.outer(torch.cat((seen, remembered), -1))
        return torch.tanh(self.action(thought)), self.hint(thought), recalled


class Navigator:
    """A policy and the SplineFormer that it sees with, on whose device it is.

    Args:
        settings: of the network.
        reader: of images.
        seed: of the network's weights.

    Raises:
        ValueError: the reader gives other numbers of tokens or memory than the settings say.
    """

    def __init__(self, settings: NavigatorSettings, reader: Reader, seed: int = 0) -> None:
        if (reader.tokens, reader.memory) != (settings.tokens, settings.memory):
            raise ValueError(
                f"the navigator takes {settings.tokens} tokens and a memory of {settings.memory}, this SplineFormer "
                f"gives {reader.tokens} and {reader.memory}: take the one that the navigator was trained with"
            )
        self.settings, self.reader = settings, reader
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.network = NavigatorNetwork(settings).eval().to(self.device)

    @property
    def device(self) -> torch.device:
        """Where eye and policy compute."""
        return self.reader.predictor.device

    def begin(
        self,
        marks: Mapping[str, ArrayLike],
        vessels: Mapping[str, VesselMap] | None = None,
        space: SpaceMap | None = None,
    ) -> Sight:
        """The sight of an episode.

        Args:
            marks: camera to (2,) the target's mark, x and y as shares of the image's side.
            vessels: camera to its map, where the navigator is guided.
            space: the map in space, where it knows its cameras.

        Raises:
            ValueError: a camera without a mark, or without a map that is needed.
        """
        missing = [name for name in self.settings.cameras if name not in marks]
        if missing:
            raise ValueError(f"the navigator looks through camera {', '.join(missing)}: give the target's mark there")
        return Sight(self.settings, marks, vessels or {}, space)

    @torch.inference_mode()
    def act(self, looks: NDArray[np.float32], recalled: Tensor | None = None) -> tuple[NDArray[np.float32], Tensor]:
        """Actions for one look of N episodes, and what is remembered after it: (N, size) to (N, 2), (1, N, hidden)."""
        actions, _, recalled = self.network(torch.as_tensor(looks)[:, None].to(self.device), recalled)
        return actions[:, 0].cpu().numpy(), recalled

    def controller(
        self,
        images: Callable[[], Sequence[ArrayLike]],
        marks: Mapping[str, ArrayLike],
        vessels: Mapping[str, VesselMap] | None = None,
        space: SpaceMap | None = None,
    ) -> NavigatorController:
        """The navigator over one episode, asking for images only when it decides.

        Args:
            images: gives the moment's image of each of `settings.cameras`.
            marks: as `begin` takes them.
            vessels: likewise.
            space: likewise.
        """
        return NavigatorController(self, images, self.begin(marks, vessels, space))

    def save(self, path: Path | str, **metadata: Any) -> None:
        """Writes the policy, without the SplineFormer, whole or not at all."""
        settings = {**asdict(self.settings), "cameras": list(self.settings.cameras)}
        write_model(path, kind=KIND, network=settings, preprocessing={}, module=self.network, metadata=metadata)

    @classmethod
    def load(cls, path: Path | str, reader: Reader) -> Navigator:
        """Reads a policy.

        Args:
            path: that `save` wrote.
            reader: with the SplineFormer that it was trained with.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: it is damaged, of another version, or of another SplineFormer.
        """
        told = read_model(path, KIND)
        try:
            settings = dict(told["network"])
            navigator = cls(NavigatorSettings(**{**settings, "cameras": tuple(settings["cameras"])}), reader)
            navigator.network.load_state_dict(told["weights"])
        except UNFIT as error:
            reason = " ".join(str(error).split())[:200]
            raise ValueError(f"{path} cannot be used: {reason}") from error
        return navigator


class Sight:
    """What the navigator has seen of an episode.

    Args:
        settings: of the navigator.
        marks: camera to the target's mark.
        vessels: camera to its map.
        space: the map in space.

    Raises:
        ValueError: a map that is needed is not there.
    """

    def __init__(
        self,
        settings: NavigatorSettings,
        marks: Mapping[str, ArrayLike],
        vessels: Mapping[str, VesselMap],
        space: SpaceMap | None = None,
    ) -> None:
        if settings.space and space is None:
            raise ValueError("this navigator measures vessels in space: give the map that both contrast runs make")
        self._space = SpaceView(space) if settings.space and space is not None else None
        self._views = [CameraView(settings.view, marks[name], vessels.get(name)) for name in settings.cameras]
        self._actions = [np.zeros(ACTIONS), np.zeros(ACTIONS)]

    def look(self, readings: Sequence[Any]) -> NDArray[np.float32]:
        """The (size,) numbers that a decision rests on, from each camera's reading; once a decision."""
        views = [view.look(reading) for view, reading in zip(self._views, readings, strict=True)]
        together = [] if self._space is None else [self._space.look(readings)]
        return np.concatenate([*views, *together, *self._actions]).astype(np.float32)

    def decided(self, action: ArrayLike) -> None:
        """Takes note of the action that is carried out."""
        self._actions = [np.asarray(action, float), self._actions[0]]


class NavigatorController:
    """The navigator over an episode, holding each action for its action repeat; see `Navigator.controller`."""

    def __init__(self, navigator: Navigator, images: Callable[[], Sequence[ArrayLike]], sight: Sight) -> None:
        self.navigator, self.sight, self._images = navigator, sight, images
        self._recalled: Tensor | None = None
        self._action = np.zeros(ACTIONS, np.float32)
        self._left = 0

    def __call__(self, observation: Any = None, info: Mapping[str, Any] | None = None) -> NDArray[np.float32]:
        """The (2,) action of this step; neither observation nor info is looked at."""
        if self._left == 0:
            look = self.sight.look(self.navigator.reader(self._images()))
            actions, self._recalled = self.navigator.act(look[None], self._recalled)
            self._action = actions[0]
            self.sight.decided(self._action)
            self._left = self.navigator.settings.action_repeat
        self._left -= 1
        return self._action
