"""The Gymnasium environment: navigate a guidewire, or a wire in a catheter, to a branch of the aorta."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np

from cathsim.anatomy import Phantom, load_phantom
from cathsim.anatomy.entry import EntryLike, entry_name
from cathsim.anatomy.point_target import TargetLike
from cathsim.devices.choice import simulation_of
from cathsim.devices.simulation import DualSimulation
from cathsim.navigation import Arrival, Goal, NavigationTask, navigation_task, require_reach, straight_distance
from cathsim.observations.sensors import Sensors
from cathsim.observations.tracking import VIEW
from cathsim.registration.description import Specified, from_spec, resolve_argument
from cathsim.registration.usage import Usage, exclusive
from cathsim.robot.feeders import ROTATION_STEP as ROTATION_STEP
from cathsim.robot.feeders import TRANSLATION_STEP as TRANSLATION_STEP
from cathsim.robot.feeders import Feeders
from cathsim.simulation import CONTROL_STEP
from cathsim.validation import Count, quantity, require_saved
from cathsim.viewing.display import MODES, Display, modes_here

if TYPE_CHECKING:
    from cathsim.blood.flow import BloodFlow
    from cathsim.contact.breathing import Breathing
    from cathsim.contact.hulls import Decomposition
    from cathsim.devices.catheter import Catheter
    from cathsim.fluoroscopy import BiplaneFluoroscope
    from cathsim.guidewire import Guidewire
    from cathsim.observations.scan import Scan
    from cathsim.presets import Accuracy, Pace
    from cathsim.robot.follower import FollowerRobot

ACTIONS = ("feeder", "tip_motors")
# of a saved moment
_SAVED = {"simulation", "forces", "generator", "steps", "ended", "target", "remaining", "sensors", "robots", "observed"}


class NavigateEnv(Specified, gymnasium.Env[Any, np.ndarray]):
    """A guidewire is fed through an introducer sheath into an aorta; its tip is to reach a target in a branch.

    With `catheter`, the wire lies in a catheter, and the tip is that of the device that is further in. One step lasts
    0.1 s of simulated time, or as `pace` says, the feeder moving at constant speed.

    ## Actions
    `actions="feeder"`: `Box(-1, 1, (2,))`, or (4,) of a wire in a catheter, whose feeder the last two move

    | index | action | at 1 |
    |---|---|---|
    | 0, 2 | translation of the feeder; positive inserts | 2 mm |
    | 1, 3 | rotation of the feeder about the direction of insertion | 15 degrees |

    `actions="tip_motors"`: `Box(-1, 1, (21,))`, the order of the thesis

    | index | action | at 1 |
    |---|---|---|
    | 0-19 | motors of the ten most distal joints, two hinges each | bend the free joint by 12 degrees |
    | 20 | translation of the feeder | 2 mm |

    ## Observations
    `observation` is one name, which gives a `Box`, or several, which give a `Dict`.

    | name | what | shape; of two devices | unit |
    |---|---|---|---|
    | internal | joints, centre-of-mass inertia and velocity of bodies, actuator, external forces | (28 links,) | SI |
    | joints | joint positions, then velocities | (4 links,) | m, rad, m/s, rad/s |
    | image, mask | frontal fluoroscopic image; pixels of the devices | (1, size, size) uint8 | grey; 0 or 255 |
    | sequential | the last three images, oldest first | (3, size, size) uint8 | grey |
    | shape | ends of the links from tip to feeder | (links + 1, 3) | m, world |
    | tip, goal | position of the tip; of the target | (3,) | m, world |
    | feeder | insertion, cosine and sine of the rotation; of two the wire's first, then its lead | (3,); (7,) | m, 1 |
    | force | resultant contact force | (3,) | N, world |
    | roadmap | way to the target, walls, devices, force in the tip's frame (`Roadmap.read`) | (64,); (71,) | about 1 |
    | history | what was tried lately and how long without progress (`History.read`) | (11,); (18,) | about 1 |
    | tracking | points of the wire in one view, target, last action (`Tracking.read`) | (16,); (18,) | about 1 |
    | goal_image | the target's dot in the frontal view | (1, size, size) uint8 | 0 to 255 |
    | devices | insertion, angles of hub and tip, feeder's force, hub's torque: wire, catheter | (2, 5) | SI, rad |

    `links` is the number of the wire's, 28 of the default one and 84 of the thesis's, and with a catheter, which gives
    `devices`, that of the chain in which both lie, whose links are finer over the catheter's shape.

    With `cameras`, for each of them (a and b): `image_a`, a noisy X-ray image, and `mask_a`, (1, size, size) uint8.

    ## Reward
    That of `NavigationTask`: "distance" (the thesis's), "geodesic", or what a function gives for the step's `info`:
    reward=lambda info: 100 * info["progress"] - info["force"].

    ## Start
    The wire lies in the sheath, its tip 5 mm inside the vessel, as a catheter's is, advanced by up to `start_jitter`;
    each device is turned by up to `start_rotation`.

    ## Endings
    Terminated when the tip is in the target's branch within `success_radius` of the target along the lumen, or with
    `success="straight"` in a straight line; truncated after `max_steps`, or when the state is `info["invalid"]`.

    ## Info
    `tip` (3,) m, `distance` m to the target in a straight line, `branch` in which the tip is ("aorta" before every
    ostium), `depth` m of the tip behind its ostium (0 in the aorta), `success_lumen` (whether the target is reached
    along the lumen, whatever the task's rule), `insertion` m, `rotation` rad, `force` N (largest resultant of the
    step), `force_vector` (3,) N, `success`, `invalid`; with `drive="robot"` also `driven`. With a catheter also
    `catheter_insertion` m, `catheter_rotation` rad of its hub, `lead` m of the wire's tip before the catheter's,
    `feeder_forces` (2,) N, and with the robot `catheter_driven`; `insertion`, `rotation` and `driven` are the wire's,
    or those of a catheter alone.
    With `contact_info=True` also `contacts`, the number k of contacts of that moment, `contact_points` (512, 3) m and
    `contact_forces` (512, 3) N, zero behind the first k rows; `env.simulation.contacts()` gives the k contacts alone.

    Args:
        phantom: a name of `cathsim.anatomy.PHANTOMS`, "random" (with `phantom_seed`), the path of a mesh (STL, OBJ,
            PLY), or a `Phantom`.
        target: "bca" (the default), "lcca", "lsa", or another of the phantom's targets: "rcca", "rsa", and 10 mm before
            the open ends "rcca_end", "rsa_end", "lcca_end", "lsa_end"; or a point in the lumen, (3,) m, world frame.
        entry: "descending" (femoral access), "ascending", a branch's open end such as "lsa_end" (from the left arm); or
            a point in the lumen, (3,) m, where the sheath ends, along the centreline towards the target.
        wire: a preset's name, the path of a YAML file or a `Guidewire`; for far targets a longer one,
            load_guidewire("default").scaled(0.36). None: a catheter alone.
        catheter: None, or a preset's name ("vertebral", "simmons2_6f"), the path of a YAML file or a `Catheter`.
        torsion: with a catheter, "elastic", or "rigid": both tips turn as their hubs do. A bare wire's is rigid.
        accuracy: "accurate", "fast" (about twice as fast, deeper contacts), "reference", or an `Accuracy`.
        actions: "feeder" or "tip_motors".
        image_size: side of the images, px (the thesis uses 80 and 128; the public biplane data set has 1,024).
        channels_last: images of shape (size, size, channels), as `ResizeObservation` needs them.
        cameras: None, "guide3d", "clinical", or a `BiplaneFluoroscope`: two C-arms beside the frontal view.
        render_mode: "rgb_array" (a 3-D view, needs EGL or OSMesa), "fluoroscopy" (the frontal image) or "human" (a
            window that shows every step at the speed of the simulated time; the extra `human` brings pygame for it).
        blood: None, "steady", "pulsatile", or a `BloodFlow`: its drag on the wire.
        contact: "sdf", "hulls" (convex hulls of the wall, made in minutes and cached), or a `Decomposition`.
        wall_stiffness: of the wall at each contact, N/mm; at most 1 with accuracy="accurate", 0.5 with "fast", 10 with
            "reference". None: what the solver makes of the usual contact.
        breathing: None, or a `Breathing`, with which the vessel moves and its target; the sheath, roadmap, history and
            images stay where the scan has them. An episode begins anywhere in a breath.
        drive: "direct", or "robot": a follower robot feeds each device stroke by stroke, so that a step may move it
            less than its action says, or not at all while the clamp goes back; see `info["driven"]`.
        pace: "usual", "arch_variety" (7.5 steps a second, 35 mm/s and 180 degrees/s at 1), or a `Pace`.
        view: of `tracking`, degrees about the superior axis, and before that about the axis to the left.
        registration_noise: of the roadmap, m an axis, drawn once an episode.
        scan: None, or a `Scan` that roadmap and history show instead of the vessel itself.
        contact_info: with `contacts`, `contact_points` and `contact_forces` in `info`: 24 kB a step.
        observe_every: steps between two observations; in between, `step` returns the last one, for policies that hold
            an action for so many steps. At the reset and the episode's end there is always one, the same as with 1.
        task: a `NavigationTask` or of a subclass with a reward of its own; further keywords replace its fields.
    """

    metadata = {"render_modes": list(MODES), "render_fps": round(1 / CONTROL_STEP)}  # noqa: RUF012

    def __init__(
        self,
        phantom: str | Phantom = "type_1",
        target: TargetLike | None = None,
        *,
        entry: EntryLike = "descending",
        wire: str | Guidewire | None = "default",
        catheter: str | Catheter | None = None,
        torsion: str = "elastic",
        accuracy: str | Accuracy = "accurate",
        actions: str = "feeder",
        observation: str | Sequence[str] = "internal",
        image_size: int = 80,
        channels_last: bool = False,
        render_mode: str | None = None,
        phantom_seed: int | None = None,
        blood: str | BloodFlow | None = None,
        contact: str | Decomposition = "sdf",
        wall_stiffness: float | None = None,
        breathing: Breathing | None = None,
        drive: str = "direct",
        pace: str | Pace = "usual",
        cameras: str | BiplaneFluoroscope | None = None,
        view: tuple[float, float] = VIEW,
        registration_noise: float = 0.0,
        scan: Scan | None = None,
        contact_info: bool = False,
        observe_every: int = 1,
        task: NavigationTask | None = None,
        **task_fields: Any,
    ) -> None:
        if actions not in ACTIONS:
            raise ValueError(f"unknown actions '{actions}'; there are {', '.join(ACTIONS)}")
        fields = {name: from_spec(value) for name, value in task_fields.items()}
        episode_task = navigation_task(target, fields, from_spec(task))
        self.phantom = resolve_argument("phantom", phantom, Phantom, partial(load_phantom, seed=phantom_seed))
        episode_task.goal(self.phantom)  # refuses an unknown target before anything is built
        self.simulation = simulation_of(
            self.phantom,
            wire,
            catheter,
            accuracy,
            torsion=torsion,
            entry=entry_name(entry, episode_task.target),
            contact=contact,
            tip_motors=actions == "tip_motors",
            blood=blood,
            wall_stiffness=wall_stiffness,
            pace=pace,
            breathing=breathing,
        )
        self.render_mode, self._contact_info = render_mode, contact_info
        self.metadata = {**self.metadata, "render_modes": modes_here(), "render_fps": 1 / self.simulation.pace.interval}
        self.usage = Usage()
        self._observe_every, self._observed = quantity("observe_every", observe_every, Count), None
        self.feeders = Feeders(self.simulation, drive)
        self._task = episode_task
        self.sensors = Sensors(
            self.simulation,
            observation,
            episode_task.target,
            self._remaining_from,
            image_size=image_size,
            channels_last=channels_last,
            registration_noise=registration_noise,
            cameras=cameras,
            wire=wire if isinstance(wire, str) else "default",
            scan=scan,
            view=view,
        )
        self.fluoroscope, self.biplane = self.sensors.fluoroscope, self.sensors.biplane
        self.roadmap, self.history = self.sensors.roadmap, self.sensors.history
        self._display = Display(render_mode, self.fluoroscope, self.robot)
        self.task = episode_task
        self.steps, self.ended = 0, True
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, self.feeders.shape, np.float32)
        self.observation_space = self.sensors.space

    @property
    def task(self) -> NavigationTask:
        """The task of the episode."""
        return self._task

    @task.setter
    def task(self, task: NavigationTask) -> None:
        self._set_task(task)
        self._own_task = task

    @property
    def robot(self) -> FollowerRobot | None:
        """The robot that feeds the wire, or the catheter that is alone; `feeders.robots` are those of both."""
        return self.feeders.robots[0] if self.feeders.robots else None

    @property
    def goal(self) -> np.ndarray:
        """Position of the episode's target, m, world frame, where breathing has not moved it. Shape (3,)."""
        return self._goal.position.copy()

    def arrival(self, tip: np.ndarray, share: float = 1.0) -> Arrival:
        """As `Goal.arrival` of the episode's target."""
        return self._goal.arrival(tip, share)

    def _set_task(self, task: NavigationTask) -> None:
        goal = Goal(task, self.phantom, reads_way=self.sensors.reads_way)
        require_reach(task, self.simulation)
        self._task, self._goal = task, goal
        self.roadmap.aim(task.target)

    @exclusive
    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Starts an episode; the same seed gives the same episode to the same actions, bit for bit.

        Args:
            seed: of the start's jitter.
            options: `start`, a state of `self.simulation`: the episode starts there instead of in the sheath; `target`,
                a name or a point in the lumen, (3,) m: of this episode alone, instead of the environment's own.

        Raises:
            ValueError: an option that there is not, a start of another wire, or a target that there is not, that lies
                outside the lumen or is out of the wire's reach.
        """
        options = dict(options or {})
        start, target = options.pop("start", None), options.pop("target", None)
        if options:
            raise ValueError(f"reset knows no option {', '.join(map(str, options))}; there are start, target")
        task = self._own_task if target is None else dataclasses.replace(self._own_task, target=target)
        if task != self._task:
            self._set_task(task)
        super().reset(seed=seed)
        if start is not None:
            self.simulation.restore(np.asarray(start))
        else:
            self.task.start(self.simulation, self.np_random)
        self.feeders.reset()
        self.sensors.begin(self.np_random)
        self.steps, self.ended = 0, False
        tip, inside = self.simulation.tip, self.simulation.tip_in_vessel
        self._goal.progress(inside)
        self._display.show(self._goal.position)
        self._observed = self.observe()
        return self._observed, self._info(tip, self.arrival(inside), success=False, invalid=False)

    @exclusive
    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Advances by one control step.

        Raises:
            ValueError: the action has another shape or is not finite.
            RuntimeError: the episode has ended, or none was started; the environment is closed, or in use by another
                thread.
        """
        if self.ended:
            reason = "the episode has ended" if self.steps else "no episode was started"
            raise RuntimeError(f"{reason}: call reset() before step()")
        action = self.feeders.checked(action)
        simulation, task = self.simulation, self.task
        before = simulation.tip
        moves = self.feeders.advance(action)
        self.steps += 1

        invalid = not simulation.valid
        if invalid:
            simulation.reset()  # so that the last observation is at least finite
        self.sensors.advance(moves)
        tip = simulation.tip
        arrival = self._goal.arrival(simulation.tip_in_vessel)
        success = arrival.success and not invalid
        info = self._info(tip, arrival, success=success, invalid=invalid)
        reward = self._reward(before, action, info)
        truncated = not success and (invalid or self.steps >= task.max_steps)
        self.ended = success or truncated
        self._display.show(self._goal.position)
        if self.ended or self.steps % self._observe_every == 0:
            self._observed = self.observe()
        return self._observed, reward, success, truncated, info

    @exclusive
    def start_state(self) -> np.ndarray:
        """The moment as a start that `reset(options={"start": …})` takes. Shape (n,)."""
        return self.simulation.state()

    @exclusive
    def state(self) -> dict[str, Any]:
        """Everything that the rest of the episode depends on, to be pickled; for `restore`."""
        return {
            "simulation": self.simulation.state(),
            "forces": self.simulation.force_state(),
            "generator": self.np_random.bit_generator.state,
            "steps": self.steps,
            "ended": self.ended,
            "target": self.task.target,
            "remaining": self._goal.remaining,
            "sensors": self.sensors.state(),
            "robots": self.feeders.state(),
            "observed": copy.deepcopy(self._observed),
        }

    @exclusive
    def restore(self, state: dict[str, Any]) -> Any:
        """Goes on where an environment with the same arguments was saved by `state`; returns the observation.

        Raises:
            ValueError: `state` gave no such dictionary; the environment stays as it is.
        """
        require_saved(state, _SAVED)
        if state["target"] != self.task.target:
            self._set_task(dataclasses.replace(self._own_task, target=state["target"]))
        self.simulation.restore(state["simulation"])
        self.simulation.restore_forces(state["forces"])
        self.np_random.bit_generator.state = state["generator"]
        self.steps, self.ended, self._goal.remaining = state["steps"], state["ended"], state["remaining"]
        self.sensors.restore(state["sensors"])
        self.feeders.restore(state["robots"])
        self._observed = copy.deepcopy(state["observed"])
        return self._observed

    def _reward(self, before_step: np.ndarray, action: np.ndarray, info: dict[str, Any]) -> float:
        progress = self._goal.progress(self.simulation.tip_in_vessel)
        moved = straight_distance(info["tip"], before_step)
        return self.task.reward_of(info, progress, moved, action, success=info["success"])

    def _remaining_from(self, place: np.ndarray) -> float:
        return self.task.remaining(self.phantom, place)

    @exclusive
    def observe(self) -> Any:
        """The observation of the moment."""
        return self.sensors.observe()

    def _info(self, tip: np.ndarray, arrival: Arrival, *, success: bool, invalid: bool) -> dict[str, Any]:
        simulation = self.simulation
        fed, force = (simulation.insertion, simulation.rotation), float(simulation.summary.force_max)
        info = arrival.info(tip, fed, force, simulation.force(), success=success, invalid=invalid)
        if isinstance(simulation, DualSimulation):
            info["catheter_insertion"], info["catheter_rotation"] = simulation.catheter_place()
            info["lead"], info["feeder_forces"] = simulation.device_lead, simulation.feeder_forces()
        info.update(self.feeders.info())
        if self._contact_info:
            contacts = simulation.measured.padded()
            info["contacts"] = simulation.summary.contacts
            info["contact_points"], info["contact_forces"] = contacts.points, contacts.forces
        return info

    @exclusive
    def render(self) -> np.ndarray | None:
        """A picture as `render_mode` says, shape (height, width, 3), uint8; "human" shows it in the window instead."""
        if self.render_mode == "human":
            self._display.show(self._goal.position)
            return None
        return self._display.picture(self._goal.position)

    def close(self) -> None:
        """Frees the renderer and closes the window."""
        self.usage.close(self._display.close)
