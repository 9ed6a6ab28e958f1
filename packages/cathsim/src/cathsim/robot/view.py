"""The follower robot in a picture: its shapes placed behind the introducer sheath, in line with the wire."""

from __future__ import annotations

import mujoco
import numpy as np

from cathsim.robot.follower import FollowerRobot

GAP = 0.012  # between the sheath's hub and the robot's front, m


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


def add_robot(
    scene: mujoco.MjvScene, robot: FollowerRobot, entry: np.ndarray, direction: np.ndarray, colour: tuple[float, ...]
) -> None:
    """Adds the robot and the wire that runs through it to a scene that MuJoCo has updated.

    Args:
        entry: end of the sheath in the vessel, m. Shape (3,).
        direction: unit vector into the vessel. Shape (3,).
        colour: of the wire, red, green, blue and opacity.

    Raises:
        RuntimeError: the scene has no room left.
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
    mujoco.mjv_initGeom(wire, capsule, np.ones(3), np.zeros(3), np.eye(3).ravel(), np.array(colour, np.float32))
    rear = origin - (robot.settings.length + 0.010) * rotation[:, 2]
    mujoco.mjv_connector(wire, capsule.value, 0.9e-3, rear, np.asarray(entry, float))
    scene.ngeom += 1
