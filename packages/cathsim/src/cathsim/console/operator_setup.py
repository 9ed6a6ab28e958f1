"""What the operator chooses: anatomy, target, devices, limits; what is offered and what the page asks for, checked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from annotated_types import Interval

from cathsim.anatomy import PHANTOMS, Phantom
from cathsim.devices.device_file import is_file
from cathsim.devices.shelf import CATHETERS, SHAPES, catheter_file
from cathsim.environment import NavigateEnv
from cathsim.guidewire import GUIDEWIRES
from cathsim.metrics import FORCE_LIMIT
from cathsim.navigation import NavigationTask
from cathsim.validation import Count, Seed, Unit, settings

Newtons = Annotated[float, Interval(gt=0, le=100), Unit("N")]

LARGEST_RADIUS = 0.05  # m: a target that is reached from further away is none
NO_CATHETER = "none"  # on the command line
OWN = "own catheter"
OWN_WIRE = "own wire"  # of a file; a page learns no paths
_MM = 1e3


@settings
class ForceLimit:
    """From which contact force on the operator is warned, or the procedure ends."""

    force: Newtons = FORCE_LIMIT  # largest resultant contact force of a step
    ends: bool = False  # the procedure ends with the first step that reaches it


class ForceWatch:
    """Counts how often the contact force rises to a limit in a procedure.

    Attributes:
        warnings: so far; steps at or above the limit that follow each other are one.
    """

    def __init__(self, limit: ForceLimit) -> None:
        self.limit, self.warnings, self._above = limit, 0, False

    def see(self, force: float) -> bool:
        """Whether a step's largest contact force (N) is a new warning."""
        above = force >= self.limit.force
        new, self._above = above and not self._above, above
        self.warnings += new
        return new

    @property
    def ends(self) -> bool:
        """Whether the procedure ends with the step that was seen last."""
        return self.limit.ends and self._above


@settings
class Setup:
    """What the operator starts with."""

    phantom: str = "type_1"  # name of the phantom
    target: str = "bca"  # name of the target
    wire: str = "default"  # preset of the guidewire
    catheter: str | None = None  # a preset, or the path of a YAML file; None: the bare wire
    accuracy: str = "accurate"  # preset of the time stepping
    max_steps: Count = NavigationTask.max_steps  # a procedure ends after so many control steps
    seed: Seed = 0  # of the first procedure; each further one has the next
    # the target is reached within this distance of the tip, m
    success_radius: Annotated[float, Interval(ge=0.001, le=LARGEST_RADIUS), Unit("m")] = NavigationTask.success_radius
    force_limit: ForceLimit = field(default_factory=ForceLimit)

    def environment(self, phantom: Phantom, target: str, catheter: str | None) -> NavigateEnv:
        """The environment of a procedure; its image is that of other recorded episodes.

        Raises:
            ValueError: an unknown device, devices that do not fit, or a target out of their reach.
        """
        return NavigateEnv(
            phantom,
            target,
            wire=self.wire,
            catheter=catheter,
            accuracy=self.accuracy,
            observation="tip",
            max_steps=self.max_steps,
            success_radius=self.success_radius,
            success=_rule(phantom.name),
        )

    def task(self, phantom: str, target: str, catheter: str | None) -> dict[str, Any]:
        """What the sampling expert is asked to do beside a procedure, from the first start, as plain values."""
        return {
            "phantom": phantom, "target": target, "wire": self.wire, "catheter": catheter, "accuracy": self.accuracy,
            "max_steps": self.max_steps, "seed": self.seed, "success_radius": self.success_radius,
            "success": _rule(phantom),
            "most_force": self.force_limit.force if self.force_limit.ends else None,
        }  # fmt: skip


def _rule(phantom: str) -> str:
    """The rule of success in a phantom of a name: in named ones the thesis's, so that people compare with its rows."""
    return "straight" if phantom in PHANTOMS else NavigationTask.success


@dataclass(frozen=True)
class Offer:
    """A catheter that can be chosen."""

    name: str  # of the choice
    shape: str  # as the operator reads it
    french: int | None  # size; None: that of one's own file
    source: str  # as `load_catheter` takes it

    def to_page(self) -> dict[str, Any]:
        """What the page needs; a page learns no paths."""
        return {"name": self.name, "shape": self.shape, "french": self.french}


