"""Copies of one anatomy that differ as a patient does from the scan, and the environment over them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import partial
from typing import Annotated, Any

import numpy as np
from annotated_types import Interval

from cathsim.anatomy import Phantom, load_phantom
from cathsim.anatomy.point_target import TargetLike
from cathsim.contact.breathing import Breathing
from cathsim.devices.choice import resolve_wire
from cathsim.devices.wire_placement import inserted_starts
from cathsim.environment import NavigateEnv
from cathsim.guidewire import Guidewire
from cathsim.many_anatomies import NavigateManyEnv
from cathsim.observations.scan import Scan
from cathsim.registration.description import resolve_argument
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


class NavigateCopiesEnv(NavigateManyEnv):
    """`NavigateEnv` in copies of one anatomy, one of which each reset draws.

    The walls, the wire and the breathing are the copy's; roadmap and history are those of the scan, which lies shifted
    and turned against the patient. Observations, actions, `reset` and `info` are those of `NavigateManyEnv`; a case is
    a copy and a target.

    Args:
        phantom: as of `NavigateEnv`: the scan.
        targets: their names, or points in the lumen, (3,) m each.
        copies: seeds of copies; 0 is the scan itself.
        perturbation: how far they differ; None: as far as the defaults say.
        wire: as of `NavigateEnv`; None: a catheter alone.
        phantom_seed: of a random arch.
        resolution: m between the nodes of the phantom's grid.
        arguments: of `NavigateEnv`, for every episode, without those that the copy brings: phantom, wire, scan and
            breathing.

    Raises:
        ValueError: no copies, a negative seed, or a catheter alone, whose stiffness no copy changes.
    """

    def __init__(
        self,
        phantom: str | Phantom = "type_1",
        targets: Sequence[TargetLike] = ("lcca",),
        *,
        copies: Sequence[int] = tuple(range(1, 17)),
        perturbation: Perturbation | None = None,
        wire: str | Guidewire = "default",
        phantom_seed: int | None = None,
        resolution: float = 1e-3,
        **arguments: Any,
    ) -> None:
        if not copies or min(copies) < 0:
            raise ValueError(f"copies must list at least one seed, and none below 0, got {list(copies)}")
        for name in ("scan", "breathing"):
            if name in arguments:
                raise ValueError(f"copies bring their own {name}: leave it out, or change the perturbation")
        named = partial(load_phantom, seed=phantom_seed, resolution=resolution)
        self.scan = resolve_argument("phantom", phantom, Phantom, named)
        self.perturbation = (
            Perturbation() if perturbation is None else resolve_argument("perturbation", perturbation, Perturbation)
        )
        guidewire = resolve_wire(wire)
        if guidewire is None:
            raise ValueError(
                "copies differ in the wire's stiffness: give a wire, or use NavigateMany for a catheter alone"
            )
        self._kept: dict[int, Phantom] = {}  # so that the walls of a copy are made once
        super().__init__([int(seed) for seed in copies], targets, (guidewire,), resolution=resolution, **arguments)

    def inserted_starts(self, case: int, seed: int = 0) -> np.ndarray:
        """States of a case with the wire inserted along the way to its target; see `wire_placement.inserted_starts`.

        Args:
            seed: of the turns while it is withdrawn, and of the leads.

        Returns:
            As `reset(options={"start": row})` takes them, the case last. Shape (k, n).
        """
        self.reset(seed=seed, options={"case": case})
        states = inserted_starts(self.current, np.random.default_rng((seed, case)))
        return np.concatenate((states, np.full((len(states), 1), float(case))), axis=1)

    def _build(self, case: int) -> NavigateEnv:
        copy, target, wire = self.describe(case)
        guidewire, seed = self.wires[wire], self.phantoms[copy]
        assert isinstance(guidewire, Guidewire)
        assert isinstance(seed, int)
        changed = copy_of(self.scan, guidewire, self.perturbation, seed)
        self._kept[seed] = changed["phantom"]
        return NavigateEnv(target=self.targets[target], **changed, **self._arguments)
