"""A 3-D picture of the devices in the vessel, for people; needs EGL or OSMesa."""

from __future__ import annotations

import itertools
import os
import sys
from typing import Any

import mujoco
import numpy as np

from cathsim.anatomy import Phantom
from cathsim.devices.simulation import DualSimulation
from cathsim.fluoroscopy.curve import smooth_curve
from cathsim.robot.follower import FollowerRobot
from cathsim.simulation import Simulation

GAP = 0.012  # between the sheath's hub and the robot's front, m


WALL = (0.82, 0.36, 0.34, 0.28)
WIRE = (0.10, 0.10, 0.12, 1.0)
CATHETER = (0.15, 0.45, 0.95, 0.30)
MARKER = (0.95, 0.65, 0.05, 0.65)
TARGET = (0.10, 0.62, 0.28, 0.75)
SHOWN_RADIUS = 0.9e-3  # a wire alone is drawn twice as thick as it is, m; two devices have their own radii
SHOWN_SHEATH = 0.030  # this much of a device in the sheath is drawn, m
PIECE = 1.5e-3  # of two devices' smooth curves, m
_CELL_PX = 2.5  # of a picture: what is smaller of the lumen's surface is drawn as one vertex


def robot_pose(entry: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where the robot stands in the world, for a sheath that ends at (3,) m and opens in a unit direction (3,).

    Returns:
        Origin of the robot's frame, m, shape (3,), and rotation from that frame to the world, shape (3, 3); the rail
        lies as far to the patient's back as the wire's direction allows.
    """
    forward = np.asarray(direction, float)
    back = np.array([0.0, 1.0, 0.0]) - forward[1] * forward
    if np.linalg.norm(back) < 1e-3:  # the wire comes from the front: any side will do
        back = np.array([0.0, 0.0, 1.0]) - forward[2] * forward
    back /= np.linalg.norm(back)
    rotation = np.column_stack((np.cross(back, forward), back, forward))
    return np.asarray(entry, float) - GAP * forward, rotation


def add_robot(scene: mujoco.MjvScene, robot: FollowerRobot, entry: np.ndarray, direction: np.ndarray) -> None:
    """Adds the robot and the wire that runs through it to a scene that MuJoCo has updated.

    Args:
        entry: end of the sheath in the vessel, m. Shape (3,).
        direction: unit vector into the vessel. Shape (3,).

    Raises:
        RuntimeError: the scene cannot hold more geoms.
    """
    model, data = robot.model, robot.data
    origin, rotation = robot_pose(entry, direction)
    mujoco.mj_kinematics(model, data)
    if scene.ngeom + model.ngeom + 1 > scene.maxgeom:
        raise RuntimeError(f"the picture holds at most {scene.maxgeom} shapes")
    for index in range(model.ngeom):
        mujoco.mjv_initGeom(
            scene.geoms[scene.ngeom],
            int(model.geom_type[index]),
            model.geom_size[index],
            origin + rotation @ data.geom_xpos[index],
            (rotation @ data.geom_xmat[index].reshape(3, 3)).ravel(),
            model.geom_rgba[index],
        )
        scene.ngeom += 1
    wire = scene.geoms[scene.ngeom]
    capsule = mujoco.mjtGeom.mjGEOM_CAPSULE
    mujoco.mjv_initGeom(wire, capsule, np.ones(3), np.zeros(3), np.eye(3).ravel(), np.array(WIRE, np.float32))
    rear = origin - (robot.settings.length + 0.010) * rotation[:, 2]
    mujoco.mjv_connector(wire, capsule.value, 0.9e-3, rear, np.asarray(entry, float))
    scene.ngeom += 1


class RenderingUnavailableError(RuntimeError):
    """No OpenGL library for drawing without a screen was found."""


def open_context(width: int, height: int) -> Any:
    """An OpenGL context without a window: what MUJOCO_GL names, else EGL, else OSMesa.

    Raises:
        RenderingUnavailableError: none works here.
    """
    choice = os.environ.get("MUJOCO_GL", "").lower()
    names = (
        [choice] if choice in ("egl", "osmesa", "glfw") else ["egl", "osmesa"] if sys.platform == "linux" else ["glfw"]
    )
    reasons = []
    for name in names:
        os.environ["PYOPENGL_PLATFORM"] = name if name != "glfw" else ""
        try:
            module = __import__(f"mujoco.{name}", fromlist=["GLContext"])
            context = module.GLContext(width, height)
            context.make_current()
        except Exception as error:  # the bindings raise ImportError, AttributeError, OSError, RuntimeError, …
            reasons.append(f"{name}: {error}")
            for loaded in [key for key in sys.modules if key == "OpenGL" or key.startswith("OpenGL.")]:
                del sys.modules[loaded]
        else:
            return context
    raise RenderingUnavailableError(
        "3-D pictures need EGL or OSMesa and neither works; install one (Debian: apt install libegl1 libgl1-mesa-dri, "
        f"or libosmesa6), or use render_mode='fluoroscopy', which needs neither ({'; '.join(reasons)})"
    )


class View:
    """Draws a simulation from the front, the patient's head up.

    Args:
        width: px.
        height: px.
        azimuth_deg: from where it is seen; 90 is the front, 180 the patient's left.
        elevation_deg: how far from above (negative) or below.
        robot: the follower robot that feeds the wire, drawn behind the sheath.
    """

    def __init__(
        self,
        phantom: Phantom,
        *,
        width: int = 480,
        height: int = 640,
        azimuth_deg: float = 90.0,
        elevation_deg: float = 0.0,
        robot: FollowerRobot | None = None,
    ) -> None:
        self._context = open_context(width, height)
        self._model = _wall_model(phantom, width, height)
        self._data = mujoco.MjData(self._model)
        mujoco.mj_forward(self._model, self._data)
        self._scene = mujoco.MjvScene(self._model, maxgeom=2000)
        self._render_context = mujoco.MjrContext(self._model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._render_context)
        self._camera = mujoco.MjvCamera()
        low, high = phantom.bounds
        self._robot = robot
        if robot is not None:
            low = low - [0.0, 0.0, robot.settings.length + 0.02]
        self._camera.lookat[:] = (low + high) / 2
        self._camera.azimuth, self._camera.elevation = azimuth_deg, elevation_deg
        self._camera.distance = (1.25 if robot is None else 1.35) * float(high[2] - low[2])
        self._viewport = mujoco.MjrRect(0, 0, width, height)

    def render(self, simulation: Simulation, goal: np.ndarray | None = None) -> np.ndarray:
        """The picture of the moment, (height, width, 3) uint8, with the target (3,) m marked."""
        self._context.make_current()
        option, scene = mujoco.MjvOption(), self._scene
        mujoco.mjv_updateScene(
            self._model, self._data, option, None, self._camera, mujoco.mjtCatBit.mjCAT_ALL.value, scene
        )
        if isinstance(simulation, DualSimulation) and simulation.pair.catheter is not None:
            self._add_devices(simulation)
        else:
            self._add_rod(_seen(simulation, simulation.wire_points()), WIRE, SHOWN_RADIUS)
        if self._robot is not None:
            add_robot(scene, self._robot, simulation.vessel.entry, simulation.vessel.direction)
        if goal is not None:
            self._add(mujoco.mjtGeom.mjGEOM_SPHERE, TARGET, size=0.003, position=goal)
        mujoco.mjr_render(self._viewport, scene, self._render_context)
        picture = np.empty((self._viewport.height, self._viewport.width, 3), np.uint8)
        mujoco.mjr_readPixels(picture, None, self._viewport, self._render_context)
        return picture[::-1].copy()

    def _add_devices(self, simulation: DualSimulation) -> None:
        """A wire in its translucent catheter, whose marker has a colour of its own; all of their own radii."""
        wire, catheter = simulation.pair.wire, simulation.pair.catheter
        assert catheter is not None
        if wire is not None:
            points, _ = smooth_curve(simulation.device_points("wire"), PIECE)
            self._add_rod(_seen(simulation, points), WIRE, wire.radius)
        points, arcs = smooth_curve(simulation.device_points("catheter"), PIECE)
        ends = int(np.searchsorted(arcs, catheter.marker_length)) if catheter.marker_length else 0
        for part, colour in ((points[: ends + 1], MARKER), (points[ends:], CATHETER)):
            self._add_rod(_seen(simulation, part), colour, catheter.radius, mujoco.mjtGeom.mjGEOM_CYLINDER)

    def _add_rod(
        self,
        points: np.ndarray,
        colour: tuple[float, ...],
        radius: float,
        kind: mujoco.mjtGeom = mujoco.mjtGeom.mjGEOM_CAPSULE,
    ) -> None:
        """Capsules along nodes (n, 3) m; cylinders, which do not overlap, where they are translucent."""
        for start, end in itertools.pairwise(points):
            self._add(kind, colour)
            mujoco.mjv_connector(self._scene.geoms[self._scene.ngeom - 1], kind.value, radius, start, end)

    def _add(
        self,
        kind: mujoco.mjtGeom,
        colour: tuple[float, ...],
        *,
        size: float = SHOWN_RADIUS,
        position: np.ndarray | None = None,
    ) -> None:
        scene = self._scene
        if scene.ngeom >= scene.maxgeom:
            raise RuntimeError(f"the picture holds at most {scene.maxgeom} shapes")
        place = np.zeros(3) if position is None else np.asarray(position, float)
        mujoco.mjv_initGeom(
            scene.geoms[scene.ngeom], kind, np.full(3, size), place, np.eye(3).ravel(), np.array(colour, np.float32)
        )
        scene.ngeom += 1

    def close(self) -> None:
        """Frees the OpenGL context."""
        self._render_context.free()
        self._context.free()


def _seen(simulation: Simulation, points: np.ndarray) -> np.ndarray:
    """Those of a device's nodes (n, 3) m that do not lie deep in the sheath."""
    along = (points - simulation.vessel.entry) @ simulation.vessel.direction
    seen = np.flatnonzero(along > -SHOWN_SHEATH)
    return points[: seen[-1] + 1] if len(seen) else points[:0]


def _drawn_surface(phantom: Phantom, height: int) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n, 3) m and faces (m, 3) of the lumen, as fine as a picture so high shows, which is drawn the sooner.

    Vertices in one cell of a lattice become one; a cell is 2.5 pixels, and less than the narrowest radius.
    """
    mesh = phantom.lumen_mesh
    low, high = phantom.bounds
    narrowest = min(float(np.min(branch.radius)) for branch in phantom.tree)
    cell = max(min(_CELL_PX * float(high[2] - low[2]) / height, 0.7 * narrowest), 1e-6)
    _, place = np.unique(np.floor(mesh.vertices / cell).astype(np.int64), axis=0, return_inverse=True)
    place = place.ravel()
    vertices = np.stack([np.bincount(place, axis) for axis in mesh.vertices.T], axis=1) / np.bincount(place)[:, None]
    faces = place[mesh.faces]
    a, b, c = faces.T
    return vertices, faces[(a != b) & (b != c) & (a != c)]


def _wall_model(phantom: Phantom, width: int, height: int) -> mujoco.MjModel:
    vertices, faces = _drawn_surface(phantom, height)
    spec = mujoco.MjSpec()
    spec.visual.global_.offwidth, spec.visual.global_.offheight = width, height
    spec.visual.quality.shadowsize = 0
    spec.visual.headlight.ambient = [0.45, 0.45, 0.45]
    spec.visual.headlight.diffuse = [0.55, 0.55, 0.55]
    spec.visual.headlight.specular = [0.25, 0.25, 0.25]
    spec.visual.map.znear, spec.visual.map.zfar = 0.01, 10.0
    spec.stat.extent = 0.3
    spec.stat.center = phantom.bounds.mean(axis=0)
    spec.add_mesh(
        name="lumen",
        uservert=np.asarray(vertices, np.float32).ravel(),
        userface=np.asarray(faces, np.int32).ravel(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
    )
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT,
        rgb1=[0.97, 0.97, 0.98],
        rgb2=[0.97, 0.97, 0.98],
        width=16,
        height=96,
    )
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_MESH, meshname="lumen", rgba=WALL, contype=0, conaffinity=0, group=0
    )
    return spec.compile()
