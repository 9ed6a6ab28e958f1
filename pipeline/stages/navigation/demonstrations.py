"""Lessons of navigation: logged episodes seen anew, and episodes that a teacher or the navigator itself steers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.episodes import EpisodeReader
from pipeline.stages.navigation.scene import Rig, Scene, images_of_shape, marks_of, space_of, vessels_of, with_shaft
from pipeline.store.atomic_files import atomic_path

if TYPE_CHECKING:
    from torch import Tensor

    from enn.policy import Policy
    from splineformer.navigation.cloning import Episode
    from splineformer.navigation.navigator import Navigator, NavigatorSettings
    from splineformer.navigation.perception import Reader

SIDE_BY_SIDE = 12  # episodes played together, so that images are read in batches


def episode_of_log(log: Path, rig: Rig, reader: Reader, settings: NavigatorSettings) -> Episode:
    """An expert's logged episode as the navigator would have seen it, an image a decision.

    Args:
        log: of an episode that a feeder steered.
        rig: of the images, which are drawn from the logged shapes of the wire.
        reader: reads them.
        settings: of the navigator.

    Raises:
        EpisodeReadError: the log is damaged or unfinished.
    """
    from cathsim import load_phantom
    from splineformer.navigation.cloning import Episode
    from splineformer.navigation.navigator import Sight

    with EpisodeReader(log) as told:
        info, outcome = told.info, told.outcome
        arrays = told.load_arrays(pictures=False)
    phantom = load_phantom(info.phantom)
    hold = settings.action_repeat
    steps = range(0, len(arrays["action"]) - 1, hold)
    direction = phantom.entry(info.entry).direction
    images = [
        images_of_shape(phantom, rig, with_shaft(arrays["wire_points"][step], direction), (info.seed, step))
        for step in steps
    ]
    flat = reader([image for several in images for image in several])
    count = len(rig.cameras)
    place = phantom, info.target, rig
    sight = Sight(settings, marks_of(*place), vessels_of(*place), space_of(*place) if settings.space else None)
    looks, actions = [], []
    for number, step in enumerate(steps):
        looks.append(sight.look(flat[number * count : (number + 1) * count]))
        # what the expert did while a decision of the navigator would have been held
        done = arrays["action"][step + 1 : step + 1 + hold]
        actions.append(done.mean(axis=0).astype(np.float32))
        sight.decided(actions[-1])
    nothing = np.zeros((len(looks), 0), np.float32)
    return Episode(np.stack(looks), np.stack(actions), nothing, bool(outcome.success), info.target)


def play(
    scenes: Iterable[tuple[Scene, int]],
    teacher: Policy,
    navigator: Navigator,
    *,
    teacher_share: float,
    noise: float,
    generator: np.random.Generator,
    hint_key: str | None = None,
    tick: Callable[[int], None] = lambda finished: None,
) -> list[Episode]:
    """Plays episodes side by side while the teacher says at each decision what it would do.

    Args:
        scenes: a scene and the seed of its reset for each episode, made when its turn comes; its environment observes
            what the teacher sees, and is closed afterwards.
        teacher: a policy on other observations; its advice is held as long as the navigator's own actions.
        navigator: steers the episodes that the teacher does not.
        teacher_share: share of the episodes that the teacher steers.
        noise: standard deviation of what is added to the actions that are carried out, never to those learnt.
        generator: of who steers and of the noise.
        hint_key: observation of the teacher that the navigator learns to tell; None: none.
        tick: called with the number of finished episodes after every decision.

    Returns:
        The episodes, in the order in which they ended.
    """
    waiting = iter(scenes)
    episodes: list[Episode] = []

    def following(count: int) -> Iterator[_Pupil]:
        for _, (scene, seed) in zip(range(count), waiting, strict=False):
            yield _Pupil(scene, seed, navigator, generator.random() < teacher_share, hint_key)

    running = list(following(SIDE_BY_SIDE))
    while running:
        advice = teacher.act_batch({key: np.stack([one.observation[key] for one in running]) for key in teacher.keys})
        looks = _looks(running, navigator)
        own, recalled = navigator.act(looks, _joined([one.recalled for one in running], navigator))
        still = []
        for index, one in enumerate(running):
            one.recalled = recalled[:, index : index + 1].clone()
            action = advice[index] if one.by_teacher else own[index]
            if noise:
                action = np.clip(action + generator.normal(0.0, noise, action.shape), -1.0, 1.0).astype(np.float32)
            if one.carries_out(action, looks[index], advice[index]):
                still.append(one)
            else:
                episodes.append(one.episode())
                still += following(1)
        running = still
        tick(len(episodes))
    return episodes


def _looks(pupils: Sequence[_Pupil], navigator: Navigator) -> np.ndarray:
    several = [one.scene.images() for one in pupils]
    readings = navigator.reader([image for images in several for image in images])
    count = len(several[0])
    return np.stack([one.sight.look(readings[n * count : (n + 1) * count]) for n, one in enumerate(pupils)])


def _joined(recalled: Sequence[Tensor | None], navigator: Navigator) -> Tensor:
    import torch

    empty = torch.zeros(1, 1, navigator.settings.hidden, device=navigator.device)
    return torch.cat([empty if one is None else one for one in recalled], 1)


class _Pupil:
    """An episode in the making."""

    def __init__(self, scene: Scene, seed: int, navigator: Navigator, by_teacher: bool, hint_key: str | None) -> None:
        self.scene, self.by_teacher, self._hint_key = scene, by_teacher, hint_key
        self._hold = navigator.settings.action_repeat
        self.observation, _ = scene.environment.reset(seed=seed)
        space = scene.space if navigator.settings.space else None
        self.sight = navigator.begin(scene.marks, scene.vessels, space)
        self.recalled: Tensor | None = None
        self._rows: list[tuple[Any, Any, Any]] = []
        self._success = False

    def carries_out(self, action: np.ndarray, look: np.ndarray, advice: np.ndarray) -> bool:
        """Holds an action; whether the episode goes on."""
        hint = np.zeros(0) if self._hint_key is None else self.observation[self._hint_key]
        self._rows.append((look, advice.copy(), np.asarray(hint, np.float32)))
        self.sight.decided(action)
        for _ in range(self._hold):
            self.observation, _, terminated, truncated, info = self.scene.environment.step(action)
            if terminated or truncated:
                self._success = bool(info["success"])
                self.scene.environment.close()
                return False
        return True

    def episode(self) -> Episode:
        """What was seen and advised."""
        from splineformer.navigation.cloning import Episode

        looks, actions, hints = (np.stack(part) for part in zip(*self._rows, strict=True))
        return Episode(looks, actions, hints, self._success, self.scene.target)


def write_episodes(path: Path, episodes: Sequence[Episode]) -> None:
    """Writes episodes into one file, whole or not at all."""
    arrays = {
        "lengths": np.array([len(episode.looks) for episode in episodes]),
        "success": np.array([episode.success for episode in episodes]),
        "target": np.array([episode.target for episode in episodes]),
        **{name: np.concatenate([getattr(one, name) for one in episodes]) for name in ("looks", "actions", "hints")},
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        np.savez(stream, **arrays)  # type: ignore[arg-type]


def read_lessons(path: Path) -> list[Episode]:
    """Reads what `write_episodes` wrote."""
    from splineformer.navigation.cloning import Episode

    with np.load(path) as arrays:
        cuts = np.cumsum(arrays["lengths"])[:-1]
        parts = (np.split(arrays[name], cuts) for name in ("looks", "actions", "hints"))
        return [
            Episode(*one) for one in zip(*parts, arrays["success"].tolist(), arrays["target"].tolist(), strict=True)
        ]
