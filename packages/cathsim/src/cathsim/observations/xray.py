"""X-ray images as observations: noisy images of an environment, and the contrast run before its episodes.

The view is frontal, or there are several (`cathsim.fluoroscopy.projector.VIEWS`), as of a bi-planar fluoroscope; what
they hold says `cathsim.observations.framing`. Before an episode there is a contrast run: an image of the vessels
without wire or contrast medium, and one with contrast medium. While the wire moves, its images have neither. Nothing
else shows where the wire is. Clutter, where it is asked for, stands still for an episode and its contrast run. What the
vessels lie in is a water bath, or an X-ray background such as a patient's CT (`cathsim.fluoroscopy.ct_scene`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy import Phantom
from cathsim.devices.catheter import Catheter
from cathsim.environment import NavigateEnv
from cathsim.fluoroscopy import PAIRS, BiplaneFluoroscope, DetectorDistortion, XRayScene, scene, wire_material
from cathsim.fluoroscopy.c_arms import XRayCamera
from cathsim.fluoroscopy.projector import VIEWS
from cathsim.fluoroscopy.radiograph import expose_depth, optical_depth
from cathsim.lifetime_cache import kept_with_owner
from cathsim.many_anatomies import NavigateManyEnv
from cathsim.observations.fluoroscopes import catheter_in, frame_of, material_of, wire_radius_of
from cathsim.observations.framing import arch_centre, framed, raised_bath, require_field
from cathsim.observations.observables import DOT_SHARE, LEAST_DOT
from cathsim.observations.roadmap import target_image
from cathsim.validation import require_saved

VIEW = "frontal"
RUN_FRAMES = 16  # of the contrast run before the contrast medium comes, about a second: their mean has less noise
_SAVED = {"environment", "generator", "noise", "step", "pictures", "dots", "clutter"}  # of a saved moment
MOVING, FILLED = "fluid", "contrast"  # fillings of the lumen: while the devices move, and in the contrast run

Clutter = NDArray[np.float32]  # (size, size), attenuation of what lies before or behind the scene
DrawClutter = Callable[[np.random.Generator, int], Clutter]  # from a generator, for a side in px


class ContrastRun(NamedTuple):
    """Two images of a view from before an episode. Shapes (1, size, size), uint8."""

    plain: NDArray[np.uint8]  # without wire or contrast medium, the mean of `RUN_FRAMES`
    contrast: NDArray[np.uint8]


def fluoroscope_of(
    phantom: Phantom,
    size: int,
    wire_radius: float,
    catheter: Catheter | None = None,
    view: str = VIEW,
    clutter: Clutter | None = None,
    field: float | None = None,
    background: XRayScene | None = None,
) -> BiplaneFluoroscope:
    """An X-ray camera over a phantom while the devices move.

    Args:
        size: side of the images, px.
        wire_radius: m.
        catheter: over the wire, or None.
        view: one of `cathsim.fluoroscopy.projector.VIEWS`.
        clutter: (size, size) attenuation; None: there is none. With clutter the camera is made anew at each call.
        field: as of `cathsim.observations.framing.framed`.
        background: X-ray background of the vessels; None: a water bath.
    """
    shot = _Shot(size, wire_radius, view, field, background)
    if clutter is None:
        return _fluoroscope(phantom, shot, MOVING) if catheter is None else _with_catheter(phantom, shot, catheter)
    bare = _among(clutter, phantom, shot, MOVING)
    return bare if catheter is None else bare.with_catheter(material_of(catheter))


class _Shot(NamedTuple):
    """How an image is taken; see `fluoroscope_of`."""

    size: int
    wire_radius: float
    view: str
    field: float | None
    background: XRayScene | None

    def scene(self, filling: str) -> XRayScene:
        """What is in the way of the rays."""
        return scene("bath", filling) if self.background is None else self.background.filled(filling)

    def camera(self, phantom: Phantom) -> XRayCamera:
        """The camera: light, blur and noise of the navigation's first one."""
        detector = PAIRS["guide3d"](phantom.bounds.mean(axis=0), self.size)[0].detector
        projector = framed(phantom, self.view, self.size, self.field)
        return XRayCamera(projector, DetectorDistortion.none(self.size, self.size), detector)


