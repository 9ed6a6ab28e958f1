"""Analytic fluoroscopy: cameras, background by ray integration through the anatomy, the wire drawn over it.

`FluoroscopyRenderer` draws the plain image that agents see at high rates; `BiplaneFluoroscope` that of two C-arms with
real detectors.
"""

from cathsim.fluoroscopy.attenuation import background_image, expose, lumen_path_length
from cathsim.fluoroscopy.biplane import BiplaneFluoroscope, DevicesFrame, Frame
from cathsim.fluoroscopy.body import THORAX, WATER_BATH, Box, Ellipsoid
from cathsim.fluoroscopy.c_arms import PAIRS, XRayCamera, askew_pair, clinical_pair, guide3d_pair
from cathsim.fluoroscopy.calibration_file import read_projection, write_calibration
from cathsim.fluoroscopy.detector import Detector, quantum_noise
from cathsim.fluoroscopy.device_renderer import DeviceRenderer
from cathsim.fluoroscopy.distortion import DetectorDistortion
from cathsim.fluoroscopy.materials import (
    Section,
    WireMaterial,
    catheter_material,
    coil_tipped_wire,
    jacketed_wire,
    steel_wire,
    wire_material,
)
from cathsim.fluoroscopy.patient.ct_body import CTBody, ct_body, ct_scene
from cathsim.fluoroscopy.projector import VIEWS, Projector
from cathsim.fluoroscopy.radiograph import Radiograph, expose_depth, radiograph
from cathsim.fluoroscopy.renderer import FluoroscopyRenderer
from cathsim.fluoroscopy.scene import SCENES, XRayScene, scene

__all__ = [
    "PAIRS",
    "SCENES",
    "THORAX",
    "VIEWS",
    "WATER_BATH",
    "BiplaneFluoroscope",
    "Box",
    "CTBody",
    "Detector",
    "DetectorDistortion",
    "DeviceRenderer",
    "DevicesFrame",
    "Ellipsoid",
    "FluoroscopyRenderer",
    "Frame",
    "Projector",
    "Radiograph",
    "Section",
    "WireMaterial",
    "XRayCamera",
    "XRayScene",
    "askew_pair",
    "background_image",
    "catheter_material",
    "clinical_pair",
    "coil_tipped_wire",
    "ct_body",
    "ct_scene",
    "expose",
    "expose_depth",
    "guide3d_pair",
    "jacketed_wire",
    "lumen_path_length",
    "quantum_noise",
    "radiograph",
    "read_projection",
    "scene",
    "steel_wire",
    "wire_material",
    "write_calibration",
]
