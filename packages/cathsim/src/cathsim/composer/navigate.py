"""The navigation task on composer entities, and the function that makes its environment."""

from __future__ import annotations

from collections import OrderedDict
from typing import Any

import mujoco
import numpy as np
from dm_control import composer, mjcf
from dm_control.composer.observation.observable import Generic
from dm_env import specs

from cathsim.anatomy import Phantom, load_phantom
from cathsim.anatomy.entry import EntryLike, entry_name
from cathsim.anatomy.point_target import TargetLike
from cathsim.composer.entities import Feeder, GuidewireEntity, VesselArena, model_parts
from cathsim.composer.two_devices import TwoDevices
from cathsim.contact.sdf import vessel_of
from cathsim.devices.catheter import Catheter
from cathsim.devices.choice import device_pair, resolve_catheter, resolve_wire
from cathsim.environment import ACTIONS, ROTATION_STEP, TRANSLATION_STEP
from cathsim.guidewire import Guidewire
from cathsim.navigation import Goal, NavigationTask, navigation_task, require_length
from cathsim.observations.fluoroscopes import camera, outside_sheath
from cathsim.presets import ACCURACY, Accuracy
from cathsim.registration.description import resolve_argument
from cathsim.simulation import CONTROL_STEP, SETTLE_STEPS

STEPPING = Accuracy(timestep=0.0025, refinement=1, mass_scale=10.0)