@kept_with_owner
def _with_catheter(phantom: Phantom, shot: _Shot, catheter: Catheter) -> BiplaneFluoroscope:
    return _fluoroscope(phantom, shot, MOVING).with_catheter(material_of(catheter))


@kept_with_owner
def _fluoroscope(phantom: Phantom, shot: _Shot, filling: str) -> BiplaneFluoroscope:
    return _seeing(_depth(phantom, shot, filling), phantom, shot, filling)


def _among(clutter: Clutter, phantom: Phantom, shot: _Shot, filling: str) -> BiplaneFluoroscope:
    """As `_fluoroscope`, with clutter in the way: automatic brightness and scatter are those of all together."""
    size = shot.size
    if clutter.shape != (size, size):
        raise ValueError(f"clutter must have shape ({size}, {size}), that of the images, got {clutter.shape}")
    return _seeing(_depth(phantom, shot, filling) + clutter, phantom, shot, filling)


def _seeing(depth: NDArray[np.float32], phantom: Phantom, shot: _Shot, filling: str) -> BiplaneFluoroscope:
    """A camera behind an optical depth."""
    camera = shot.camera(phantom)
    still = expose_depth(camera, shot.scene(filling), lambda projector: depth)
    material = wire_material("default", shot.wire_radius)
    centre = phantom.bounds.mean(axis=0) if shot.field is None else arch_centre(phantom, shot.field)
    return BiplaneFluoroscope([camera], [still], material=material, centre=centre)


def _depth(phantom: Phantom, shot: _Shot, filling: str) -> NDArray[np.float32]:
    return _kept_depth(phantom, shot._replace(wire_radius=0.0), filling)  # the same whatever the wire


@kept_with_owner
def _kept_depth(phantom: Phantom, shot: _Shot, filling: str) -> NDArray[np.float32]:
    raised = 0.0 if shot.field is None or shot.background is not None else raised_bath(phantom, shot.field)
    return optical_depth(phantom.grid, shot.camera(phantom).projector, shot.scene(filling), raised)


def contrast_run(
    phantom: Phantom,
    size: int,
    wire_radius: float,
    clutter: Clutter | None = None,
    view: str = VIEW,
    field: float | None = None,
    background: XRayScene | None = None,
) -> ContrastRun:
    """The images before an episode, with a noise of the phantom's own.

    Args:
        size: side of the images, px.
        wire_radius: m, of the wire that is not in them.
        clutter, view, field, background: as of `fluoroscope_of`.
    """
    shot = _Shot(size, wire_radius, view, field, background)
    if clutter is None:
        return _clean_run(phantom, shot)
    moving, filled = (_among(clutter, phantom, shot, one) for one in (MOVING, FILLED))
    return _run(phantom, moving, filled, view)


@kept_with_owner
def _clean_run(phantom: Phantom, shot: _Shot) -> ContrastRun:
    moving, filled = (_fluoroscope(phantom, shot, one) for one in (MOVING, FILLED))
    return _run(phantom, moving, filled, shot.view)


def _run(phantom: Phantom, moving: BiplaneFluoroscope, filled: BiplaneFluoroscope, view: str) -> ContrastRun:
    nothing, generator = np.empty((0, 3)), np.random.default_rng(int(phantom.hash[:8], 16))
    before, full = (one.render(nothing, generator)[view].image for one in (moving, filled))
    further = [moving.render(nothing, generator)[view].image for _ in range(RUN_FRAMES - 1)]
    plain = np.rint(np.mean([before, *further], axis=0)).astype(np.uint8)
    return ContrastRun(plain[None], full[None])


