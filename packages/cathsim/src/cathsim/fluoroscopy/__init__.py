"""Analytic fluoroscopy: cameras, background by ray integration through the anatomy, the wire drawn over it.

`FluoroscopyRenderer` draws the plain image that agents see at high rates; `BiplaneFluoroscope` that of two C-arms with
real detectors.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from cathsim.fluoroscopy.radiograph import radiograph as radiograph  # now: a module of the same name would hide it
from cathsim.fluoroscopy.scene import scene as scene
from cathsim.lazy_names import lazy_names

if TYPE_CHECKING:
    from cathsim.fluoroscopy.attenuation import background_image as background_image
    from cathsim.fluoroscopy.attenuation import expose as expose
    from cathsim.fluoroscopy.attenuation import lumen_path_length as lumen_path_length
    from cathsim.fluoroscopy.biplane import BiplaneFluoroscope as BiplaneFluoroscope
    from cathsim.fluoroscopy.biplane import DevicesFrame as DevicesFrame
    from cathsim.fluoroscopy.biplane import Frame as Frame
    from cathsim.fluoroscopy.c_arms import PAIRS as PAIRS
    from cathsim.fluoroscopy.c_arms import XRayCamera as XRayCamera
    from cathsim.fluoroscopy.c_arms import askew_pair as askew_pair
    from cathsim.fluoroscopy.c_arms import clinical_pair as clinical_pair
    from cathsim.fluoroscopy.c_arms import guide3d_pair as guide3d_pair
    from cathsim.fluoroscopy.c_arms import write_calibration as write_calibration
    from cathsim.fluoroscopy.detector import Detector as Detector
    from cathsim.fluoroscopy.device_renderer import DeviceRenderer as DeviceRenderer
    from cathsim.fluoroscopy.distortion import DetectorDistortion as DetectorDistortion
    from cathsim.fluoroscopy.materials import Section as Section
    from cathsim.fluoroscopy.materials import WireMaterial as WireMaterial
    from cathsim.fluoroscopy.materials import catheter_material as catheter_material
    from cathsim.fluoroscopy.materials import coil_tipped_wire as coil_tipped_wire
    from cathsim.fluoroscopy.materials import jacketed_wire as jacketed_wire
    from cathsim.fluoroscopy.materials import steel_wire as steel_wire
    from cathsim.fluoroscopy.materials import wire_material as wire_material
    from cathsim.fluoroscopy.patient.ct_body import CTBody as CTBody
    from cathsim.fluoroscopy.patient.ct_body import ct_body as ct_body
    from cathsim.fluoroscopy.patient.ct_body import ct_scene as ct_scene
    from cathsim.fluoroscopy.projector import VIEWS as VIEWS
    from cathsim.fluoroscopy.projector import Projector as Projector
    from cathsim.fluoroscopy.radiograph import Radiograph as Radiograph
    from cathsim.fluoroscopy.radiograph import expose_depth as expose_depth
    from cathsim.fluoroscopy.renderer import FluoroscopyRenderer as FluoroscopyRenderer
    from cathsim.fluoroscopy.scene import SCENES as SCENES
    from cathsim.fluoroscopy.scene import THORAX as THORAX
    from cathsim.fluoroscopy.scene import WATER_BATH as WATER_BATH
    from cathsim.fluoroscopy.scene import Box as Box
    from cathsim.fluoroscopy.scene import Ellipsoid as Ellipsoid
    from cathsim.fluoroscopy.scene import XRayScene as XRayScene

__getattr__, __dir__, __all__ = lazy_names(
    __name__,
    {
        "attenuation": "background_image expose lumen_path_length",
        "biplane": "BiplaneFluoroscope DevicesFrame Frame",
        "c_arms": "PAIRS XRayCamera askew_pair clinical_pair guide3d_pair write_calibration",
        "detector": "Detector",
        "device_renderer": "DeviceRenderer",
        "distortion": "DetectorDistortion",
        "materials": "Section WireMaterial catheter_material coil_tipped_wire jacketed_wire steel_wire wire_material",
        "patient.ct_body": "CTBody ct_body ct_scene",
        "projector": "Projector VIEWS",
        "radiograph": "Radiograph expose_depth radiograph",
        "renderer": "FluoroscopyRenderer",
        "scene": "SCENES THORAX WATER_BATH Box Ellipsoid XRayScene scene",
    },
)
