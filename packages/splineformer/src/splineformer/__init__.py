"""SplineFormer: a transformer that reads a guidewire as a B-spline from one fluoroscopic image.

Only this public front exists so far; README.md lists what will live here.
"""

__version__ = "0.1.0"

__all__ = ["__version__"]
