"""Training and prediction of the networks."""

from guide3d.extras import require

require("torch", "learning")
