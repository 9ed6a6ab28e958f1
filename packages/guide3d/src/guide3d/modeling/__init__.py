"""Networks of the Guide3D chapter in plain torch; `guide3d.learning.build` holds their sizes."""

from guide3d.commands import require

require("torch", "learning")
