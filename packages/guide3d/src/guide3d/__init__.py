"""Guide3D: from two X-ray images to the shape of a guidewire in space, with plain arrays in and out.

Only this public front exists so far; README.md lists what will live here.
"""

__version__ = "0.1.0"

__all__ = ["__version__"]
