"""An environment over copies of one anatomy that differ as a patient does from the scan."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from cathsim.anatomy import Phantom, load_phantom
from cathsim.anatomy.point_target import TargetLike
from cathsim.devices.choice import resolve_wire
from cathsim.devices.wire_placement import inserted_starts
from cathsim.environment import NavigateEnv
from cathsim.guidewire import Guidewire
from cathsim.many_anatomies import NavigateManyEnv
from cathsim.registration.description import resolve_argument
from cathsim.rehearsal.perturbation import Perturbation, copy_of


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
