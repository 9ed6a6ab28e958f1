"""Analytic fluoroscopy: cameras, background by ray integration through the anatomy, the wire drawn over it."""

from .attenuation import background_image, expose, lumen_path_length
from .body import THORAX, Ellipsoid
from .detector import quantum_noise
from .projector import VIEWS, Projector
from .renderer import FluoroscopyRenderer

__all__ = [
    "THORAX",
    "VIEWS",
    "Ellipsoid",
    "FluoroscopyRenderer",
    "Projector",
    "background_image",
    "expose",
    "lumen_path_length",
    "quantum_noise",
]
