"""How far a copy may differ from its scan, and what one copy is."""

from __future__ import annotations

import dataclasses
from typing import Annotated, Any

import numpy as np
from annotated_types import Interval

from cathsim.anatomy import Phantom
from cathsim.contact.breathing import Breathing
from cathsim.guidewire import Guidewire
from cathsim.observations.scan import Scan
from cathsim.rehearsal.walls import displaced_walls
from cathsim.validation import Turn, Unit, settings

TILT = 0.5  # of the direction of breathing against the axis of the body: standard deviation of both other components
_Short = Annotated[float, Interval(ge=0, le=0.02), Unit("m")]
_Share = Annotated[float, Interval(ge=0, lt=1)]


@settings
class Perturbation:
    """The largest differences between a scan and the patient on the day; each is drawn evenly up to there.

    Attributes:
        walls: displacement of the walls, m; a smooth field.
        shift: of the scan against the patient along each axis, m.
        turn: of the scan against the patient, rad, about any axis.
        stiffness: share by which the wire's bending stiffness differs either way.
        friction: likewise, the wire's friction.
        breathing: amplitude of the vessel's motion, m, mostly along the body.
        period: of a breath, s.
    """

    walls: _Short = 1e-3
    shift: _Short = 3e-3
    turn: Turn = float(np.radians(3.0))
    stiffness: _Share = 0.3
    friction: _Share = 0.3
    breathing: _Short = 5e-3
    period: Annotated[float, Interval(ge=0.5, le=60), Unit("s")] = 4.0

    def scaled(self, share: float) -> Perturbation:
        """The same with all largest differences times a share; the period stays."""
        changed = {one.name: share * getattr(self, one.name) for one in dataclasses.fields(self)}
        return dataclasses.replace(self, **changed | {"period": self.period})


def copy_of(phantom: Phantom, wire: Guidewire, perturbation: Perturbation, seed: int) -> dict[str, Any]:
    """A copy of an anatomy and of a wire, as arguments of `NavigateEnv`: phantom, wire, scan, breathing.

    Args:
        seed: of the copy; 0 is the scan itself, without any difference.
    """
    if seed == 0:
        return {"phantom": phantom, "wire": wire}
    generator = np.random.default_rng((seed, 0))
    axis = generator.standard_normal(3)
    turn = generator.uniform(0.0, perturbation.turn) * axis / np.linalg.norm(axis)
    shift = generator.uniform(-perturbation.shift, perturbation.shift, 3)
    stiffness = 1 + generator.uniform(-perturbation.stiffness, perturbation.stiffness)
    friction = 1 + generator.uniform(-perturbation.friction, perturbation.friction)
    amplitude = generator.uniform(0.0, perturbation.breathing)
    direction = np.append(generator.normal(0.0, TILT, 2), -1.0)
    direction /= np.linalg.norm(direction)
    walls = displaced_walls(phantom, seed, perturbation.walls) if perturbation.walls else phantom
    return {
        "phantom": walls,
        "wire": dataclasses.replace(
            wire,
            shaft_stiffness_nmm2=stiffness * wire.shaft_stiffness_nmm2,
            tip_stiffness_nmm2=stiffness * wire.tip_stiffness_nmm2,
            friction=friction * wire.friction,
        ),
        "scan": Scan(phantom, shift, turn),
        "breathing": Breathing(amplitude=amplitude, direction=tuple(direction.tolist()), period=perturbation.period),
    }
