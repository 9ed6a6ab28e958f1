"""Blood flow through the vessels of a phantom, and its shares at the open ends."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated

from annotated_types import Interval

from cathsim.validation import Share, Unit, settings

if TYPE_CHECKING:
    from cathsim.anatomy.vessel_tree import VesselTree

WAVEFORMS, PROFILES = ("pulsatile", "steady"), ("womersley", "poiseuille")


@settings
class BloodFlow:
    """An incompressible Newtonian fluid that the heart drives through the vessels.

    Attributes:
        density: kg/m^3.
        viscosity: Pa s.
        peak_velocity: largest velocity at the aortic root, over its section and the heartbeat, m/s; 0: blood at rest.
        heart_rate: Hz.
        waveform: "pulsatile" or "steady".
        profile: "womersley" or "poiseuille" (which "steady" always has).
        descending_share: share of the flow at the root that goes down the descending aorta, and where iliac arteries
            leave it is divided between its ends; None: by Murray's law, like the others, which gives the wide aorta
            more (89 % in Type I).
        shares: shares that leave through further open ends, by branch; ends that are not named divide the rest among
            themselves by the cube of their radius (Murray's law).
        phase: of the heartbeat at time zero, 0 to 1; 0 is the opening of the aortic valve.
    """

    density: Annotated[float, Interval(gt=0, le=30000), Unit("kg/m^3")] = 1060.0
    viscosity: Annotated[float, Interval(gt=0, le=10), Unit("Pa s")] = 0.004
    peak_velocity: Annotated[float, Interval(ge=0, le=20), Unit("m/s")] = 1.0
    heart_rate: Annotated[float, Interval(gt=0, le=20), Unit("Hz")] = 1.2
    waveform: str = "pulsatile"
    profile: str = "womersley"
    descending_share: Share | None = 0.7
    shares: Mapping[str, Share] | tuple[tuple[str, Share], ...] = ()
    phase: Share = 0.0

    def __post_init__(self) -> None:
        shares = self.shares.items() if isinstance(self.shares, Mapping) else self.shares
        # sorted pairs instead of a dictionary, so that equal flows are one key of the cache of fields
        object.__setattr__(self, "shares", tuple(sorted((str(name), float(share)) for name, share in shares)))
        for name, known in (("waveform", WAVEFORMS), ("profile", PROFILES)):
            if getattr(self, name) not in known:
                raise ValueError(f"unknown {name} '{getattr(self, name)}'; there are {', '.join(known)}")
        values = [*dict(self.shares).values(), *([] if self.descending_share is None else [self.descending_share])]
        if sum(values) > 1 + 1e-9:
            raise ValueError(f"shares must sum to at most 1 with descending_share, got {values}")


# Steady: about the mean of the pulsatile flow, whose parabola has twice its mean velocity in the middle.
FLOWS: dict[str, BloodFlow] = {
    "steady": BloodFlow(waveform="steady", profile="poiseuille", peak_velocity=0.25),
    "pulsatile": BloodFlow(),
}


def descending_shares(tree: VesselTree, share: float, given: Mapping[str, float]) -> dict[str, float]:
    """A share of the flow divided, by Murray's law, among the open ends of the root and of iliac arteries.

    Args:
        given: shares that are known, by branch; those of such ends are part of the share, and not returned.
    """
    parts, ways = outlet_shares(tree), {branch.name: tree.ancestry(branch.name)[1:] for branch in tree}
    below = [name for name in parts if not ways[name] or ways[name][0].startswith("iliac")]
    rest = max(share - sum(given.get(name, 0.0) for name in below), 0.0)
    free = {name: parts[name] for name in below if name not in given}
    return {name: rest * part / sum(free.values()) for name, part in free.items()}


def outlet_shares(tree: VesselTree, given: Mapping[str, float] | None = None) -> dict[str, float]:
    """Shares of the flow that leave through the open ends; they sum to 1.

    Args:
        tree: the vessels; the root runs from the descending end to the aortic root, where the blood enters.
        given: shares that are known, by branch.

    Returns:
        Share by branch; the root's is that of the descending aorta.

    Raises:
        ValueError: a given share is not that of an open end, or nothing is left to leave through.

    Source: Murray (1926), PNAS 12, 207-214: the flow that a vessel carries goes with the cube of its radius.
    """
    given = dict(given or {})
    cubes = {branch.name: float(branch.radius[-1]) ** 3 for branch in tree if branch.open_end}
    cubes[tree.root.name] = float(tree.root.radius[0]) ** 3
    unknown = [name for name in given if name not in cubes]
    if unknown:
        raise ValueError(f"blood cannot leave through {', '.join(unknown)}; the open ends are {', '.join(cubes)}")
    rest, left = 1.0 - sum(given.values()), sum(cube for name, cube in cubes.items() if name not in given)
    if left == 0.0 and abs(rest) > 1e-6:
        raise ValueError(f"the shares of all open ends must sum to 1, got {sum(given.values())}")
    return {name: given[name] if name in given else rest * cube / left for name, cube in cubes.items()}
