"""Networks of the Guide3D chapter in plain torch; `guide3d.learning.build` holds their sizes."""

from guide3d.extras import require

require("torch", "learning")
