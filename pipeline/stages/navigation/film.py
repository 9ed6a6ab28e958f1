"""Films of navigation: what the cameras show, and beside it what the perception network makes of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cathsim.viewing.film import Film, write_gif
from pipeline.episodes import EpisodeReader
from pipeline.jobs.worker import Report
from pipeline.recording.trials import MODES, Origin
from pipeline.stages.navigation.perception import load_perception
from pipeline.stages.navigation.scene import Scene, phantom_of, scene_of
from pipeline.stages.navigation.settings import NavigationSettings
from pipeline.stages.navigation.trials import EVALUATION, TrialSet, controllers
from pipeline.store.atomic_files import atomic_path

if TYPE_CHECKING:
    from cathsim import NavigateEnv
    from splineformer.navigation.perception import PerceptionNetwork

SUCCESS, FAILURE = "success", "failure"
FILMS = "films"  # job and folder
_STRIDE = 4  # steps from frame to frame
_FRAMES_PER_SECOND = 8.0  # of playback: 3.2 times the episode's speed
_GREYS, _COLOURS = 36, 72  # noise in many greys would make the file ten times as large


@dataclass(frozen=True)
class FilmJob:
    """Films of one success and one failure.

    Attributes:
        rows: of navigators, the one whose success is shown by preference first.
    """

    folder: Path
    settings: NavigationSettings
    rows: tuple[str, ...]
    tests: tuple[TrialSet, ...]
    origin: Origin


class NavigationFilm(Film):
    """Each camera's image at the left; at the right the same with attention map, predicted spline and mark."""

    def __init__(self, scene: Scene, network: PerceptionNetwork) -> None:
        super().__init__()
        self._scene, self._network = scene, network

    def add(self, environment: NavigateEnv) -> None:
        """Looks at a step of the episode.

        Args:
            environment: the scene's.
        """
        from splineformer.navigation.picture import picture_of_moment

        ended = bool(environment.steps and environment.ended)
        if self._count % _STRIDE == 0 or ended:
            marks = [self._scene.marks[name] for name in self._scene.arms.cameras]
            views = zip(self._scene.images(), marks, strict=True)
            pictures = [picture_of_moment(image, self._network, mark) for image, mark in views]
            self._frames.append(np.concatenate(pictures))
        self._count += 1

    def write(self, path: Path) -> None:
        """Writes the film as a GIF."""
        from PIL import Image

        from splineformer.navigation.picture import SIDE_PX

        seen = np.concatenate([one[:, SIDE_PX:] for one in self._frames[:: max(1, len(self._frames) // 6)]])
        found = Image.fromarray(seen).quantize(_COLOURS, method=Image.Quantize.MAXCOVERAGE).getpalette()
        # greys where the images have theirs: a thin wire differs little from what is behind it
        first = self._frames[0][:, :SIDE_PX]
        low, high = np.percentile(first[first > 0], (1, 99))
        levels = np.concatenate(([0], np.linspace(low, high, _GREYS - 1))).round().astype(int)
        colours = [*np.repeat(levels, 3).tolist(), *(found or [])[: 3 * _COLOURS]]
        write_gif(path, self._frames, colours, _FRAMES_PER_SECOND)


def film_trials(job: FilmJob, report: Report) -> dict[str, Any]:
    """Repeats a successful and a failed trial and films them; without a failure there is no film of one.

    Returns:
        ``success`` and ``failure``, each the navigator, test, target and number of the trial, where there is one.
    """
    from pipeline.recording.record import record_episode
    from pipeline.stages.navigation.jobs import NAVIGATOR, load_navigator

    network = load_perception(job.folder, report.device)
    filmed: dict[str, Any] = {}
    for part, (kind, rows) in enumerate(((SUCCESS, job.rows), (FAILURE, job.rows[::-1]))):
        report(part / 2, kind)
        trial = find(rows, job, kind == SUCCESS)
        if trial is None:
            continue
        row, test, target, number, seed = trial
        anatomy = test.anatomies[number // test.trials]
        scene = scene_of(test.task, anatomy, target, job.settings.arms, ("tip",), clutter=test.clutter)
        film = NavigationFilm(scene, network)
        policy, perception = load_navigator(job.folder / row / NAVIGATOR, network)
        record_episode(
            scene.environment,
            controllers(policy, perception, scene)(seed),
            job.folder / FILMS / f"{kind}.mcap",
            seed=seed,
            operator="policy",
            configuration=job.origin.configuration(MODES[0]),
            film=film,
            pictures=False,
        )
        with atomic_path(job.folder / FILMS / f"{kind}.gif") as temporary:
            film.write(temporary)
        scene.environment.close()
        filmed[kind] = {"navigator": row, "test": test.name, "target": target, "trial": number}
    return filmed


def find(rows: Sequence[str], job: FilmJob, success: bool) -> tuple[str, TrialSet, str, int, int] | None:
    """The first trial with an outcome: its navigator, set, target, number and seed."""
    for row in rows:
        for test in job.tests:
            for target in reversed(job.settings.targets):
                # logs lie by the anatomy's name; trials are numbered by the order of the set
                for log in sorted((job.folder / row / EVALUATION / test.name / target).glob("*/*.mcap")):
                    with EpisodeReader(log) as episode:
                        if bool(episode.outcome.success) is success:
                            names = [phantom_of(anatomy).name for anatomy in test.anatomies]
                            number = names.index(episode.info.phantom) * test.trials + int(log.stem)
                            return row, test, target, number, episode.info.seed
    return None
