"""The plan of a generated data set: which acquisitions there are, in the thesis's proportions of wires and fluid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from guide3d.dataset.annotation_files import acquisition_name
from pipeline.seeds import acquisition_seed
from pipeline.stages.guide3d.wire_motions import Script

# (fluid, wire) to images of the real data set
COMPOSITION = {(True, "angled"): 3664, (True, "straight"): 484, (False, "angled"): 2472, (False, "straight"): 2126}


@dataclass(frozen=True)
class Acquisition:
    """One acquisition to be made.

    Attributes:
        name: in the public layout, e.g. "1-bca-angle-5".
        fluid: whether the phantom is filled.
        script: what the operator does.
    """

    name: str
    fluid: bool
    script: Script


def composition(images: int) -> dict[tuple[bool, str], int]:
    """Pairs of images of every kind, in the thesis's proportions.

    Args:
        images: of both cameras together, at least 8.

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
    images: int, pairs: int, phantoms: Sequence[str], targets: Sequence[str], steps: int, seed: int
) -> list[Acquisition]:
    """Plans a data set.

    Args:
        images: of both cameras together.
        pairs: of an acquisition at most.
        phantoms: anatomies, taken in turn.
        targets: branches, taken in turn.
        steps: of 0.1 s from one pair to the next.
        seed: of the run.

    Returns:
        The acquisitions, numbered from 1; those of a kind are equally long, to one pair.
    """
    planned: list[Acquisition] = []
    for (fluid, wire), count in composition(images).items():
        acquisitions = -(-count // pairs)
        for index in range(acquisitions):
            number = len(planned) + 1
            length = count // acquisitions + (index < count % acquisitions)
            target = targets[index % len(targets)]
            phantom = phantoms[index // len(targets) % len(phantoms)]
            own = acquisition_seed(seed, number)
            script = Script(phantom, target, wire, length, steps, own)
            planned.append(Acquisition(acquisition_name(fluid, target, wire, number), fluid, script))
    return planned
