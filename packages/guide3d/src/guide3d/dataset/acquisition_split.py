"""Acquisitions: those that a set of simulated images is planned from, and how a set is split by them."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

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


@dataclass(frozen=True)
class Split:
    """Names of the acquisitions to train with, to choose the best epoch by, and to evaluate with."""

    train: tuple[str, ...]
    validation: tuple[str, ...]
    test: tuple[str, ...]


def partners(acquisition: str) -> str:
    """What an acquisition and its partner with or without fluid have in common: the name without its first part."""
    return re.sub(r"^[01]-", "", acquisition)


def split_acquisitions(
    acquisitions: Mapping[str, tuple[str, int]], shares: tuple[float, float, float] = (0.8, 0.1, 0.1), seed: int = 0
) -> Split:
    """Divides acquisitions, partners staying together, so that every kind of acquisition is divided alike.

    Kinds are shuffled by the seed. Each group then goes where, in frames, most is still missing of its kind.

    Args:
        acquisitions: name to (kind, frames); a kind is any text, such as wire and fluid.
        shares: of the frames in train, validation and test.

    Returns:
        The split; no acquisition is in two parts. With three groups or more, no part with a share stays empty.

    Raises:
        ValueError: the shares are negative or do not add up to 1, or there is no acquisition.
    """
    if len(shares) != 3 or min(shares) < 0 or not np.isclose(sum(shares), 1.0):
        raise ValueError(f"shares: expected three that are not negative and add up to 1, got {shares}")
    if not acquisitions:
        raise ValueError("there is no acquisition to split")
    groups: dict[str, list[str]] = defaultdict(list)
    for name in acquisitions:
        groups[partners(name)].append(name)
    kinds: dict[str, list[str]] = defaultdict(list)
    for group in sorted(groups):
        kinds["+".join(sorted({acquisitions[name][0] for name in groups[group]}))].append(group)
    generator = np.random.default_rng(seed)
    parts: list[list[str]] = [[], [], []]
    share = np.array(shares)
    total = np.zeros(3)  # frames so far, over all kinds: breaks ties between kinds of a single group
    for kind in sorted(kinds):
        own = np.zeros(3)
        shuffled = [kinds[kind][i] for i in generator.permutation(len(kinds[kind]))]
        for group in shuffled:
            frames = sum(acquisitions[name][1] for name in groups[group])
            missing = share * (own.sum() + frames) - own + 0.5 * (share * (total.sum() + frames) - total)
            best = int(np.argmax(np.where(share > 0, missing, -np.inf)))
            parts[best].extend(groups[group])
            own[best] += frames
            total[best] += frames
    _fill_empty(parts, groups, share)
    train, validation, test = (tuple(sorted(part)) for part in parts)
    return Split(train, validation, test)


def _fill_empty(parts: list[list[str]], groups: Mapping[str, list[str]], share: np.ndarray) -> None:
    """Moves a group from the largest part into every empty one that has a share."""
    for part in range(3):
        if share[part] > 0 and not parts[part]:
            donor = max(range(3), key=lambda i: len({partners(name) for name in parts[i]}))
            names = sorted({partners(name) for name in parts[donor]})
            if len(names) > 1:
                moved = groups[names[-1]]
                parts[donor] = [name for name in parts[donor] if name not in moved]
                parts[part] = list(moved)
