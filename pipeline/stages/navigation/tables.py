"""Summary of the navigation: the thesis's table, every set of trials, success by expert trials, figures and films."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cathsim.metrics.failure_modes import MODES as FAILURES
from cathsim.viewing.film import Film, write_gif
from pipeline.episodes import EpisodeReader
from pipeline.episodes.records import EpisodeReadError
from pipeline.jobs.worker import Report
from pipeline.recording.trials import MODES, Origin
from pipeline.stages import StageContext
from pipeline.stages.learning.expert_episodes import expert_folder
from pipeline.stages.navigation.perception import PERCEPTION, load_perception
from pipeline.stages.navigation.scene import EVALUATION, Scene, TrialSet, controllers, phantom_of, scene_of
from pipeline.stages.navigation.settings import NavigationSettings
from pipeline.stages.user_study import logs_of
from pipeline.store.atomic_files import atomic_path
from pipeline.tables import Figure

if TYPE_CHECKING:
    from cathsim import NavigateEnv
    from splineformer.navigation.perception import PerceptionNetwork

SUCCESS, FAILURE = "success", "failure"
FILMS = "films"  # job and folder
_STRIDE = 4  # steps from frame to frame
_FRAMES_PER_SECOND = 8.0  # of playback: 3.2 times the episode's speed
_GREYS, _COLOURS = 36, 72  # noise in many greys would make the file ten times as large
GROUP = "Autonomous navigation"
ROW, DAGGER, ARCHES, PIXELS = "splineformer", "splineformer_dagger", "splineformer_arches", "behaviour_cloning"


def tables(settings: NavigationSettings, context: StageContext, outcomes: dict[str, Any]) -> dict[str, Any]:
    """The thesis's table, every set of trials with failure modes, success by expert trials, and the perception."""
    from cathsim.metrics.episodes import wilson_interval

    rows = navigator_rows(outcomes)
    main: dict[str, dict[str, Any]] = {}
    for operator, row, logs in (
        ("human", "expert_teleoperation", logs_of(context.run_path)),
        ("sampling_expert", "sampling_expert", context.inputs["expert"].rglob("evaluation/*.mcap")),
        ("policy", "enn_expert", _expert_logs(settings, context)),
    ):
        cells = _of_logs(logs, settings, operator)
        if cells:
            setup = "manual" if operator == "human" else "autonomous, knows the state"
            main[row] = {"setup": setup, "explainable": "–", **cells}
    first = settings.phantoms[0]
    if settings.pixel_cloning:
        pixel_logs = (context.path / PIXELS / first).glob(f"*/{EVALUATION}/{MODES[0]}/*.mcap")
        main[PIXELS] = {"setup": "autonomous", "explainable": "no", **_of_logs(pixel_logs, settings, "policy")}
    for row in rows:
        of_first = [one for one in outcomes[row]["tests"] if one["test"] == first]
        main[row] = {"setup": "autonomous", "explainable": "yes"}
        for one in of_first:
            main[row][f"{one['target']}_success_pct"] = one["success_pct"]
            main[row][f"{one['target']}_time_s"] = one["time_s"]
            main[row]["n"] = one["n"]
    trials: dict[str, dict[str, Any]] = {}
    for row in rows:
        for one in outcomes[row]["tests"]:
            cells = trials.setdefault(f"{row}/{one['test']}", {})
            target, n = one["target"], one["n"]
            low, high = wilson_interval(round(one["success_pct"] / 100 * n), n)
            cells[f"{target}_success_pct"] = one["success_pct"]
            cells[f"{target}_interval_pct"] = f"{100 * low:.0f} to {100 * high:.0f}"
            cells[f"{target}_depth_mm"] = one["depth_mm"]
            cells[f"{target}_time_s"] = one["time_s"]
            cells[f"{target}_force_max_n"] = one["force_max_n"]
            cells |= {f"{target}_{mode}": one[mode] for mode in (*FAILURES, "out_of_view")}
            cells["n"] = n
    curve = {
        f"{count} trials": {
            f"{one['target']}_success_pct": one["success_pct"]
            for one in outcomes[row_of(settings, count)]["tests"]
            if one["test"] == first
        }
        | {"n": settings.trials}
        for count in settings.episodes
    }
    perception = {name: {"value": value} for name, value in outcomes[PERCEPTION].items()}
    return {
        "navigation": main,
        "navigation_trials": trials,
        "navigation_episodes": curve,
        "navigation_perception": perception,
    }


def navigator_rows(outcomes: dict[str, Any]) -> list[str]:
    """Names of the navigators among the jobs: the thesis's first, then with more trials, then with a teacher."""
    rows = [key for key in outcomes if key == ROW or key.startswith(f"{ROW}_")]
    return sorted(rows, key=lambda row: (row == ARCHES, row == DAGGER, row != ROW))


