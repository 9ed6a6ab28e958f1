"""The plan of a generated data set: which acquisitions there are, in the thesis's proportions of wires and fluid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from guide3d.dataset.annotation_files import acquisition_name

# (fluid, wire) to images of the real data set
COMPOSITION = {(True, "angled"): 3664, (True, "straight"): 484, (False, "angled"): 2472, (False, "straight"): 2126}


@dataclass(frozen=True)
class PlannedAcquisition:
    """One acquisition to be made.

    Attributes:
        number: in the data set, from 1.
        wire: "angled" or "straight".
        target: branch that the wire is meant for, e.g. "bca".
    """

    number: int
    fluid: bool
    wire: str
    phantom: str
    target: str
    pairs: int

    @property
    def name(self) -> str:
        """In the public layout, e.g. "1-bca-angle-5"."""
        return acquisition_name(self.fluid, self.target, self.wire, self.number)


def composition(images: int) -> dict[tuple[bool, str], int]:
    """Divides images (of both cameras, at least 8) among the kinds of acquisitions, in the thesis's proportions.

    Returns:
        (fluid, wire) to pairs, at least one each; they add up to half of `images`.
    """
    pairs, total = images // 2, sum(COMPOSITION.values())
    exact = {kind: pairs * count / total for kind, count in COMPOSITION.items()}
    counts = {kind: max(int(share), 1) for kind, share in exact.items()}
    by_remainder = sorted(counts, key=lambda kind: counts[kind] - exact[kind])
    while (missing := pairs - sum(counts.values())) != 0:
        for kind in by_remainder[: abs(missing)] if missing > 0 else sorted(counts, key=lambda k: -counts[k])[:1]:
            counts[kind] += 1 if missing > 0 else -1
    return counts


def plan_acquisitions(
    images: int, pairs: int, phantoms: Sequence[str], targets: Sequence[str]
) -> list[PlannedAcquisition]:
    """Plans a data set.

    Args:
        phantoms: anatomies, taken in turn.
        targets: branches, taken in turn.

    Returns:
        The acquisitions, numbered from 1; those of a kind are equally long, to one pair.
    """
    planned: list[PlannedAcquisition] = []
    for (fluid, wire), count in composition(images).items():
        acquisitions = -(-count // pairs)
        for index in range(acquisitions):
            length = count // acquisitions + (index < count % acquisitions)
            target = targets[index % len(targets)]
            phantom = phantoms[index // len(targets) % len(phantoms)]
            planned.append(PlannedAcquisition(len(planned) + 1, fluid, wire, phantom, target, length))
    return planned
