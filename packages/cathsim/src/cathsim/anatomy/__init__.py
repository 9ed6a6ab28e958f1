"""Anatomy: parametric aortic arches, their lumens as signed distance grids, targets and geodesic distances."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cathsim.lazy_names import lazy_names

if TYPE_CHECKING:
    from cathsim.anatomy.distance_grid import SignedDistanceGrid as SignedDistanceGrid
    from cathsim.anatomy.entry import Entry as Entry
    from cathsim.anatomy.generator.arch_parameters import Aneurysm as Aneurysm
    from cathsim.anatomy.generator.arch_parameters import ArchParameters as ArchParameters
    from cathsim.anatomy.importing import import_anatomy as import_anatomy
    from cathsim.anatomy.library import PHANTOMS as PHANTOMS
    from cathsim.anatomy.library import load_phantom as load_phantom
    from cathsim.anatomy.mesh.report import ImportReport as ImportReport
    from cathsim.anatomy.mesh.report import MeshRefusedError as MeshRefusedError
    from cathsim.anatomy.phantom import Phantom as Phantom
    from cathsim.anatomy.phantom import Target as Target
    from cathsim.anatomy.vessel_tree import Branch as Branch
    from cathsim.anatomy.vessel_tree import VesselTree as VesselTree

__getattr__, __dir__, __all__ = lazy_names(
    __name__,
    {
        "distance_grid": "SignedDistanceGrid",
        "entry": "Entry",
        "generator.arch_parameters": "Aneurysm ArchParameters",
        "importing": "import_anatomy",
        "library": "PHANTOMS load_phantom",
        "mesh.report": "ImportReport MeshRefusedError",
        "phantom": "Phantom Target",
        "vessel_tree": "Branch VesselTree",
    },
)
