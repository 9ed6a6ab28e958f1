"""An environment over many anatomies, targets and wires: each episode draws one of each."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Sequence
from typing import Any, NamedTuple

import gymnasium
import numpy as np

from cathsim.anatomy import Phantom, load_phantom
from cathsim.anatomy.point_target import TargetLike, as_target
from cathsim.devices.choice import resolve_wire
from cathsim.environment import NavigateEnv
from cathsim.guidewire import Guidewire
from cathsim.registration.description import Specified, from_spec
from cathsim.registration.usage import Usage, exclusive

# a phantom's name or a mesh's path; the seed of a random arch; a name that needs a seed, and that
AnatomyChoice = str | int | tuple[str, int]


class Case(NamedTuple):
    """What an episode of `NavigateManyEnv` takes place in, as indices into its arguments."""

    phantom: int
    target: int
    wire: int


class PhantomShelf:
    """Phantoms of one process, loaded when first wanted; beyond `capacity` the one unused for longest is let go.

    Args:
        capacity: phantoms kept at least; those that environments still hold come on top.
    """

    def __init__(self, capacity: int = 64) -> None:
        self.capacity = capacity
        self._kept: OrderedDict[tuple[AnatomyChoice, float], Phantom] = OrderedDict()
        self._lock = threading.Lock()

    def take(self, name: AnatomyChoice, resolution: float) -> Phantom:
        """The phantom of a name, with its seed where it needs one, or for a number the random arch of that seed.

        Args:
            resolution: m between the nodes of its grid.
        """
        key = (name, resolution)
        with self._lock:
            if key not in self._kept:
                if isinstance(name, str):
                    self._kept[key] = load_phantom(name, resolution=resolution)
                else:
                    kind, seed = name if isinstance(name, tuple) else ("random", name)
                    self._kept[key] = load_phantom(kind, seed=int(seed), resolution=resolution)
            self._kept.move_to_end(key)
            while len(self._kept) > self.capacity:
                self._kept.popitem(last=False)
            return self._kept[key]


SHELF = PhantomShelf()


def _of_current(name: str, description: str) -> Any:
    return property(lambda self: getattr(self.current, name), doc=description)


def _let_go(environment: NavigateEnv) -> None:
    """Closes an environment and cuts its parts off from it: they refer to it, so that it would stay in memory, with
    its anatomy and simulations, until Python next looks for such circles.
    """
    environment.close()
    for part in (environment.sensors, environment):
        vars(part).clear()


class NavigateManyEnv(Specified, gymnasium.Env[Any, np.ndarray]):
    """`NavigateEnv` in an anatomy, towards a target and with a wire that each reset draws again.

    Phantoms are built at first use and shared by every environment of the process, which keeps the last 64 of them
    (`SHELF.capacity`): at 1 mm 8 MB each, and 6 MB for each target in use, the latest one included.

    Observations and actions are those of `NavigateEnv`; all wires must give the same observation space. `info` also
    holds `case`, the number of the drawn case, `phantom` and `target`, their names.

    Args:
        phantoms: names, paths of meshes, `Phantom`s, whole numbers (seeds of random arches), or pairs of a name and a
            seed: ("random_wide", 3).
        targets: their names, or points in the lumens of all phantoms, (3,) m each.
        wires: names of presets, paths of YAML files, or `Guidewire`s; None: a catheter alone, with `catheter`.
        resolution: m between the nodes of the phantoms' grids.
        arguments: of `NavigateEnv`, for every episode: `catheter` among them.

    Raises:
        ValueError: nothing to choose from, or wires of different observations.
    """

    metadata = NavigateEnv.metadata

    def __init__(
        self,
        phantoms: Sequence[AnatomyChoice | Phantom] = tuple(range(16)),
        targets: Sequence[TargetLike] = ("bca", "lcca"),
        wires: Sequence[str | Guidewire | None] = ("default",),
        *,
        resolution: float = 1e-3,
        **arguments: Any,
    ) -> None:
        for name, choices in (("phantoms", phantoms), ("targets", targets), ("wires", wires)):
            if isinstance(choices, str) or not len(choices):
                raise ValueError(f"{name} must list at least one, got {choices!r}")
        for name in ("phantom", "target", "wire", "phantom_seed"):
            if name in arguments:
                raise ValueError(f"an environment over many anatomies takes {name}s, a list, instead of {name}")
        self.phantoms = tuple(from_spec(phantom) for phantom in phantoms)
        self.targets = tuple(as_target(target) for target in targets)
        self.wires = tuple(resolve_wire(wire) for wire in wires)
        self.resolution = resolution
        self._arguments = arguments
        self.case = 0
        self.usage = Usage()
        self.current = self._build(0)
        self.action_space, self.observation_space = self.current.action_space, self.current.observation_space
        self.render_mode = self.current.render_mode
        self.metadata = self.current.metadata

    @property
    def cases(self) -> int:
        """How many combinations of anatomy, target and wire there are."""
        return len(self.phantoms) * len(self.targets) * len(self.wires)

    def describe(self, case: int) -> Case:
        """The anatomy, target and wire of a case.

        Raises:
            ValueError: there is no such case.
        """
        if not 0 <= case < self.cases:
            raise ValueError(f"there is no case {case}: they are numbered from 0 to {self.cases - 1}")
        rest, wire = divmod(int(case), len(self.wires))
        return Case(*divmod(rest, len(self.targets)), wire)

    def case_of(self, phantom: int, target: int = 0, wire: int = 0) -> int:
        """The number of a case, from indices into `phantoms`, `targets` and `wires`."""
        return (phantom * len(self.targets) + target) * len(self.wires) + wire

    def _build(self, case: int) -> NavigateEnv:
        chosen = self.describe(case)
        named = self.phantoms[chosen.phantom]
        phantom = named if isinstance(named, Phantom) else SHELF.take(named, self.resolution)
        return NavigateEnv(phantom, self.targets[chosen.target], wire=self.wires[chosen.wire], **self._arguments)

    def _change(self, case: int) -> None:
        if case == self.case:
            return
        current = self._build(case)
        if (current.observation_space, current.action_space) != (self.observation_space, self.action_space):
            raise ValueError(
                "all wires and phantoms must give the same spaces of observations and actions: take other observations "
                "or devices"
            )
        _let_go(self.current)
        self.case, self.current = case, current

    # Parts of the environment of the episode.
    simulation = _of_current("simulation", "The simulation of the episode.")
    phantom = _of_current("phantom", "The anatomy of the episode.")
    task = _of_current("task", "The task of the episode.")
    fluoroscope = _of_current("fluoroscope", "The fluoroscope of the episode.")
    biplane = _of_current("biplane", "The bi-planar fluoroscope of the episode, or None.")

    @exclusive
    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Starts an episode in a case drawn at random.

        Args:
            seed: of the case and of the start's jitter.
            options: `case`, the number of the case instead of a drawn one; `start`, from `start_state`, which brings
                its case along; `target`, a name or a point in the lumen, (3,) m, instead of the case's.

        Raises:
            ValueError: an option that there is not.
        """
        super().reset(seed=seed)
        options = dict(options or {})
        start, case_option, target = (options.pop(name, None) for name in ("start", "case", "target"))
        if options:
            raise ValueError(f"reset knows no option {', '.join(sorted(options))}; there are case, start, target")
        case, own_seed = (int(number) for number in self.np_random.integers((self.cases, 2**31)))
        if start is not None:
            start = np.asarray(start)
            case, start = int(start[-1]), start[:-1]
        elif case_option is not None:
            case = int(case_option)
        self._change(case)
        target = self._drawn_target() if target is None else target
        observation, info = self.current.reset(seed=own_seed, options={"start": start, "target": target})
        return observation, self._named(info)

    @exclusive
    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Advances by one control step, as `NavigateEnv.step` does."""
        observation, reward, terminated, truncated, info = self.current.step(action)
        return observation, reward, terminated, truncated, self._named(info)

    def _drawn_target(self) -> TargetLike | None:
        """The target of an episode in the anatomy of the moment; None: the case's."""
        return None

    def _named(self, info: dict[str, Any]) -> dict[str, Any]:
        return info | {"case": self.case, "phantom": self.phantom.name, "target": self.task.target_name}

    @exclusive
    def observe(self) -> Any:
        """The observation of the moment."""
        return self.current.observe()

    @exclusive
    def start_state(self) -> np.ndarray:
        """The moment as a start that `reset(options={"start": …})` takes, the number of the case last. Shape (n,)."""
        return np.append(self.current.start_state(), float(self.case))

    @exclusive
    def state(self) -> dict[str, Any]:
        """Everything that the rest of the episode and later draws depend on, to be pickled; for `restore`."""
        return {"case": self.case, "generator": self.np_random.bit_generator.state, "episode": self.current.state()}

    @exclusive
    def restore(self, state: dict[str, Any]) -> Any:
        """Goes on where an environment with the same arguments was saved by `state`; returns the observation."""
        self._change(state["case"])
        self.np_random.bit_generator.state = state["generator"]
        return self.current.restore(state["episode"])

    @exclusive
    def render(self) -> np.ndarray | None:
        """A picture as `render_mode` says."""
        return self.current.render()

    def close(self) -> None:
        """Frees the renderer."""
        self.usage.close(self.current.close)