def offered(first: str | None) -> tuple[Offer, ...]:
    """The shelf in every size; before it, the one to begin with where that is a file.

    Args:
        first: catheter to begin with, None for the bare wire.
    """
    names = {f"{shape}_{size}f": (shape, size) for shape in SHAPES for size in sorted(catheter_file(shape).sizes)}
    own = [Offer(OWN, Path(first).stem, None, first)] if first and is_file(first) else []
    return (*own, *(Offer(name, shape, size, name) for name, (shape, size) in names.items()))


def find_offer(offers: Sequence[Offer], name: str) -> Offer:
    """The catheter of a name; a shape without its size is that of the default size.

    Raises:
        ValueError: it is not offered.
    """
    known = CATHETERS.get(name)
    for offer in offers:
        if name in (offer.name, offer.source) or (known is not None and CATHETERS.get(offer.source) == known):
            return offer
    raise ValueError(f"unknown catheter '{name}'; there are {', '.join(offer.name for offer in offers)}")


class Chosen(NamedTuple):
    """What the next procedures are to be."""

    setup: Setup
    phantom: str
    target: str
    catheter: Offer | None


class Choices:
    """Offers what there is, and reads what a page has chosen of it.

    Args:
        setup: what the operator starts with; a wire and a catheter of one's own are offered, too.
        phantoms: names of the phantoms.

    Raises:
        ValueError: the catheter is unknown.
    """

    def __init__(self, setup: Setup, phantoms: Sequence[str]) -> None:
        self.phantoms = list(dict.fromkeys([*phantoms, setup.phantom]))
        self._offers = offered(setup.catheter)
        self.first_catheter = find_offer(self._offers, setup.catheter) if setup.catheter else None
        self._own_wire = None if setup.wire in GUIDEWIRES else setup.wire

    def read(self, request: Mapping[str, Any], setup: Setup, catheter: Offer | None) -> Chosen:
        """What a checked request `choose` asks for; what it leaves out stays as it is in `setup` and `catheter`.

        Raises:
            ValueError: there is no such phantom, wire or catheter.
        """
        if request["phantom"] not in self.phantoms:
            raise ValueError(f"unknown phantom {request['phantom']!r}; there are {', '.join(self.phantoms)}")
        name = request.get("catheter", catheter.name if catheter else None)
        limit = setup.force_limit
        chosen = replace(
            setup,
            wire=self._wire(request.get("wire", setup.wire), setup.wire),
            max_steps=request.get("max_steps", setup.max_steps),
            success_radius=request.get("success_radius_mm", setup.success_radius * _MM) / _MM,
            force_limit=ForceLimit(
                request.get("force_limit_n", limit.force), request.get("ends_at_force_limit", limit.ends)
            ),
        )
        offer = None if name is None else find_offer(self._offers, name)
        return Chosen(chosen, request["phantom"], request["target"], offer)

    def _wire(self, name: str, present: str) -> str:
        wire = self._own_wire if name == OWN_WIRE and self._own_wire else name
        if wire != present and wire not in (*GUIDEWIRES, self._own_wire):
            raise ValueError(f"unknown wire {name!r}; there are {', '.join(GUIDEWIRES)}")
        return wire

    def to_page(self, setup: Setup, catheter: Offer | None) -> dict[str, Any]:
        """What there is, and what is chosen of it, as the page is told."""
        return {
            "phantoms": self.phantoms,
            "catheter": catheter.name if catheter else None,
            "catheters": [offer.to_page() for offer in self._offers],
            "wire": setup.wire if setup.wire in GUIDEWIRES else OWN_WIRE,
            "wires": [*([OWN_WIRE] if self._own_wire else []), *GUIDEWIRES],
            "max_steps": setup.max_steps,
            "success_radius_mm": round(setup.success_radius * _MM, 6),
            "force_limit_n": setup.force_limit.force,
            "ends_at_force_limit": setup.force_limit.ends,
        }
