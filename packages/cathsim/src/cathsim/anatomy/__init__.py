"""Anatomy: parametric aortic arches, their lumens as signed distance grids, targets and geodesic distances."""

from cathsim.anatomy.distance_grid import SignedDistanceGrid
from cathsim.anatomy.entry import Entry
from cathsim.anatomy.generator.arch_parameters import Aneurysm, ArchParameters
from cathsim.anatomy.importing import import_anatomy
from cathsim.anatomy.library import PHANTOMS, load_phantom
from cathsim.anatomy.mesh.importer import import_mesh
from cathsim.anatomy.mesh.report import ImportReport, MeshRefusedError
from cathsim.anatomy.phantom import Phantom, Target
from cathsim.anatomy.vessel_tree import Branch, VesselTree
from cathsim.anatomy.volume.importer import import_volume

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
    "import_anatomy",
    "import_mesh",
    "import_volume",
    "load_phantom",
]
