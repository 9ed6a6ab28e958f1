"""The demo's episode: an anatomy that the policy was not trained in, what it sees of it, and what it reads there."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.anatomies.anatomy_file import KINDS, AnatomyFile, load_anatomy
from pipeline.anatomies.devices import WITH_POLICIES, best_in_copies, catheter_better_mm, set_back_mm, softened
from pipeline.anatomies.settings import GENERATED_TARGETS, TARGETS
from pipeline.seeds import ARCHES, held_out_seeds, unseen_arches
from pipeline.stages.unseen.task import TEST_PHANTOM, UnseenTask
from pipeline.store.errors import ConfigurationError
from pipeline.task import TASK, Task

if TYPE_CHECKING:
    from cathsim import NavigateEnv
    from cathsim.fluoroscopy import XRayScene
    from enn.imitation.images.policy import ImagePolicy
    from enn.policy import Policy

_ARCHES = ARCHES["test"].width
_FIRST_TRIAL = 6_000_000_000  # seed of trials of devices, beyond those of all episodes


@dataclass(frozen=True)
class ImageReading:
    """What a policy of images goes by at a moment; places are columns and rows as shares of the image's side."""

    wire: np.ndarray  # from the tip on. Shape (n, 2).
    way: np.ndarray  # ahead of the tip. Shape (m, 2).
    lumen: np.ndarray  # probability of the vessel. Shape (size, size).


class WatchedEnvironment:
    """An environment that keeps its last observation; everything else is the environment's own."""

    def __init__(self, environment: Any) -> None:
        self.environment = environment
        self.observation: Any = None

    def __getattr__(self, name: str) -> Any:
        if name == "environment":
            raise AttributeError(name)
        return getattr(self.environment, name)

    def reset(self, **further: Any) -> tuple[Any, dict[str, Any]]:
        self.observation, info = self.environment.reset(**further)
        return self.observation, info

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        outcome = self.environment.step(action)
        self.observation = outcome[0]
        return outcome


class Scene:
    """A policy in an environment, an episode at a time.

    Args:
        model: the policy's name.
        environment: as the policy sees it.
        anatomy: what it is, for people.
        start_seed: of the episode's start.
        attempt_steps: after which the wire is withdrawn and the policy tries again.
        attempts: at most.
        background: what X-ray images show around the vessels; None: a water bath.
    """

    def __init__(
        self,
        model: str,
        policy: Policy | ImagePolicy,
        environment: Any,
        anatomy: str,
        start_seed: int,
        attempt_steps: int,
        attempts: int,
        background: XRayScene | None = None,
    ) -> None:
        from enn.retrying import RetryingController

        self.model, self.policy, self.anatomy, self.start_seed = model, policy, anatomy, start_seed
        self.background = background
        self.environment: Any = WatchedEnvironment(environment)  # that of the policy in everything but its class
        self.steer = RetryingController(self._attempt, attempt_steps, attempts, start_seed)
        self._first_view: Any = None
        self._roadmap: Any = None

    def _attempt(self, seed: int) -> Any:
        policy: Any = self.policy
        return policy.controller() if self.by_images else policy.controller(deterministic=False, seed=seed)

    @property
    def mode(self) -> str:
        """How actions are chosen: "stochastic" by a roadmap, where the best ones get stuck more often."""
        return "deterministic" if self.by_images else "stochastic"

    @property
    def by_images(self) -> bool:
        """Whether the policy sees nothing but images."""
        return bool(self.cameras)

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of the views whose images the policy sees."""
        from enn.imitation.images.policy import ImagePolicy

        return self.policy.cameras if isinstance(self.policy, ImagePolicy) else ()

    @property
    def field(self) -> float | None:
        """Side of the views' field, m; None: they hold all of the anatomy."""
        from enn.imitation.images.policy import ImagePolicy

        return self.policy.perception.field if isinstance(self.policy, ImagePolicy) else None

    @property
    def target(self) -> str:
        """The target's name."""
        return str(self.environment.task.target_name)

    @property
    def title(self) -> str:
        """Who steers where, in a line."""
        return f"the {self.model} steers to the {self.target.upper()} of {self.anatomy}"

    def read_off_image(self, view: str) -> ImageReading:
        """What a policy of images reads off the last image of one of its views."""
        policy: Any = self.policy
        perception, seen = policy.perception, self.environment.observation
        decided = getattr(self.steer.controller, "view", None)
        if decided is None and self._first_view is None:  # before its first decision
            self._first_view = perception.begin(seen)
        place = self.cameras.index(view)
        own, of_view = slice(place, place + 1), (decided or self._first_view).cameras[place]
        wire = of_view.wire(seen["image"][own], perception.mask(seen)[own])
        way, _ = of_view.way(wire[0])
        return ImageReading(wire[:, ::-1], way[:, ::-1], of_view.lumen)

    def read_off_scan(self) -> tuple[np.ndarray, np.ndarray]:
        """Wire and way as a policy by a roadmap has them: (n, 3) m from the tip on, and the next 50 mm, (50, 3) m."""
        from cathsim.observations.roadmap import Roadmap

        if self._roadmap is None:
            self._roadmap = Roadmap(self.environment.simulation, self.environment.task.target)
        wire = np.asarray(self.environment.simulation.wire_points())
        return wire, self._roadmap.way(wire[0])[0]


