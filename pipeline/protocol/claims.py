"""Claims of the protocol: read from `evaluation/protocol.yaml`, where each is declared once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, ConfigDict, Field, TypeAdapter
from pydantic.dataclasses import dataclass as checked

from pipeline.data.sources import read_declared
from pipeline.seeds import ARCHES
from pipeline.store.provenance import project_file

_STRICT = ConfigDict(extra="forbid")
First = Annotated[int, AfterValidator(lambda first: _block(first))]
Positive = Annotated[int, Field(gt=0)]
Share = Annotated[float, Field(ge=0)]


@checked(frozen=True, kw_only=True, config=_STRICT)
class Variation:
    """What differs from what a policy was trained with.

    Attributes:
        shift_mm, turn_deg: of the scan that the roadmap shows, along and about directions that each case draws.
        stiffness, friction: of the wire, times the usual ones.
        breathing_mm: amplitude of the vessel's motion towards the feet, every four seconds.
        wall_n_mm: stiffness of the wall at each contact, N/mm; None: rigid but for the solver's own give.
    """

    shift_mm: Share = 0.0
    turn_deg: Share = 0.0
    stiffness: Annotated[float, Field(gt=0)] = 1.0
    friction: Annotated[float, Field(gt=0)] = 1.0
    breathing_mm: Annotated[float, Field(ge=0, le=20)] = 0.0
    wall_n_mm: Annotated[float, Field(ge=0.1, le=1)] | None = None


@checked(frozen=True, kw_only=True, config=_STRICT)
class Navigation:
    """Shipped policies steer to targets, in drawn arches, phantoms of the library, or real vessels.

    Attributes:
        arches: kind of drawn arches, as `pipeline.stages.unseen.task.TEST_KINDS`; instead of `phantoms` and `sources`.
        phantoms: of the library, by name.
        sources: the use of real vessels, of `evaluation/sources.yaml`.
        vessels: of those, what they show: arches, or all others.
        first, count: seed of the first arch (of `pipeline.seeds`), and how many; in others, episodes towards a target.
        targets: names; without any, all branches that an import finds.
        policies: names; the second plays where an ostium offset is large.
        attempts, steps: of an episode, and the steps of each.
        variations: by name, each with the same anatomies and starts.
    """

    kind: Literal["navigation"]
    title: str
    limits: str
    arches: Literal["random", "random_steep", "random_trunk"] | None = None
    phantoms: tuple[str, ...] = ()
    sources: Literal["seen", "open", "reserved"] | None = None
    vessels: Literal["arch", "other"] = "arch"
    first: First
    count: Positive
    targets: tuple[str, ...] = ()
    policies: Annotated[tuple[str, ...], Field(min_length=1, max_length=2)]
    attempts: Positive = 1
    steps: Positive = 300
    variations: Mapping[str, Variation] = field(default_factory=lambda: {"": Variation()})

    def __post_init__(self) -> None:
        """Refuses more or less than one kind of anatomies."""
        if sum(map(bool, (self.arches, self.phantoms, self.sources))) != 1:
            raise ValueError("needs one of arches, phantoms and sources")
        if not (self.targets or self.sources):
            raise ValueError("needs targets")


@checked(frozen=True, kw_only=True, config=_STRICT)
class Reconstruction:
    """Drawn wires are reconstructed from two views."""

    kind: Literal["reconstruction"]
    title: str
    limits: str
    first: First  # seed of the scenes
    count: Positive
    noise_px: Share


@checked(frozen=True, kw_only=True, config=_STRICT)
class Forces:
    """Contact forces are found from a wire's shape, and compared with those of the simulator.

    Attributes:
        first, count: seed of the first arch (of `pipeline.seeds`), and how many.
        accuracy: preset of the simulator that gives the truth; the estimate's own model is no simulation.
        noise_mm: of the curve.
        pieces: into which each link of the wire that gives the truth is cut.
        members: estimates of which the interval is made.
    """

    kind: Literal["forces"]
    title: str
    limits: str
    first: First
    count: Positive
    accuracy: Literal["accurate", "reference"]
    noise_mm: Share
    pieces: Positive = 1
    members: Positive = 40


@checked(frozen=True, kw_only=True, config=_STRICT)
class Rehearsal:
    """The stage rehearsal, in a drawn arch each, from choosing the devices to the tests in copies.

    Attributes:
        arches: kind of drawn arches.
        first, count: seed of the first arch (of `pipeline.seeds`), and how many.
        target: name.
    """

    kind: Literal["rehearsal"]
    title: str
    limits: str
    arches: Literal["random", "random_steep", "random_trunk"]
    first: First
    count: Positive
    target: str


@checked(frozen=True, kw_only=True, config=_STRICT)
class RealXray:
    """Real X-ray pairs, not public, are read at several sizes (1: as recorded)."""

    kind: Literal["real_xray"]
    title: str
    limits: str
    sizes: tuple[Annotated[float, Field(gt=0)], ...]


@checked(frozen=True, kw_only=True, config=_STRICT)
class Calibration:
    """Cameras are calibrated from real X-rays, not public, of a perforated sheet and a bead cube."""

    kind: Literal["calibration"]
    title: str
    limits: str


@checked(frozen=True, kw_only=True, config=_STRICT)
class Speed:
    """Environments are stepped on one core."""

    kind: Literal["speed"]
    title: str
    limits: str
    phantoms: tuple[str, ...]
    steps: Positive


Claim = Annotated[
    Navigation | Reconstruction | Forces | Rehearsal | RealXray | Calibration | Speed, Field(discriminator="kind")
]
_CLAIM: TypeAdapter[Claim] = TypeAdapter(Claim)


def _block(first: int) -> int:
    block = ARCHES["protocol"]
    if first not in block.all[:: block.width]:
        raise ValueError(f"must be {block.first} and a multiple of {block.width}, below {block.all.stop}")
    return first


@checked(frozen=True)
class Protocol:
    """All claims, by name, and the version that they are of."""

    version: int
    claims: Mapping[str, Claim]


def read_protocol(path: Path | None = None) -> Protocol:
    """Reads the protocol, by default the project's; errors are those of `read_declared`."""
    return read_declared(path or project_file("evaluation/protocol.yaml"), Protocol, "is no protocol")


def declared(claim: Claim, *, words: bool = True) -> dict[str, Any]:
    """A claim's entry as plain numbers and text, defaults left out; without `words` only what its figures depend on."""
    entry: dict[str, Any] = _CLAIM.dump_python(claim, mode="json", exclude_defaults=True)
    return entry if words else {key: value for key, value in entry.items() if key not in ("title", "limits")}
