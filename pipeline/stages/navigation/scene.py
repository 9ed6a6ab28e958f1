"""Scenes of the navigation: anatomies under the C-arms, logged episodes there, what a navigator is given, its trials.

A navigator is given images, the target's marks and what the contrast run shows, and nothing else of the simulation.
Trials on held-out starts are logged, resumable one by one, and failures are counted by their mode.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cathsim.lifetime_cache import kept_with_owner
from cathsim.metrics.failure_modes import MODES as FAILURES
from cathsim.metrics.failure_modes import failure_mode
from cathsim.observations.c_arm_view import (
    CArmClutter,
    CArms,
    as_shown,
    c_arm_environment,
    contrast_images,
    fluoroscope_of,
    marks_of,
)
from pipeline.anatomies.anatomy_file import AnatomyFile
from pipeline.episodes import EpisodeReader
from pipeline.recording.replay import checked_values, recorded_phantom
from pipeline.recording.trials import MODES, Controller, Origin, run_trials, summary
from pipeline.seeds import held_out_seeds
from pipeline.stages.learning.task import REWARD_OF_EVALUATION
from pipeline.stages.navigation.settings import NavigationSettings
from pipeline.stages.unseen.task import clutter_of
from pipeline.store.errors import StageError
from pipeline.task import Task

if TYPE_CHECKING:
    from cathsim import NavigateEnv
    from cathsim.anatomy import Phantom
    from cathsim.metrics import EpisodeMetrics
    from enn.imitation.advised_episodes import EpisodeStart
    from enn.imitation.recurrent_policy import RecurrentPolicy
    from enn.imitation.sequence_cloning import AdvisedEpisode
    from splineformer.navigation.navigator_perception import (
        EpisodeView,
        NavigatorPerception,
        NavigatorPerceptionSettings,
    )
    from splineformer.navigation.space_map import Hull, SpaceMap
    from splineformer.navigation.vessel_map import VesselMap

RESOLUTION = 1e-3  # m, of the anatomies' grids
NAMED = -1  # seed of an anatomy that has a name of its own

# kind and seed; with a seed below 0 the kind is a phantom's name, or a file
Anatomy = tuple[str | AnatomyFile, int]


def phantom_of(anatomy: Anatomy) -> Phantom:
    """The phantom of a kind and seed, kept while this process works on it."""
    from cathsim.many_anatomies import SHELF

    kind, seed = anatomy
    if isinstance(kind, AnatomyFile):
        return kind.load()
    return SHELF.take(kind if seed < 0 else (kind, seed), RESOLUTION)


def among_clutter(arms: CArms, amount: float, generator: np.random.Generator) -> CArms:
    """The C-arms with so much clutter (`clutter_of`) in the way, or as they are without."""
    draw = clutter_of(amount)
    if draw is None:
        return arms
    return replace(arms, clutter=CArmClutter(tuple(draw(generator, arms.image_size_px) for _ in arms.cameras)))


@kept_with_owner
def _among_its_own(phantom: Phantom, arms: CArms, amount: float) -> CArms:
    """The C-arms over a phantom, with clutter that is the phantom's own: other phantoms have other clutter."""
    return among_clutter(arms, amount, np.random.default_rng(int(phantom.hash[:8], 16)))


def in_view(anatomy: Anatomy, target: str, arms: CArms) -> bool:
    """Whether every camera's image has a target in it: a random arch may be larger than the field."""
    marks = marks_of(phantom_of(anatomy), target, arms)
    return all(((mark >= 0) & (mark < 1)).all() for mark in marks.values())


@kept_with_owner
def vessels_of(phantom: Phantom, target: str, arms: CArms) -> dict[str, VesselMap]:
    """The contrast run before the procedure as a map a camera, with the target marked."""
    from splineformer.navigation.vessel_map import VesselMap

    lumens, marks = _lumens(phantom, arms), marks_of(phantom, target, arms)
    return {name: VesselMap(lumens[name], marks[name]) for name in arms.cameras}


@kept_with_owner
def space_of(phantom: Phantom, target: str, arms: CArms) -> SpaceMap:
    """The contrast run of both cameras as one map in space."""
    from splineformer.navigation.space_map import SpaceMap

    marks = marks_of(phantom, target, arms)
    return SpaceMap(_hull(phantom, arms), [marks[name] for name in arms.cameras])


