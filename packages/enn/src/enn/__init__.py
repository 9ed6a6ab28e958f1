"""Expert Navigation Network: learned policies for endovascular navigation that reach the simulator through Gymnasium.

Only this public front exists so far; README.md lists what will live here.
"""

__version__ = "0.1.0"

__all__ = ["__version__"]
