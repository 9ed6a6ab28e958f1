"""Anatomy: parametric aortic arches, their lumens as signed distance grids, targets and geodesic distances."""

from .arch_parameters import Aneurysm, ArchParameters
from .distance_grid import SignedDistanceGrid
from .library import PHANTOMS, load_phantom
from .mesh_import import import_mesh
from .mesh_refusal import MeshRefusedError
from .mesh_report import ImportReport
from .phantom import Entry, Phantom, Target
from .vessel_tree import Branch, VesselTree

__all__ = [
    "PHANTOMS",
    "Aneurysm",
    "ArchParameters",
    "Branch",
    "Entry",
    "ImportReport",
    "MeshRefusedError",
    "Phantom",
    "SignedDistanceGrid",
    "Target",
    "VesselTree",
    "import_mesh",
    "load_phantom",
]