@kept_with_owner
def _hull(phantom: Phantom, arms: CArms) -> Hull:
    from guide3d.geometry.camera import Camera
    from splineformer.navigation.space_map import hull_of

    size, seen = arms.image_size_px, fluoroscope_of(phantom, arms).cameras
    known = [
        Camera(seen[name].projector.K, seen[name].projector.R, 1e3 * seen[name].projector.t, size, size, name)
        for name in arms.cameras
    ]
    lumens = _lumens(phantom, arms)
    return hull_of([lumens[name] for name in arms.cameras], known)


@kept_with_owner
def _lumens(phantom: Phantom, arms: CArms) -> dict[str, np.ndarray]:
    from splineformer.navigation.vessel_map import lumen_of_run

    return {name: lumen_of_run(*images) for name, images in contrast_images(phantom, arms).items()}


def view_of(
    settings: NavigatorPerceptionSettings,
    phantom: Phantom,
    target: str,
    arms: CArms,
    images: Callable[[], Sequence[np.ndarray]],
) -> EpisodeView:
    """A navigator's view of an episode, before its first decision; `images` gives the moment's image of each camera."""
    from splineformer.navigation.navigator_perception import EpisodeView

    place = phantom, target, arms
    vessels = vessels_of(*place) if settings.guided else None
    return EpisodeView(settings, images, marks_of(*place), vessels, space_of(*place) if settings.space else None)


@dataclass(eq=False)
class Scene:
    """An environment under the C-arms."""

    environment: NavigateEnv
    arms: CArms

    @property
    def target(self) -> str:
        return self.environment.task.target_name

    def images(self) -> list[np.ndarray]:
        """The moment's image of each camera."""
        view = self.environment.biplane
        assert view is not None
        images = [view.frame(name).image for name in self.arms.cameras]
        return as_shown(self.environment.phantom, self.arms, images)

    @property
    def marks(self) -> dict[str, np.ndarray]:
        return marks_of(self.environment.phantom, self.target, self.arms)

    def view(self, settings: NavigatorPerceptionSettings) -> EpisodeView:
        """A navigator's view of an episode here."""
        return view_of(settings, self.environment.phantom, self.target, self.arms, self.images)


def scene_of(
    task: Task,
    anatomy: Anatomy,
    target: str,
    arms: CArms,
    observation: Sequence[str],
    observe_every: int = 1,
    clutter: float = 0.0,
) -> Scene:
    """A scene of a task's wire, limits and start under the C-arms; an anatomy's clutter is always the same."""
    phantom = phantom_of(anatomy)
    seen = _among_its_own(phantom, replace(arms, wire=task.wire), clutter)
    arguments = {"reward": REWARD_OF_EVALUATION, "observe_every": observe_every, **task.arguments(phantom.name)}
    return Scene(c_arm_environment(phantom, target, seen, observation, **arguments), seen)


def episode_starts(
    task: Task,
    cases: Sequence[tuple[Anatomy, str]],
    seeds: Sequence[int],
    arms: CArms,
    observation: Sequence[str],
    settings: NavigatorPerceptionSettings,
    action_repeat: int,
    clutter: Mapping[Anatomy, float] | None = None,
) -> Iterator[EpisodeStart]:
    """Starts of advised episodes, each scene made when its turn comes and closed when the episode has ended."""
    from enn.imitation.advised_episodes import EpisodeStart

    for (anatomy, target), seed in zip(cases, seeds, strict=True):
        scene = scene_of(task, anatomy, target, arms, observation, action_repeat, (clutter or {}).get(anatomy, 0.0))

        def begin(first: object, scene: Scene = scene) -> EpisodeView:
            return scene.view(settings)

        yield EpisodeStart(scene.environment, seed, begin, scene.environment.close, target)


