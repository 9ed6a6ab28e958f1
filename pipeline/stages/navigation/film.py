"""Films of navigation: what the cameras show, and beside it what the network makes of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.episodes import EpisodeReader
from pipeline.jobs.worker import Report
from pipeline.recording.film import Film
from pipeline.recording.trials import MODES, Origin
from pipeline.stages.navigation.perception import load_reader
from pipeline.stages.navigation.scene import Rig, Scene
from pipeline.stages.navigation.task import TrialSet
from pipeline.stages.navigation.trials import EVALUATION, controllers
from pipeline.store.atomic_files import atomic_path

if TYPE_CHECKING:
    from cathsim import NavigateEnv
    from splineformer.navigation.perception import Reader

SUCCESS, FAILURE = "success", "failure"
_ATTENTION, _SPLINE, _TIP, _MARK = (255, 120, 0), (255, 40, 40), (60, 255, 60), (0, 190, 255)
_STRENGTH = 0.55  # of attention over the image
_CURVE_POINTS = 120
SIDE_PX = 256  # of each half
_STRIDE = 4  # steps from frame to frame
_FRAMES_PER_SECOND = 8.0  # of playback: 3.2 times the episode's speed
_GREYS, _COLOURS = 36, 72  # noise in many greys would make the file ten times as large
_SMOOTHED_PX = 0.6


@dataclass(frozen=True)
class FilmJob:
    """Films of one success and one failure.

    Attributes:
        folder: for the films.
        reader: folder of the navigators' eye.
        rig: of the images.
        navigators: folders of navigators, those whose success is shown most gladly first.
        tests: their trials.
        targets: of these.
        origin: kept in the logs.
    """

    folder: Path
    reader: Path
    rig: Rig
    navigators: tuple[Path, ...]
    tests: tuple[TrialSet, ...]
    targets: tuple[str, ...]
    origin: Origin


class NavigationFilm(Film):
    """Each camera's image at the left; at the right the same with attention map, predicted spline and mark.

    Args:
        scene: that is filmed.
        reader: of its images.
    """

    def __init__(self, scene: Scene, reader: Reader) -> None:
        super().__init__()
        self._scene, self._reader = scene, reader

    def add(self, environment: NavigateEnv) -> None:
        """Looks at a step of the episode.

        Args:
            environment: the scene's.
        """
        ended = bool(environment.steps and environment.ended)
        if self._count % _STRIDE == 0 or ended:
            marks = [self._scene.marks[name] for name in self._scene.rig.cameras]
            views = zip(self._scene.images(), marks, strict=True)
            self._frames.append(np.concatenate([frame(image, self._reader, mark) for image, mark in views]))
        self._count += 1

    def write(self, path: Path) -> None:
        """Writes the film.

        Args:
            path: of the GIF; appears whole or not at all.
        """
        from PIL import Image

        side = SIDE_PX
        seen = np.concatenate([one[:, side:] for one in self._frames[:: max(1, len(self._frames) // 6)]])
        found = Image.fromarray(seen).quantize(_COLOURS, method=Image.Quantize.MAXCOVERAGE).getpalette()
        # greys where the images have theirs: a thin wire differs little from what is behind it
        low, high = np.percentile(self._frames[0][:, :side][self._frames[0][:, :side] > 0], (1, 99))
        levels = np.concatenate(([0], np.linspace(low, high, _GREYS - 1))).round().astype(int)
        greys = np.repeat(levels, 3).tolist()
        palette = Image.new("P", (1, 1))
        palette.putpalette([*greys, *(found or [])[: 3 * _COLOURS]])
        frames = [Image.fromarray(one).quantize(palette=palette, dither=Image.Dither.NONE) for one in self._frames]
        durations = [round(1000 / _FRAMES_PER_SECOND)] * (len(frames) - 1) + [1500]
        with atomic_path(path) as temporary:
            frames[0].save(
                temporary, format="GIF", save_all=True, append_images=frames[1:], duration=durations, loop=0, disposal=1
            )


def frame(image: np.ndarray, reader: Reader, mark: np.ndarray) -> np.ndarray:
    """A camera's picture of a moment.

    Args:
        image: (h, h) grey levels.
        reader: that reads it.
        mark: (2,) the target's mark as shares of the sides.

    Returns:
        (SIDE_PX, 2 SIDE_PX, 3) uint8.
    """
    from PIL import Image, ImageDraw, ImageFilter

    from splineformer.attention import attention_map

    side = SIDE_PX
    small = Image.fromarray(image).resize((side, side), Image.Resampling.BOX)
    grey = np.asarray(small.filter(ImageFilter.GaussianBlur(_SMOOTHED_PX)))
    plain = np.repeat(grey[:, :, None], 3, axis=2)
    looks = Image.fromarray(attention_map(reader.network, image)).resize((side, side), Image.Resampling.BILINEAR)
    weight = _STRENGTH * np.asarray(looks)[:, :, None]
    seen = Image.fromarray((plain * (1 - weight) + np.array(_ATTENTION) * weight).astype(np.uint8))
    reading = reader([image])[0]
    draw = ImageDraw.Draw(seen)
    places = np.linspace(0, len(reading.points) - 1, _CURVE_POINTS).round().astype(int)
    draw.line([tuple(point) for point in (side * reading.points[places]).tolist()], fill=_SPLINE, width=2)
    for place, radius, colour in ((reading.points[0], 4, _TIP), (mark, 7, _MARK)):
        x, y = (side * np.asarray(place, float)).tolist()
        draw.ellipse((x - radius, y - radius, x + radius, y + radius), outline=colour, width=2)
    return np.concatenate((plain, np.asarray(seen)), axis=1)


def film_trials(job: FilmJob, report: Report) -> dict[str, Any]:
    """Repeats a successful and a failed trial and films them; without a failure there is no film of one.

    Returns:
        ``success`` and ``failure``, each the navigator, test, target and number of the trial, where there is one.
    """
    from pipeline.recording.record import record_episode
    from pipeline.stages.navigation.jobs import NAVIGATOR
    from splineformer.navigation.navigator import Navigator

    reader = load_reader(job.reader, report.device)
    told: dict[str, Any] = {}
    for part, (kind, folders) in enumerate(((SUCCESS, job.navigators), (FAILURE, job.navigators[::-1]))):
        report(part / 2, kind)
        trial = find(folders, job, kind == SUCCESS)
        if trial is None:
            continue
        folder, test, target, number, seed = trial
        anatomy = test.anatomies[number // test.trials]
        scene = test.rules.scene(anatomy, target, job.rig, ("tip",))
        environment = scene.environment
        film = NavigationFilm(scene, reader)
        record_episode(
            environment,
            controllers(Navigator.load(folder / NAVIGATOR, reader), scene)(seed),
            job.folder / f"{kind}.mcap",
            seed=seed,
            operator="policy",
            configuration=job.origin.configuration(MODES[0]),
            film=film,
            pictures=False,
        )
        film.write(job.folder / f"{kind}.gif")
        environment.close()
        told[kind] = {"navigator": folder.name, "test": test.name, "target": target, "trial": number}
    return told


def find(folders: Any, job: FilmJob, success: bool) -> tuple[Path, TrialSet, str, int, int] | None:
    """The first trial with an outcome: its navigator, set, target, number and seed.

    Args:
        folders: of navigators.
        job: with tests and targets.
        success: the outcome.
    """
    for folder in folders:
        for test in job.tests:
            for target in reversed(job.targets):
                found = sorted((folder / EVALUATION / test.name / target).glob("*/*.mcap"))
                # logs lie by the anatomy's name; trials are numbered by the order of the set
                for log in found:
                    with EpisodeReader(log) as episode:
                        if bool(episode.outcome.success) is success:
                            place = _place(test, episode.info.phantom)
                            number = place * test.trials + int(log.stem)
                            return folder, test, target, number, episode.info.seed
    return None


def _place(test: TrialSet, phantom: str) -> int:
    from pipeline.stages.navigation.task import phantom_of

    return [phantom_of(anatomy).name for anatomy in test.anatomies].index(phantom)
