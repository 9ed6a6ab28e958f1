"""Path following: a network that predicts the next action from where the tip has been and a planned path ahead of it.

The thesis's attempt, in which an MLP predicts the next action from a sequence of observations along the A* path.

Source: thesis, chapter CathSim, section RL for Autonomous Cannulation.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
from annotated_types import Interval
from numpy.typing import ArrayLike, NDArray
from torch import Tensor, nn

from enn.bounded_content import built_from
from enn.fitting import EpisodeFitProgress, EpisodeFitSettings, FitReport, fit
from enn.model_file import UNFIT, another_architecture, read_model, write_model
from enn.networks.devices import device_of, seeded
from enn.setting_kinds import Count, Units, settings
from enn.trajectory import Trajectory, episode_numbers

FORMAT = "enn-path-follower-1"
_PER_METRE = 50.0  # brings offsets of centimetres to about one
_PATH_STEP = 1e-3  # m between the points that the nearest one is sought among
_BACKWARDS = 0.005  # m that the nearest point may go back along the path in a step


@settings
class PathFollowerSettings:
    """What is seen of tip and path, and how it is learnt from."""

    history: Count = 5  # tip positions, the present one included
    waypoints: Count = 5  # points of the path ahead of the tip
    spacing: Annotated[float, Interval(gt=0, le=1)] = 0.008  # between them, m
    hidden: tuple[Units, ...] = (128, 128)
    fit: EpisodeFitSettings = field(
        default_factory=lambda: EpisodeFitSettings(epochs=60, batch_size=64, learning_rate=1e-3, weight_decay=1e-3)
    )

    @property
    def size(self) -> int:
        """Numbers that the network sees."""
        return 3 * (self.history - 1) + 3 + 3 * self.waypoints + 1


class PlannedPath:
    """A path that progress is measured along.

    Args:
        points: (n, 3) m, from the entry to the target, n >= 2.

    Raises:
        ValueError: another shape, a point that is not finite, or no length.
    """

    def __init__(self, points: ArrayLike) -> None:
        vertices = np.asarray(points, np.float64)
        if vertices.ndim != 2 or vertices.shape[1] != 3 or len(vertices) < 2 or not np.isfinite(vertices).all():
            raise ValueError(f"a path needs finite points of shape (n, 3) with n >= 2, got shape {vertices.shape}")
        arc = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(vertices, axis=0), axis=1))))
        self.length = float(arc[-1])
        if not self.length > 0:
            raise ValueError("a path needs a length above nought: its points are all the same")
        self.arc = np.linspace(0.0, self.length, max(2, round(self.length / _PATH_STEP) + 1))
        self.points = np.column_stack([np.interp(self.arc, arc, vertices[:, axis]) for axis in range(3)])

    def at(self, arc: NDArray[Any]) -> NDArray[np.float64]:
        """Points at lengths along the path, the end beyond it. Shape (k, 3), m."""
        return np.column_stack([np.interp(arc, self.arc, self.points[:, axis]) for axis in range(3)])

    def progress(self, tip: NDArray[np.float64], before: float) -> float:
        """Length along the path of the point nearest to the tip, not far behind where it was before, m."""
        distances = np.linalg.norm(self.points - tip, axis=1)
        distances[self.arc < before - _BACKWARDS] = np.inf
        return float(self.arc[int(np.argmin(distances))])


def describe(
    tips: Sequence[NDArray[np.float64]], path: PlannedPath, progress: float, settings: PathFollowerSettings
) -> NDArray[np.float32]:
    """What the network sees of a moment: everything relative to the tip.

    Args:
        tips: (3,) m each, positions up to now, the present one last.
        progress: along it, m.

    Returns:
        Former tip positions, nearest point, points ahead, all from the tip, and the length left. Shape (size,).
    """
    tip = tips[-1]
    former = [tips[max(len(tips) - 1 - back, 0)] for back in range(1, settings.history)]
    ahead = path.at(progress + settings.spacing * np.arange(settings.waypoints + 1))
    offsets = np.concatenate((np.array(former).reshape(-1, 3), ahead)) - tip
    return np.append(_PER_METRE * offsets.ravel(), 10.0 * (path.length - progress)).astype(np.float32)


class PathFollower:
    """A fitted network that follows paths.

    Args:
        network: (N, size) to (N, actions).
    """

    def __init__(self, network: nn.Sequential, settings: PathFollowerSettings) -> None:
        self.network, self.settings = network.eval(), settings

    def controller(self, path: ArrayLike) -> PathController:
        """Follows a path over an episode; call `reset()` at the start of each.

        Args:
            path: (n, 3) m, from the entry to the target.
        """
        return PathController(self, PlannedPath(path))

    def act(self, seen: NDArray[np.float32]) -> NDArray[np.float32]:
        """Actions for what is seen, (N, size). Within -1 and 1, shape (N, actions)."""
        with torch.inference_mode():
            rows = torch.as_tensor(seen).to(device_of(self.network))
            actions: NDArray[np.float32] = self.network(rows).cpu().numpy()
        return np.clip(actions, -1.0, 1.0)

    def save(self, path: Path | str) -> None:
        """Writes settings and weights into one file, atomically."""
        content = {
            "format": FORMAT,
            "settings": asdict(self.settings),
            "actions": self.network[-1].out_features,
            "weights": self.network.state_dict(),
        }
        write_model(Path(path), content)

    @classmethod
    def load(cls, path: Path | str, device: torch.device | str = "cpu") -> PathFollower:
        """Reads a path follower onto a device.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: it is damaged, no path follower, or its weights do not fit its settings.
        """
        path = Path(path)
        content = read_model(path, FORMAT, kind="path follower", verb="fit")
        try:
            settings = PathFollowerSettings(**content["settings"])
            with built_from(content):
                network = build(settings, content["actions"])
            network.load_state_dict(content["weights"])
        except UNFIT as error:
            raise another_architecture(path, error, verb="fit") from error
        return cls(network.to(device), settings)


class PathController:
    """A path follower over an episode."""

    def __init__(self, follower: PathFollower, path: PlannedPath) -> None:
        self.follower, self.path = follower, path
        self._tips: list[NDArray[np.float64]] = []
        self._progress = 0.0

    def reset(self) -> None:
        """Starts an episode."""
        self._tips, self._progress = [], 0.0

    def __call__(self, observation: Any, info: Mapping[str, Any]) -> NDArray[np.float32]:
        """The action of this step. Shape (actions,).

        Args:
            observation: not looked at.
            info: with `tip`, (3,) m.
        """
        tip = np.asarray(info["tip"], np.float64)
        self._tips = [*self._tips, tip][-self.follower.settings.history :]
        self._progress = self.path.progress(tip, self._progress)
        seen = describe(self._tips, self.path, self._progress, self.follower.settings)
        return self.follower.act(seen[None])[0]


def build(settings: PathFollowerSettings, actions: int) -> nn.Sequential:
    """The network with fresh weights."""
    layers: list[nn.Module] = []
    size = settings.size
    for units in settings.hidden:
        layers += [nn.Linear(size, units), nn.ReLU()]
        size = units
    return nn.Sequential(*layers, nn.Linear(size, actions))


def fit_path_follower(
    trajectories: Sequence[Trajectory],
    paths: Sequence[ArrayLike],
    settings: PathFollowerSettings | None = None,
    *,
    seed: int = 0,
    progress: Callable[[EpisodeFitProgress], None] | None = None,
    device: torch.device | str = "cpu",
) -> tuple[PathFollower, FitReport]:
    """Learns to follow paths from an expert's episodes.

    Args:
        trajectories: of the expert; only tips and actions are used.
        paths: the planned path of each episode, (n, 3) m.

    Returns:
        The follower, and what the fit was like.

    Raises:
        ValueError: no episodes, not a path for each, or episodes with different numbers of actions.
    """
    settings = settings or PathFollowerSettings()
    if not trajectories or len(paths) != len(trajectories):
        raise ValueError(f"expected a path for each of at least one episode, got {len(paths)} for {len(trajectories)}")
    sizes = {trajectory.actions.shape[1] for trajectory in trajectories}
    if len(sizes) > 1:
        raise ValueError(f"the episodes have different numbers of actions ({', '.join(map(str, sorted(sizes)))})")
    rows = []
    for trajectory, points in zip(trajectories, paths, strict=True):
        path, along = PlannedPath(points), 0.0
        tips = list(trajectory.tips.astype(np.float64))
        for step in range(len(trajectory)):
            along = path.progress(tips[step], along)
            rows.append(describe(tips[: step + 1], path, along, settings))
    seen = torch.as_tensor(np.stack(rows))
    expert_actions = torch.as_tensor(
        np.concatenate([trajectory.actions for trajectory in trajectories]).astype(np.float32)
    )
    episodes = episode_numbers(trajectories)
    with seeded(seed, device):
        network = build(settings, expert_actions.shape[1]).to(device)

        def loss(samples: NDArray[np.int64], training: bool, generator: np.random.Generator) -> Tensor:
            index = torch.as_tensor(samples)
            return nn.functional.mse_loss(network(seen[index].to(device)), expert_actions[index].to(device))

        report = fit(network, loss, episodes, settings.fit, seed=seed, progress=progress)
    return PathFollower(network, settings), report