class XrayEnvironment(gymnasium.Env[Any, np.ndarray]):
    """An environment with X-ray images among its observations: `image`, `plain` and `contrast`, (n, size, size) uint8,
    one after the other the n views. Unless it is the frontal one alone, without a field, `goal_image` is the target's
    dot in each of them, too.

    The noise of an image depends on the seed of the reset, on the step and on the view's place.

    Args:
        environment: with a dictionary of observations, none of them of these names.
        size: side of the images, px.
        with_mask: also `mask`, the devices' pixels in `image`, for a segmenter to learn from; with a catheter also
            `mask_wire` and `mask_catheter`.
        clutter: draws the clutter of each episode and view; None: there is none.
        views: names of `cathsim.fluoroscopy.projector.VIEWS`.
        field: of the views, m, as of `cathsim.observations.framing.framed`.
        background: X-ray background of every episode, as `cathsim.fluoroscopy.ct_scene` makes of the CT of the one
            anatomy; None: a water bath.
        every: steps between two images, as with pulsed fluoroscopy; in between the observations keep the last one.
            The images that are drawn, at the reset and after every so many steps, are the same as with 1.

    Raises:
        ValueError: `every` is not a positive whole number; no view, one twice, or an unknown one; a field that is no
            positive length; an environment whose observation is a single array.
    """

    def __init__(
        self,
        environment: NavigateEnv | NavigateManyEnv,
        size: int,
        *,
        with_mask: bool = False,
        clutter: DrawClutter | None = None,
        views: Sequence[str] = (VIEW,),
        field: float | None = None,
        background: XRayScene | None = None,
        every: int = 1,
    ) -> None:
        if not isinstance(every, int) or every < 1:
            raise ValueError(f"every must be a whole number of steps, at least 1, got {every!r}")
        if not views or len(set(views)) < len(views) or not set(views) <= set(VIEWS):
            raise ValueError(f"views must be some of {', '.join(VIEWS)}, each once, got {', '.join(views) or 'none'}")
        require_field(field)
        self.environment, self.size, self.draw_clutter, self.every = environment, size, clutter, every
        self.views, self.field, self.background = tuple(views), field, background
        # The episode's clutter, one per view; None where there is no clutter.
        self._clutter: list[Clutter | None] | None = None
        self._cluttered_runs: list[tuple[BiplaneFluoroscope, ContrastRun]] | None = None
        if not isinstance(environment.observation_space, gymnasium.spaces.Dict):
            raise ValueError("an environment with X-ray images has a dictionary of observations: name them in a tuple")
        masks = ("mask",) if catheter_in(environment.simulation) is None else ("mask", "mask_wire", "mask_catheter")
        self._masks = masks if with_mask else ()
        dots = ("goal_image",) if self._draws_dots else ()
        names = ("image", "plain", "contrast", *self._masks, *dots)
        picture = gymnasium.spaces.Box(0, 255, (len(self.views), size, size), np.uint8)
        self.observation_space = gymnasium.spaces.Dict(
            {**environment.observation_space.spaces, **dict.fromkeys(names, picture)}
        )
        self.action_space = environment.action_space
        self.render_mode, self.metadata = environment.render_mode, environment.metadata
        self._noise, self._step = 0, 0
        self._pictures: dict[str, NDArray[np.uint8]] = {}
        self._dots: dict[str, NDArray[np.uint8]] = {}

    def __getattr__(self, name: str) -> Any:
        """Whatever else an environment has: its simulation, phantom and task."""
        if name == "environment":
            raise AttributeError(name)
        return getattr(self.environment, name)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Starts an episode, as the environment does."""
        super().reset(seed=seed)
        self._noise, self._step = int(self.np_random.integers(2**63)), 0
        observation, info = self.environment.reset(seed=seed, options=options)
        if self.draw_clutter is not None:
            self._put_among([self.draw_clutter(self.np_random, self.size) for _ in self.views])
        self._dots = self._drawn_dots() if self._draws_dots else {}
        return self._seen(observation), info

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Advances by one control step."""
        observation, reward, terminated, truncated, info = self.environment.step(action)
        self._step += 1
        return self._seen(observation), reward, terminated, truncated, info

    def observe(self) -> dict[str, Any]:
        """The observation of the moment, with the last images."""
        return self._with_pictures(self.environment.observe())

    def render(self) -> np.ndarray | None:
        """As the environment's."""
        return self.environment.render()

    def state(self) -> dict[str, Any]:
        """Everything that the rest of the episode depends on, to be pickled; for `restore`."""
        return {
            "environment": self.environment.state(),
            "generator": self.np_random.bit_generator.state,
            "noise": self._noise,
            "step": self._step,
            "pictures": {name: picture.copy() for name, picture in self._pictures.items()},
            "dots": {name: dot.copy() for name, dot in self._dots.items()},
            "clutter": None if self._clutter is None else list(self._clutter),
        }

    def restore(self, state: dict[str, Any]) -> dict[str, Any]:
        """Goes on where an environment with the same arguments was saved by `state`; returns the observation.

        Raises:
            ValueError: `state` gave no such dictionary.
        """
        require_saved(state, _SAVED)
        observation = self.environment.restore(state["environment"])
        self.np_random.bit_generator.state = state["generator"]
        self._noise, self._step = state["noise"], state["step"]
        self._pictures, self._dots = dict(state["pictures"]), dict(state["dots"])
        self._put_among(state["clutter"])
        return self._with_pictures(observation)

    def _put_among(self, clutter: list[Clutter | None] | None) -> None:
        self._clutter = clutter
        pairs = None if clutter is None else zip(self.views, clutter, strict=True)
        self._cluttered_runs = None if pairs is None else [self._seen_by(view, one) for view, one in pairs]

    @property
    def _draws_dots(self) -> bool:
        """Whether the target's dot is drawn here: the environment's own is that of the whole frontal view."""
        return self.views != (VIEW,) or self.field is not None

    def _drawn_dots(self) -> dict[str, NDArray[np.uint8]]:
        phantom, radius = self.environment.phantom, max(DOT_SHARE * self.size, LEAST_DOT)
        goal = self.environment.task.goal(phantom)[None]
        seen = (framed(phantom, view, self.size, self.field).project(goal)[0] for view in self.views)
        return {"goal_image": np.stack([target_image(pixel, self.size, radius) for pixel in seen])}

    def _seen_by(self, view: str, clutter: Clutter | None) -> tuple[BiplaneFluoroscope, ContrastRun]:
        simulation, phantom = self.environment.simulation, self.environment.phantom
        radius, catheter = wire_radius_of(simulation), catheter_in(simulation)
        fluoroscope = fluoroscope_of(phantom, self.size, radius, catheter, view, clutter, self.field, self.background)
        return fluoroscope, contrast_run(phantom, self.size, radius, clutter, view, self.field, self.background)

    def _seen(self, observation: dict[str, Any]) -> dict[str, Any]:
        if self._step % self.every == 0:
            self._pictures = self._drawn() | self._dots
        return self._with_pictures(observation)

    def _with_pictures(self, observation: dict[str, Any]) -> dict[str, Any]:
        # copies: those of the contrast run are shared by all episodes
        return {**observation, **{name: picture.copy() for name, picture in self._pictures.items()}}

    def _drawn(self) -> dict[str, NDArray[np.uint8]]:
        view_runs = self._cluttered_runs or [self._seen_by(view, None) for view in self.views]
        each = [self._drawn_in(place, *view_run) for place, view_run in enumerate(view_runs)]
        return each[0] if len(each) == 1 else {name: np.concatenate([one[name] for one in each]) for name in each[0]}

    def _drawn_in(self, place: int, fluoroscope: BiplaneFluoroscope, run: ContrastRun) -> dict[str, NDArray[np.uint8]]:
        generator = np.random.default_rng((self._noise, self._step, place) if place else (self._noise, self._step))
        frame = frame_of(self.environment.simulation, fluoroscope, generator, self.views[place])
        masks = {name: getattr(frame, name)[None] * np.uint8(255) for name in self._masks}
        return {"image": frame.image[None], "plain": run.plain, "contrast": run.contrast, **masks}

    def close(self) -> None:
        """Frees the renderer."""
        self.environment.close()
