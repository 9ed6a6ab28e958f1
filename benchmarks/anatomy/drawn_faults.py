"""What people's meshes have: cuts, walls, parts, other vessels; each a change of a drawn arch.

What each fault is, `surface_faults.py` says.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import trimesh

from benchmarks.anatomy.drawn_arch import Drawn, add, ball, cut_vessel, line, tube
from cathsim.anatomy.surface import open_ends
from cathsim.anatomy.vessel_tree import nearest_on_branch


def as_drawn(drawn: Drawn) -> None:
    """None."""


def stairs(drawn: Drawn) -> None:
    drawn.voxels = True


def opened(drawn: Drawn) -> None:
    drawn.opened = [(c - 2e-3 * n, n, r) for c, n, r in open_ends(drawn.tree)]


def extended(drawn: Drawn) -> None:
    for centre, normal, radius in open_ends(drawn.tree):
        add(drawn, line(centre, 3 * radius * normal), radius)
        drawn.opened.append((centre + (3 * radius - 1e-3) * normal, normal, radius))


def walled(drawn: Drawn) -> None:
    opened(drawn)
    drawn.wall = min(2e-3, 0.15 * float(drawn.tree.root.radius.mean()))


def pieces(drawn: Drawn) -> None:
    drawn.pieces = True


def segments(drawn: Drawn) -> None:
    drawn.segments = True


def islands(drawn: Drawn) -> None:
    low, high = drawn.phantom.bounds
    while len(drawn.apart) < 20:
        centre = drawn.generator.uniform(low, high)
        radius = float(drawn.generator.uniform(1e-3, 4e-3))
        if drawn.phantom.grid.sample(centre[None])[0] < -radius - 1e-3:
            drawn.apart.append(ball(centre, radius))


def calcified(drawn: Drawn) -> None:
    inner = drawn.phantom.grid.coordinates(drawn.phantom.grid.inside())
    depth = drawn.phantom.grid.sample(inner)
    inner, depth = inner[depth > 3e-3], depth[depth > 3e-3]
    for index in drawn.generator.integers(0, len(inner), 12):
        drawn.apart.append(ball(inner[index], min(3e-3, float(depth[index]) - 1.5e-3)))


def no_descending(drawn: Drawn) -> None:
    arc = drawn.ostia()[-1] + 25e-3
    cut_vessel(drawn, drawn.tree.root, drawn.from_heart(arc), beyond=False)


def no_ascending(drawn: Drawn) -> None:
    arc = max(drawn.ostia()[0] - 12e-3, 0.0)
    cut_vessel(drawn, drawn.tree.root, drawn.from_heart(arc), beyond=True)


def short(drawn: Drawn) -> None:
    aorta = drawn.tree.root
    top = float((aorta.points[:, 2] + aorta.radius).max()) + 20e-3
    drawn.cuts.append(lambda places: top - places[:, 2])


def stumps(drawn: Drawn) -> None:
    for branch in drawn.tree:
        if branch.parent == drawn.tree.root.name and branch.name != "sac":
            arc = drawn.tree.ostium_arc(branch.name) + 15e-3
            for child in drawn.tree:
                if branch.name in drawn.tree.ancestry(child.name):
                    start = arc if child.name == branch.name else arc - branch.length
                    if start < child.length:
                        cut_vessel(drawn, child, max(start, 0.0), beyond=True)


def abdominal(drawn: Drawn) -> None:
    centre, direction, radius = drawn.limb(1.0)
    down, side, front = np.array([0.0, 0.0, -1.0]), np.array([1.0, 0.0, 0.0]), np.array([0.0, -1.0, 0.0])
    start = centre + 1.6 * radius * direction
    add(drawn, line(centre, start - centre, 14 * radius * down), 0.8 * radius)
    add(drawn, line(start + 5 * radius * down, 2.5 * radius * front + 0.8 * radius * down), 0.35 * radius)
    for sign in (-1.0, 1.0):
        add(drawn, line(start + 7 * radius * down, 3 * sign * radius * side), 0.27 * radius)
        fork = radius * (2.5 * sign * side + 4 * down), radius * (1.7 * sign * side + 4 * down)
        add(drawn, line(start + 14 * radius * down, *fork), 0.45 * radius)


def coronaries(drawn: Drawn) -> None:
    centre, direction, radius = drawn.limb(8e-3 / drawn.tree.root.length)
    for sign in (-1.0, 1.0):
        across = np.array([0.6 * sign, -0.8, 0.0])
        across -= (across @ direction) * direction
        across /= np.linalg.norm(across)
        out, down = (0.2 * radius + 8e-3) * across, 9e-3 * across - 0.028 * direction
        add(drawn, line(centre + 0.8 * radius * across, out, down), 1.8e-3)


def sinuses(drawn: Drawn) -> None:
    centre, direction, radius = drawn.limb(0.04)
    first = np.cross(direction, [1.0, 0.3, 0.2])
    first /= np.linalg.norm(first)
    for angle in (0.0, 2 * np.pi / 3, 4 * np.pi / 3):
        across = np.cos(angle) * first + np.sin(angle) * np.cross(direction, first)
        drawn.added.append(ball(centre + 0.5 * radius * across, 0.8 * radius))
        drawn.low.append((centre + 1.4 * radius * across)[None])


def ventricle(drawn: Drawn) -> None:
    centre, direction, radius = drawn.limb(0.0)
    middle = centre - 1.4 * radius * direction
    drawn.added.append(ball(middle, 1.8 * radius))
    drawn.low.append(middle + 1.8 * radius * np.array([[-1.0] * 3, [1.0] * 3]))


def aneurysm(drawn: Drawn) -> None:
    centre, _, radius = drawn.limb(0.5 * (1 + drawn.ostia()[-1] / drawn.tree.root.length))
    drawn.added.append(ball(centre, 1.7 * radius))
    drawn.low.append(centre + 1.7 * radius * np.array([[-1.0] * 3, [1.0] * 3]))


def arms(drawn: Drawn) -> None:
    for name in ("rsa", "lsa"):
        if name in drawn.tree:
            branch = drawn.tree[name]
            side = np.array([-1.0 if name == "rsa" else 1.0, 0.0, 0.0])
            start, radius = branch.points[-1], float(branch.radius[-1])
            steps = 3 * radius * branch.tangents[-1], 9 * radius * side, radius * (7 * side - np.array([0, 0, 8.0]))
            add(drawn, line(start, *steps), radius)


def vertebrals(drawn: Drawn) -> None:
    for name in ("rsa", "lsa"):
        if name in drawn.tree:
            branch = drawn.tree[name]
            add(
                drawn,
                line(branch.point_at(0.6 * branch.length), np.array([0.0, 8e-3, 15e-3]), np.array([0, 0, 0.035])),
                1.8e-3,
            )


def rough(drawn: Drawn) -> None:
    def moved(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
        return trimesh.Trimesh(
            mesh.vertices + drawn.generator.normal(0, 0.3e-3, mesh.vertices.shape), mesh.faces, process=False
        )

    drawn.mesh.append(moved)


def holed(drawn: Drawn) -> None:
    def without(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
        centres = mesh.vertices[drawn.generator.integers(0, len(mesh.vertices), 10)]
        radii = drawn.generator.uniform(2e-3, 5e-3, 10)
        away = np.linalg.norm(mesh.triangles_center[:, None] - centres, axis=2)
        return trimesh.Trimesh(mesh.vertices, mesh.faces[(away > radii).all(axis=1)], process=False)

    drawn.mesh.append(without)


def doubled(drawn: Drawn) -> None:
    drawn.mesh.append(lambda mesh: trimesh.util.concatenate([mesh, mesh]))


def mixed(drawn: Drawn) -> None:
    def turned(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
        faces = mesh.faces.copy()
        some = drawn.generator.random(len(faces)) < 0.5
        faces[some] = faces[some][:, ::-1]
        return trimesh.Trimesh(mesh.vertices, faces, process=False)

    drawn.mesh.append(turned)


def shrunk(drawn: Drawn) -> None:
    drawn.mesh.append(lambda mesh: trimesh.smoothing.filter_laplacian(mesh, iterations=30))


def bridged(drawn: Drawn) -> None:
    names = [b.name for b in drawn.tree if b.parent is not None and b.name != "sac"]
    for name, other in pairwise(names):
        start = drawn.tree[name].point_at(drawn.tree[name].length / 2)
        end, _, _ = nearest_on_branch(drawn.tree[other], start[None])
        add(drawn, line(start, end[0] - start), 1.5e-3)


def vein(drawn: Drawn) -> None:
    aorta = drawn.tree.root
    top = aorta.points[aorta.points[:, 2].argmax()] + np.array([0.0, -12e-3, 12e-3])
    low, high = drawn.phantom.bounds
    inside = tube(line(np.array([low[0], *top[1:]]), np.array([high[0] - low[0], 0.0, 0.0])), 6e-3)
    drawn.apart.append(lambda places: np.minimum(inside(places), -drawn.phantom.grid.sample(places) - 1.5e-3))


def far(drawn: Drawn) -> None:
    drawn.shift = np.array([0.4, -0.3, -1.5])
    drawn.unit = 1.0


FAULTS: dict[str, Callable[[Drawn], None]] = {
    fault.__name__: fault
    for fault in (
        as_drawn, stairs, opened, extended, walled, pieces, segments, islands, calcified,
        no_descending, no_ascending, short, stumps, abdominal, coronaries, sinuses, ventricle,
        aneurysm, arms, vertebrals, rough, holed, doubled, mixed, shrunk, bridged, vein, far
    )
}  # fmt: skip
