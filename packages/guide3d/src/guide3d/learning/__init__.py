"""Training and prediction of the networks."""

from guide3d.commands import require

require("torch", "learning")