class NavigateTask(composer.Task):
    """Bring the wire's tip to a target; start, reward and endings are `NavigateEnv`'s.

    A control step of 0.1 s is 40 plain MuJoCo steps of 2.5 ms with the whole wire in the model: `NavigateEnv` instead
    repeats substeps in which the wire goes deep into the wall, and leaves out the links that wait outside the sheath.
    The two agree within millimetres, not bit for bit; catheters of large curves need substeps of 1 ms for that (after
    120 mm of a Simmons 2 pushed with its wire, 2 mm from the "reference" preset, and 9 mm with 2.5 ms).

    Args:
        entry: as of `NavigateEnv`.
        tip_motors: 21 actions instead of two.
        catheter: in which the wire lies: four actions; without a wire, the catheter alone.
        torsion: with a catheter, "elastic" or "rigid".
        image_size: side of the fluoroscopic image, px.
        numerics: time stepping; its refinement is not used.
        visual: with the lumen's surface and a camera "frontal" in the model, for rendering.
    """

    def __init__(
        self,
        phantom: Phantom,
        wire: Guidewire | None,
        task: NavigationTask,
        *,
        entry: EntryLike = "descending",
        tip_motors: bool = False,
        catheter: Catheter | None = None,
        torsion: str = "elastic",
        image_size: int = 80,
        numerics: str | Accuracy = STEPPING,
        visual: bool = False,
    ) -> None:
        self.phantom, self.task = phantom, task
        self._goal = Goal(task, phantom)
        self.goal = self._goal.position
        numerics = resolve_argument("numerics", numerics, Accuracy, ACCURACY)
        pair = device_pair(wire, catheter, torsion)
        if pair is not None and tip_motors:
            raise ValueError("two devices are simulated without tip motors: leave out the catheter for them")
        site = entry_name(entry, task.target)
        vessel = vessel_of(phantom, site, pair.sheath_radius, pair.sheath_flare) if pair else vessel_of(phantom, site)
        self.devices = TwoDevices(vessel, pair, numerics) if pair else None
        chain = self.devices.chain if self.devices else wire
        assert chain is not None
        require_length(task, phantom, site, chain, alone=pair is not None and pair.wire is None)
        parts = model_parts(vessel, chain, numerics, tip_motors=tip_motors)
        self.arena = VesselArena(parts.arena, vessel, chain.length)
        if visual:
            self.arena.show(phantom)
        self.feeder = Feeder(parts.feeder, chain)
        self.guidewire = GuidewireEntity(parts.guidewire, chain)
        self.arena.attach(self.feeder, self.arena.feeder_site)
        self.feeder.attach(self.guidewire, self.feeder.wire_site)
        self.set_timesteps(control_timestep=CONTROL_STEP, physics_timestep=numerics.timestep)

        self._renderer = camera(phantom, image_size, chain.radius)
        self._actions = len(self.guidewire.motors) + 1 if tip_motors else 4 if pair and pair.both else 2
        self.steps = self._substep = 0
        self.force = np.zeros(3)
        self._tip_before = np.zeros(3)
        self._action = np.zeros(self._actions)
        self._reward = 0.0
        self.success = False
        self._observables = OrderedDict(
            image=Generic(lambda physics: self._draw(physics)[0]),
            mask=Generic(lambda physics: self._draw(physics)[1]),
            force=Generic(lambda physics: self.force.copy()),
        )
        if self.devices is not None:
            self._observables["devices"] = Generic(self._device_state)
        for name, entry_ in self._observables.items():
            entry_.enabled = name != "mask"
        for entity in (self.feeder, self.guidewire):
            entity.observables.enable_all()

    @property
    def root_entity(self) -> VesselArena:
        """The arena."""
        return self.arena

    @property
    def task_observables(self) -> OrderedDict[str, Generic]:
        """`image` and `mask` (1, size, size) uint8, as `NavigateEnv` gives them, and `force` (3,) N.

        With a catheter also `devices` (2, 2), insertion (m) and angle of the hub (rad) of wire and catheter. The mask
        is off until its `enabled` is set.
        """
        return OrderedDict(self._observables)

    def after_compile(self, physics: mjcf.Physics, random_state: np.random.RandomState) -> None:
        """Joins the devices with the new model."""
        super().after_compile(physics, random_state)
        if self.devices is not None:
            self.devices.join(physics)

    def _device_state(self, physics: mjcf.Physics) -> np.ndarray:
        assert self.devices is not None
        return self.devices.state(self._fed(physics))

    def _fed(self, physics: mjcf.Physics) -> float:
        return float(np.asarray(physics.bind(self.feeder.joints).qpos)[0])

    def _draw(self, physics: mjcf.Physics) -> tuple[np.ndarray, np.ndarray]:
        points = outside_sheath(self.guidewire.nodes(physics), self.arena.vessel)
        image = np.empty(self._renderer.shape, np.uint8)
        mask = np.empty(self._renderer.shape, np.uint8)
        self._renderer.render_into(points, image, mask)
        return image[None], mask[None] * np.uint8(255)

    def action_spec(self, physics: mjcf.Physics) -> specs.BoundedArray:
        """-1 to 1: translation (2 mm) and rotation (15 degrees), of the wire, then of the catheter.

        With motors in the tip: theirs, then the translation.
        """
        return specs.BoundedArray((self._actions,), np.float64, -1.0, 1.0, name="action")

    def initialize_episode(self, physics: mjcf.Physics, random_state: np.random.RandomState) -> None:
        """Puts the wire straight into the sheath and lets its tip unbend for 0.3 s."""
        generator = np.random.default_rng(int(random_state.randint(2**31)))
        insertion, rotation = self.task.draw_start(generator)
        if self.devices is not None:
            insertion = self.devices.place(*self.task.draw_devices((insertion, rotation), self.devices.pair, generator))
        self.feeder.place(physics, insertion, rotation)
        for _ in range(SETTLE_STEPS * self.physics_steps_per_control_step):
            self.feeder.drive(physics, 1.0)
            if self.devices is not None:
                self.devices.update(physics, 1.0)
            mujoco.mj_step(physics.model.ptr, physics.data.ptr)
        physics.data.time = 0.0
        physics.forward()
        self.steps, self.success = 0, False
        self.force[:] = 0.0
        self._tip_before = self._tip(physics)
        self._goal.progress(self._tip_before)

    def before_step(self, physics: mjcf.Physics, action: np.ndarray, random_state: np.random.RandomState) -> None:
        """Hands the action to the feeder and the motors.

        Raises:
            ValueError: the action has another shape or is not finite.
        """
        action = np.asarray(action, float)
        if action.shape != (self._actions,):
            raise ValueError(f"expected an action of shape {(self._actions,)}, got {action.shape}")
        if not np.isfinite(action).all():
            raise ValueError(f"expected a finite action, got {action.tolist()}")
        self._action = action = action.clip(-1.0, 1.0)
        if self.guidewire.motors:
            self.feeder.command(physics, TRANSLATION_STEP * action[-1], 0.0)
            self.guidewire.bend(physics, action[:-1])
        else:
            scaled = action * np.tile((TRANSLATION_STEP, ROTATION_STEP), self._actions // 2)
            move, catheter = (float(scaled[0]), float(scaled[1])), (float(scaled[-2]), float(scaled[-1]))
            if self.devices is not None:
                move = self.devices.command(self._fed(physics), move, catheter, self.feeder.reach(physics))
            self.feeder.command(physics, *move)
        self._substep = 0
        self.force[:] = 0.0

    def before_substep(self, physics: mjcf.Physics, action: np.ndarray, random_state: np.random.RandomState) -> None:
        """Moves the servos' targets at constant speed."""
        self._substep += 1
        share = self._substep / self.physics_steps_per_control_step
        self.feeder.drive(physics, share)
        if self.devices is not None:
            self.devices.update(physics, share)

    def after_substep(self, physics: mjcf.Physics, random_state: np.random.RandomState) -> None:
        """Keeps the largest resultant contact force of the step."""
        force = self.arena.contacts(physics).forces.sum(axis=0)
        if force @ force > self.force @ self.force:
            self.force[:] = force

    def after_step(self, physics: mjcf.Physics, random_state: np.random.RandomState) -> None:
        """Computes reward, success and the end of the episode."""
        model, data = physics.model.ptr, physics.data.ptr
        if self.devices is not None:
            self.devices.hubs.arrive()
        invalid = not np.isfinite(data.qpos).all()
        if invalid:
            mujoco.mj_resetData(model, data)  # the episode ends here; so that its last observation is at least finite
        mujoco.mj_kinematics(model, data)  # poses of the state that the step has reached
        self.steps += 1
        tip, moved_from = self._tip(physics), self._tip_before
        self._tip_before = tip
        arrival = self._goal.arrival(tip)
        self.success = arrival.success and not invalid
        progress = self._goal.progress(tip)
        force = float(np.linalg.norm(self.force))
        moved = float(np.linalg.norm(tip - moved_from))
        fed = np.asarray(physics.bind(self.feeder.joints).qpos).tolist()
        info = arrival.info(tip, fed, force, self.force.copy(), success=self.success, invalid=invalid)
        if self.devices is not None:
            info |= self.devices.info(fed[0])
        self._reward = self.task.reward_of(info, progress, moved, self._action, success=self.success)

    def _tip(self, physics: mjcf.Physics) -> np.ndarray:
        return np.array(physics.bind(self.guidewire.tip_site).xpos)

    def get_reward(self, physics: mjcf.Physics) -> float:
        """Reward of the step, as `NavigationTask.reward_of` gives it."""
        return self._reward

    def should_terminate_episode(self, physics: mjcf.Physics) -> bool:
        """Whether the target is reached or the steps are used up."""
        return self.success or self.steps >= self.task.max_steps

    def get_discount(self, physics: mjcf.Physics) -> float:
        """0 at the target; 1 otherwise, so that an episode that ran out of steps counts as truncated."""
        return 0.0 if self.success else 1.0


def load(
    phantom: str | Phantom = "type_1",
    target: TargetLike | None = None,
    *,
    seed: int | None = None,
    entry: EntryLike = "descending",
    wire: str | Guidewire | None = "default",
    catheter: str | Catheter | None = None,
    torsion: str = "elastic",
    actions: str = "feeder",
    image_size: int = 80,
    numerics: str | Accuracy = STEPPING,
    phantom_seed: int | None = None,
    visual: bool = False,
    task: NavigationTask | None = None,
    **task_fields: Any,
) -> composer.Environment:
    """Makes the environment; arguments are those of `NavigateEnv`, except for these.

    Args:
        seed: of the starts; the same seed gives the same episodes to the same actions.
        visual: with the lumen's surface and a camera for `environment.physics.render(camera_id="frontal")`.
        task: the task, a `NavigationTask` or of a subclass.
        task_fields: fields of the task, over its own; a function as `reward` gets no `feeder_forces`.

    Returns:
        The environment. It does not compile its model again at a reset; should the state become invalid, the episode
        ends with reward 0 and discount 0.

    Raises:
        ValueError: an unknown name or field.
    """
    if actions not in ACTIONS:
        raise ValueError(f"unknown actions '{actions}'; there are {', '.join(ACTIONS)}")
    navigate = NavigateTask(
        load_phantom(phantom, seed=phantom_seed) if isinstance(phantom, str) else phantom,
        resolve_wire(wire),
        navigation_task(target, task_fields, task),
        entry=entry,
        tip_motors=actions == "tip_motors",
        catheter=resolve_catheter(catheter),
        torsion=torsion,
        image_size=image_size,
        numerics=numerics,
        visual=visual,
    )
    return composer.Environment(
        navigate,
        random_state=seed,
        raise_exception_on_physics_error=False,
        strip_singleton_obs_buffer_dim=True,
        recompile_mjcf_every_episode=False,
        legacy_step=False,  # MuJoCo's discrete integrator is not made for split steps
    )
