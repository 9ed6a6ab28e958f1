"""A surface of an aortic arch drawn from its centrelines, with branches of any length, closed or cut open."""

import numpy as np
import trimesh

from cathsim.anatomy import Branch, VesselTree
from cathsim.anatomy.lumen import build_lumen
from cathsim.anatomy.surface import _cut, lumen_surface, open_ends

BOW, LIMB, WIDTH = 0.035, 0.06, 0.011  # m: radius of the bow, length of the descending limb, radius of the lumen
SIDES = {"lsa": (0.018, 5.0e-3), "lcca": (0.0, 4.0e-3), "bca": (-0.018, 6.0e-3)}  # x (m) and radius (m) of the branches


def arch_tree(stub: float, narrowed: float | None = None) -> VesselTree:
    """An arch with three straight branches, which stand out of its wall by `stub` m.

    The middle of the descending limb is narrowed to a radius (m) where one is given.
    """
    angle = np.linspace(0, np.pi, 111)
    bow = np.stack([BOW * np.cos(angle), 0 * angle, BOW * np.sin(angle)], axis=1)
    limb = np.stack([np.full(60, BOW), np.zeros(60), np.linspace(-LIMB, 0, 60, endpoint=False)], axis=1)
    root = np.stack([np.full(15, -BOW), np.zeros(15), np.linspace(0, -0.015, 16)[1:]], axis=1)
    points = np.concatenate([limb, bow, root])
    radius = np.full(len(points), WIDTH)
    radius[-40:] = np.linspace(WIDTH, 1.2 * WIDTH, 40)
    if narrowed is not None:
        radius -= (WIDTH - narrowed) * np.exp(-(((points[:, 2] + LIMB / 2) / 6e-3) ** 2)) * (points[:, 0] > 0)
    aorta = Branch("aorta", points, radius)
    branches = [aorta]
    for name, (x, width) in SIDES.items():
        number = int(np.argmin(np.abs(bow[:, 0] - x))) + len(limb)
        up = bow[number - len(limb)] / BOW
        along = np.linspace(0, WIDTH + stub, 41)
        side = aorta.points[number] + along[:, None] * up
        branches.append(Branch(name, side, np.full(41, width), "aorta", float(aorta.arc[number])))
    return VesselTree(tuple(branches))


def arch_mesh(stub: float, narrowed: float | None = None, *, cut_open: bool = True) -> trimesh.Trimesh:
    """The lumen's surface of `arch_tree`, in metres; cut open at its ends by default."""
    tree = arch_tree(stub, narrowed)
    mesh = lumen_surface(build_lumen(tree, resolution=1e-3, fillet_radius=2e-3))
    for centre, normal, radius in open_ends(tree) if cut_open else []:
        mesh = _cut(mesh, centre - 1e-3 * normal, normal, radius + 3e-3)
    return mesh