def episode_of_log(log: Path, arms: CArms, perception: NavigatorPerception, action_repeat: int) -> AdvisedEpisode:
    """A logged episode as the navigator would have seen it, an image, drawn of the wire's logged shape, a decision."""
    from cathsim.observations.c_arm_view import images_of_shape, with_shaft
    from enn.imitation.sequence_cloning import AdvisedEpisode

    with EpisodeReader(log) as episode:
        info, outcome = episode.info, episode.outcome
        arrays = episode.load_arrays(pictures=False)
    with checked_values(info, "phantom"):
        phantom = recorded_phantom(info)
    direction = phantom.entry(info.entry).direction
    steps = range(0, len(arrays["action"]) - 1, action_repeat)
    images = [
        images_of_shape(phantom, arms, with_shaft(arrays["wire_points"][step], direction), (info.seed, step))
        for step in steps
    ]
    readings = perception.network([image for several in images for image in several])
    count = len(arms.cameras)
    view = view_of(perception.settings, phantom, info.target, arms, list)
    features, actions = [], [np.zeros(2, np.float32)]
    for number, step in enumerate(steps):
        features.append(view.look(readings[number * count : (number + 1) * count], actions[-1]))
        # what the expert did while a decision of the navigator would have been held
        done = arrays["action"][step + 1 : step + 1 + action_repeat]
        actions.append(done.mean(axis=0).astype(np.float32))
    nothing = np.zeros((len(features), 0), np.float32)
    return AdvisedEpisode(np.stack(features), np.stack(actions[1:]), nothing, bool(outcome.success), info.target)


EVALUATION = "evaluation"


@dataclass(frozen=True)
class TrialSet:
    """Trials on held-out starts."""

    name: str
    anatomies: tuple[Anatomy, ...]  # one after the other
    trials: int  # in each, for each target
    task: Task
    clutter: float = 0.0  # in the images


def run_tests(
    policy: RecurrentPolicy,
    perception: NavigatorPerception,
    tests: Sequence[TrialSet],
    settings: NavigationSettings,
    folder: Path,
    origin: Origin,
    *,
    report: Callable[[float, str], None],
) -> list[dict[str, Any]]:
    """Puts a navigator to its trials; those whose log is there are not repeated.

    Returns:
        A row for each set and target: success, mean time of successful trials, forces, failure modes, number, and in
        how many anatomies the target lies outside the cameras' images, where there is no trial.
    """
    from cathsim.presets import PACES

    rows = []
    cells = [(test, target) for test in tests for target in settings.targets]
    total, done = sum(len(test.anatomies) for test, _ in cells), 0
    for test, target in cells:
        metrics: list[EpisodeMetrics] = []
        failures = Counter(dict.fromkeys(FAILURES, 0))
        seeds = held_out_seeds(origin.training_seed, len(test.anatomies) * test.trials)
        out_of_view = 0
        for place, anatomy in enumerate(test.anatomies):
            done += 1
            if not in_view(anatomy, target, settings.arms):
                out_of_view += 1
                continue
            scene = scene_of(test.task, anatomy, target, settings.arms, ("tip",), clutter=test.clutter)
            environment = scene.environment
            logs_in = folder / EVALUATION / test.name / target / environment.phantom.name
            metrics += run_trials(
                environment,
                controllers(policy, perception, scene),
                logs_in,
                seeds=seeds[place * test.trials : (place + 1) * test.trials],
                mode=MODES[0],
                origin=origin,
            )
            logs = [logs_in / f"{index:03d}.mcap" for index in range(test.trials)]
            failures.update(count_failures(logs, environment.phantom))
            environment.close()
            report(done / total, f"{test.name} {target} {sum(one.success for one in metrics)}/{len(metrics)}")
        if not metrics:
            raise StageError(f"the cameras see the {target} in none of {test.name}; choose other stage.cameras.")
        times = [PACES[test.task.pace].interval * one.steps for one in metrics if one.success]
        row = {
            "test": test.name,
            "target": target,
            **summary(metrics),
            "time_s": float(np.mean(times)) if times else None,
            **failures,
            "out_of_view": out_of_view,
        }
        rows.append(row)
    return rows


def controllers(policy: RecurrentPolicy, perception: NavigatorPerception, scene: Scene) -> Callable[[int], Controller]:
    """What steers the episode of a seed; the navigator asks for images, never for the observation."""
    from enn.imitation.recurrent_policy import RecurrentController

    return lambda seed: RecurrentController(policy, perception, lambda first: scene.view(perception.settings))


def count_failures(logs: Iterable[Path], phantom: Phantom) -> dict[str, int]:
    """How often each of `cathsim.metrics.failure_modes.MODES` occurs among trials in one anatomy."""
    counts = dict.fromkeys(FAILURES, 0)
    for log in logs:
        with EpisodeReader(log) as episode:
            if episode.outcome.success:
                continue
            info, tips = episode.info, episode.load_arrays(pictures=False)["tip"]
        steps_allowed = int(info.configuration["max_steps"])
        counts[failure_mode(phantom, info.target, tips, steps_allowed=steps_allowed, entry=info.entry)] += 1
    return counts