def open_scene(
    model: str,
    *,
    anatomy: str | None = None,
    unit: str | None = None,
    seed: int = 0,
    target: str | None = None,
    attempts: int = 1,
    catheter: bool = True,
    ct: str | None = None,
) -> Scene:
    """A shipped policy in a file's anatomy, or in a random arch that no policy was trained in.

    Args:
        model: name of the policy of the wire alone.
        anatomy: path of a surface, a label volume or a folder; None: the random arch of the seed.
        unit: of a surface; None: detected.
        seed: of the arch among the unseen ones, and of the episode's start.
        target: None: the first of `TARGETS` that the anatomy has.
        attempts: of the policy, each as long as an episode of its training.
        catheter: where the target's ostium offset is large enough (`catheter_better_mm`), take the policy that steers a
            catheter over the wire, too, if there is one; in a file's anatomy with a model by a roadmap, what trials in
            copies of it say (`enn.device_trials`).
        ct: path of the CT that the anatomy was segmented from, which X-ray images then show around the vessels.
    """
    import enn
    from enn.retrying import steps_of_attempts

    if ct is not None and anatomy is None:
        raise ConfigurationError("--ct is the CT of an anatomy of one's own: give --anatomy FILE, too")
    place: int | AnatomyFile
    background = None
    if anatomy is None:
        place, label = unseen_arches(_ARCHES)[seed], f"random arch {unseen_arches(_ARCHES)[seed]}"
        known = list(GENERATED_TARGETS)
    else:
        place, label = _file(anatomy, unit, ct), Path(anatomy).name
        phantom = place.load()
        known = list(phantom.targets)
        background = place.background()
    target_name = target or next((name for name in TARGETS if name in known), None)
    if target_name is None or target_name not in known:
        absence = "none of bca, lcca and lsa" if target is None else f"no target {target!r}"
        raise ConfigurationError(f"{label} has {absence}: choose --target from {', '.join(known) or 'none'}")
    policy = enn.load(model)  # takes seconds, after all that can be refused at once
    known_models = enn.models()
    of_both = [name for one in WITH_POLICIES if (name := f"{model}_{one}") in known_models] if catheter else []
    rules: Task | None = None
    if of_both:
        model, policy, rules = _best_model([model, *of_both], place, target_name)
    if TASK not in policy.metadata:
        raise ConfigurationError(
            f"the model {model!r} does not say which task it was trained for: choose another model"
        )
    rules = rules or Task(**policy.metadata[TASK])
    steps = rules.max_steps
    task = UnseenTask(TARGETS, replace(rules, max_steps=steps_of_attempts(steps, attempts)))
    start_seed = held_out_seeds(0, _ARCHES)[seed]
    environment = _environment(task, place, target_name, policy, background)
    return Scene(model, policy, environment, label, start_seed, steps, attempts, background)


def _best_model(
    names: list[str], place: int | AnatomyFile, target: str
) -> tuple[str, Policy | ImagePolicy, Task | None]:
    """Name, policy, task (None: as trained) of the best of wire alone and catheters over it, the usual one first."""
    import enn
    from enn.policy import Policy

    usual = int(_is_steep(place, target, names[1]))
    policy = enn.load(names[usual])
    if not (isinstance(place, AnatomyFile) and isinstance(policy, Policy)):
        return names[usual], policy, None
    loaded = [(name, enn.load(name)) for name in names]
    trained = [
        (name, one, Task(**one.metadata[TASK]))
        for name, one in loaded
        if isinstance(one, Policy) and TASK in one.metadata
    ]
    if len(trained) < len(names):  # what one without a task was trained for is not known
        return names[usual], policy, None
    softer = [(name, one, softened(task)) for name, one, task in trained if softened(task) != task]
    candidates = [*trained, *softer]
    policies, tasks = [one for _, one, _ in candidates], [task for _, _, task in candidates]
    return candidates[best_in_copies(policies, tasks, load_anatomy(place), target, usual=usual, seed=_FIRST_TRIAL)]


def _is_steep(place: int | AnatomyFile, target: str, policy: str) -> bool:
    """Whether a policy of a catheter, too, gets further than the wire alone; it does not in the aorta itself."""
    phantom = load_anatomy(f"{TEST_PHANTOM}_{place}" if isinstance(place, int) else place)
    branch = phantom.target(target).branch
    return branch != phantom.tree.root.name and set_back_mm(phantom, target) >= catheter_better_mm(policy, branch)


def _environment(
    task: UnseenTask, place: int | AnatomyFile, target: str, policy: Policy | ImagePolicy, background: XRayScene | None
) -> NavigateEnv:
    """The environment with what the policy sees among its observations."""
    from cathsim.observations.xray import XrayEnvironment
    from enn.imitation.images.policy import ImagePolicy

    if isinstance(policy, ImagePolicy):
        bare = task.test_environment(place, target, task.task.wire, ("goal_image",))
        return XrayEnvironment(bare, task.task.image_size_px, background=background, **policy.imaging)  # type: ignore[return-value]
    return task.test_environment(place, target, task.task.wire, policy.keys)


def _file(path: str, unit: str | None, ct: str | None) -> AnatomyFile:
    if not Path(path).exists():
        raise ConfigurationError(f"there is no anatomy {path}: give the path of a {KINDS}")
    return AnatomyFile.of(path, unit, ct=ct)
