"""Analytic fluoroscopy: cameras, background by ray integration through the anatomy, the wire drawn over it.

`FluoroscopyRenderer` draws the plain image that agents see at high rates; `BiplaneFluoroscope` that of two C-arms with
real detectors.
"""

from .attenuation import background_image, expose, lumen_path_length
from .biplane import BiplaneFluoroscope, Frame
from .body import THORAX, WATER_BATH, Box, Ellipsoid
from .c_arms import PAIRS, XRayCamera, clinical_pair, guide3d_pair
from .calibration_file import read_projection, write_calibration
from .detector import Detector, quantum_noise
from .distortion import Distortion
from .materials import Section, WireMaterial, coil_tipped_wire, jacketed_wire, wire_material
from .projector import VIEWS, Projector
from .radiograph import Radiograph, expose_depth, radiograph
from .renderer import FluoroscopyRenderer
from .scene import SCENES, Scene, scene

__all__ = [
    "PAIRS",
    "SCENES",
    "THORAX",
    "VIEWS",
    "WATER_BATH",
    "BiplaneFluoroscope",
    "Box",
    "Detector",
    "Distortion",
    "Ellipsoid",
    "FluoroscopyRenderer",
    "Frame",
    "Projector",
    "Radiograph",
    "Scene",
    "Section",
    "WireMaterial",
    "XRayCamera",
    "background_image",
    "clinical_pair",
    "coil_tipped_wire",
    "expose",
    "expose_depth",
    "guide3d_pair",
    "jacketed_wire",
    "lumen_path_length",
    "quantum_noise",
    "radiograph",
    "read_projection",
    "scene",
    "wire_material",
    "write_calibration",
]