def row_of(settings: NavigationSettings, count: int) -> str:
    """The row of the navigator that was cloned from so many expert trials a target."""
    return ROW if count == settings.episodes[0] else f"{ROW}_{count}"


def _expert_logs(settings: NavigationSettings, context: StageContext) -> list[Path]:
    """The expert's evaluation: nothing was learnt from these episodes, and their starts are those of the trials."""
    first = settings.phantoms[0]
    tasks = [f"{first}/{target}" for target in settings.targets]
    folders = [expert_folder(context.inputs["enn"], task, settings.expert) for task in tasks]
    return [log for folder in folders for log in sorted((folder / EVALUATION / MODES[0]).glob("*.mcap"))]


def _of_logs(logs: Iterable[Path], settings: NavigationSettings, operator: str) -> dict[str, Any]:
    """Success and mean time of an operator's finished episodes in the first phantom, by target."""
    steps: dict[str, list[tuple[bool, int, float]]] = {}
    for log in sorted(logs):
        try:
            with EpisodeReader(log) as episode:
                info, outcome = episode.info, episode.outcome
        except EpisodeReadError:
            continue
        if info.operator != operator or info.phantom != settings.phantoms[0] or outcome.success is None:
            continue
        limits = {"success_radius": 1e-3 * settings.task.success_radius_mm, "max_steps": settings.task.max_steps}
        differs = any(abs(float(info.configuration.get(key, value)) - value) > 1e-9 for key, value in limits.items())
        if operator == "human" and differs:
            continue
        steps.setdefault(info.target, []).append((bool(outcome.success), outcome.steps, info.control_dt))
    cells: dict[str, Any] = {}
    for target in settings.targets:
        if target in steps:
            times = [count * dt for success, count, dt in steps[target] if success]
            cells[f"{target}_success_pct"] = 100.0 * len(times) / len(steps[target])
            cells[f"{target}_time_s"] = sum(times) / len(times) if times else None
    return cells


def figures(outcomes: dict[str, Any]) -> list[Figure]:
    """Lists the films."""
    entries = []
    for kind, trial in outcomes.get(FILMS, {}).items():
        words = f"{trial['navigator']}, {trial['test']}, {trial['target'].upper()}, trial {trial['trial']}"
        caption = (
            f"{words}. Left the cameras' images; right attention (orange), predicted spline (red), its tip (green) and "
            "the target's mark (blue)."
        )
        entries.append(Figure(f"A {kind}", caption, f"{FILMS}/{kind}.gif", GROUP))
    return entries


@dataclass(frozen=True)
class FilmJob:
    """Films of one success and one failure."""

    folder: Path
    settings: NavigationSettings
    rows: tuple[str, ...]  # of navigators, the one whose success is shown by preference first
    tests: tuple[TrialSet, ...]
    origin: Origin


class NavigationFilm(Film):
    """Each camera's image at the left; at the right the same with attention map, predicted spline and mark."""

    def __init__(self, scene: Scene, network: PerceptionNetwork) -> None:
        super().__init__()
        self._scene, self._network = scene, network

    def add(self, environment: NavigateEnv) -> None:
        """Looks at a step of the episode in the scene's environment."""
        from splineformer.navigation.perception import picture_of_moment

        ended = bool(environment.steps and environment.ended)
        if self._count % _STRIDE == 0 or ended:
            marks = [self._scene.marks[name] for name in self._scene.arms.cameras]
            views = zip(self._scene.images(), marks, strict=True)
            pictures = [picture_of_moment(image, self._network, mark) for image, mark in views]
            self._frames.append(np.concatenate(pictures))
        self._count += 1

    def write(self, path: Path) -> None:
        from PIL import Image

        from splineformer.navigation.perception import SIDE_PX

        seen = np.concatenate([one[:, SIDE_PX:] for one in self._frames[:: max(1, len(self._frames) // 6)]])
        palette = Image.fromarray(seen).quantize(_COLOURS, method=Image.Quantize.MAXCOVERAGE).getpalette()
        # greys where the images have theirs: a thin wire differs little from what is behind it
        first = self._frames[0][:, :SIDE_PX]
        low, high = np.percentile(first[first > 0], (1, 99))
        levels = np.concatenate(([0], np.linspace(low, high, _GREYS - 1))).round().astype(int)
        colours = [*np.repeat(levels, 3).tolist(), *(palette or [])[: 3 * _COLOURS]]
        write_gif(path, self._frames, colours, _FRAMES_PER_SECOND)


def film_trials(job: FilmJob, report: Report) -> dict[str, Any]:
    """Repeats and films a ``success`` and a ``failure``, if there is one: its navigator, test, target and number."""
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
