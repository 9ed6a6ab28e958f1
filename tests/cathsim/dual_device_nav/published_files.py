"""The published files of DualDeviceNav in their own layout, from those beside the project."""

import json
import os
import shutil
import tempfile
from functools import cache
from pathlib import Path

import pytest

REAL = Path(__file__).resolve().parents[4] / "shared" / "real" / "trees"
needs_files = pytest.mark.skipif(not REAL.is_dir(), reason="../shared/real/trees is not there")


@cache
def folder() -> str:
    """Makes the folder, at the same place in every process of a user."""
    made = Path(tempfile.gettempdir()) / f"cathsim-dualdevicenav-{os.getuid()}"
    (made / "Centrelines_comb").mkdir(parents=True, exist_ok=True)
    shutil.copyfile(REAL / "dualdevicenav.obj", made / "vessel_architecture_collision.obj")
    for name, curve in json.loads((REAL / "dualdevicenav_centrelines.json").read_text()).items():
        markup = {
            "coordinateSystem": curve["coordinate_system"],
            "controlPoints": [{"position": point} for point in curve["points_mm"]],
            "measurements": [{"name": "length"}, {"name": "Radius", "controlPointValues": curve["radius_mm"]}],
        }
        ending = f"({name})" if name.isdecimal() else f"- {name}"
        path = made / "Centrelines_comb" / f"Centerline curve {ending}.mrk.json"
        path.write_text(json.dumps({"markups": [markup]}))
    return str(made)
