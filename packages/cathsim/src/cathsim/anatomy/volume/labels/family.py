"""Which vessel hangs on which, and where: contacts of labels, false bridges, gaps within and between vessels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.vessel_names import AORTA, PARENTS
from cathsim.anatomy.volume.labels.parts import bridge, clean_parts, distances, led_on
from cathsim.anatomy.volume.lumen.lattice import neighbours
from cathsim.lattice.node_set import linked_parts

_LEAST_SHARE = 0.3  # of a vessel's largest contact: one smaller than this is no take-off
# of a vessel's radius, and of its section: one that touches its parent by less, and has less of it there, is led on to
# it along its axis. Steps of voxels make whole contacts 1.4 to 2.3 times as wide as the vessel
_SLIVER, _PARTLY = 1.15, 0.7
_ABOUT = 30e-3  # m around its take-off that say where a vessel leads
_MOUTH = 0.5  # of a take-off's area, from which on a contact beside it is a part of the mouth and no bridge
_SISTERS = 1.2  # of the sum of both take-offs' radii, within which they are one place
_ONE_PLACE = 0.8  # of the radius of a vessel's take-off from the aorta: a branch that leaves it so near to that, too
_ALONG = (1.5, 4e-3)  # radii and m before a vessel's end from which on a contact lies along its side
_UNSURE = 0.5  # of the radius of the contact with its parent: another that wide, also at the end, is noted
_CLUSTER = 4e-3  # m: contacts nearer to each other than this are one
_AXES = ((1, 0, 0), (0, 1, 0), (0, 0, 1))

Array = NDArray[np.float64]
Box = NDArray[np.uint8]
Touching = dict[tuple[int, int], tuple[Array, Array]]  # places and areas of contacts, by pair of vessels


_MOST_VOXELS = 20_000  # of a label; larger ones are thinned out


@dataclass(eq=False)
class Link:
    """Where a vessel leaves its parent."""

    parent: int  # number of the parent
    beside: int  # number of the vessel whose label it touches there, the parent's or its sister's
    ostium: Array  # (n, 3) m, contacts there, in the lattice's axes
    radius: float  # m, of a circle of the contacts' area


@dataclass(eq=False)
class Family:
    """Vessels that hang together, by their number in the box."""

    names: dict[int, str]
    links: dict[int, Link]  # of all but the aorta
    false: list[tuple[int, int, Array]]  # pairs that touch where neither leaves the other, and where: (n, 3) m
    order: list[int]  # the aorta first, each parent before its children
    notes: list[str] = field(default_factory=list)


def find_family(box: Box, names: Sequence[str], spacing: Array) -> tuple[Box, Family]:
    """Cleans a box of labels and finds which vessel leaves which; gaps of a few voxels are closed.

    Args:
        box: (nx, ny, nz) numbers of vessels, from 1 on.
        spacing: (3,) m between voxels.

    Returns:
        The cleaned box, and its family.
    """
    box = box.copy()
    numbers = {name: number for number, name in enumerate(names, 1)}
    root = numbers[AORTA]
    notes = clean_parts(box, names, spacing)
    links: dict[int, Link] = {}
    order, waiting = [root], [n for n in numbers.values() if n != root and (box == n).any()]
    touching = _contacts(box, spacing)
    closed = False
    while waiting:
        parents = {n: parent for n in waiting if (parent := _parent(n, box, names, order, touching, spacing, closed))}
        if parents:
            links |= {n: _link(n, parent, touching) for n, parent in parents.items()}
            order += parents
            waiting = [n for n in waiting if n not in parents]
        elif not closed:
            gaps = [_close_to_parent(box, n, names, order, spacing) for n in waiting]
            notes += [gap for gap in gaps if gap]
            touching, closed = _contacts(box, spacing), True
        else:
            break
    beside, unsure = _further_contacts(box, names, links, touching, spacing)
    led = _lead_on(box, names, links, spacing)
    notes += unsure
    if led:
        notes += led
        touching = _contacts(box, spacing)
        links = {number: _link(number, link.parent, touching) for number, link in links.items()}
    _raise_sisters(links, names)
    for number in waiting:
        box[box == number] = 0
        notes.append(f"{names[number - 1]} touches no other vessel and is left out")
    vessels = {number: names[number - 1] for number in order}
    return box, Family(vessels, links, _false_contacts(touching, links, root, waiting, beside), order, notes)


def _further_contacts(
    box: Box, names: Sequence[str], links: dict[int, Link], touching: Touching, spacing: Array
) -> tuple[dict[tuple[int, int], int], list[str]]:
    """Contacts of vessels with others than they leave: along whose side, by pair; notes on the rest."""
    beside: dict[tuple[int, int], int] = {}
    notes = []
    for number, link in links.items():
        usual = PARENTS.get(names[number - 1], ())
        others = {a if b == number else b for a, b in touching if number in (a, b)}
        possible = [other for name in usual for other in others if names[other - 1] == name]
        at_end = _take_off(number, box, possible, touching, spacing)
        if link.parent not in at_end:
            continue
        for other in set(possible) - set(at_end):
            beside[min(number, other), max(number, other)] = number
        for other in at_end:
            if other != link.parent and _link(number, other, touching).radius >= _UNSURE * link.radius:
                one, two = names[link.parent - 1], names[other - 1]
                notes.append(f"{names[number - 1]} begins at {one} and {two}, and is taken to leave {one}")
    return beside, notes


def _lead_on(box: Box, names: Sequence[str], links: dict[int, Link], spacing: Array) -> list[str]:
    """Leads vessels that touch their parent by a sliver on to it; returns notes."""
    notes = []
    for number, link in links.items():
        middle = link.ostium.mean(axis=0)
        low = np.maximum(np.floor((middle - _ABOUT) / spacing).astype(int), 0)
        high = np.ceil((middle + _ABOUT) / spacing).astype(int) + 1
        window = box[tuple(slice(a, b) for a, b in zip(low, high, strict=True))]
        ours, theirs = (np.argwhere(window == one) * spacing for one in (number, link.parent))
        thin = link.radius / _SLIVER
        led = led_on(window, number, ours, theirs, spacing, thin, _PARTLY) if len(theirs) else None
        if led:
            radii = f"{1e3 * link.radius:.1f} mm of radius and is led on to it with {1e3 * led[1]:.1f}"
            notes.append(f"{names[number - 1]} touches {names[link.parent - 1]} by {radii}")
    return notes


def _false_contacts(
    touching: Touching,
    links: dict[int, Link],
    root: int,
    waiting: Sequence[int],
    beside: dict[tuple[int, int], int],
) -> list[tuple[int, int, Array]]:
    """Pairs that touch where neither leaves the other, and where: (n, 3) m."""
    false = []
    for (a, b), (places, areas) in touching.items():
        if a in waiting or b in waiting:
            continue
        link = links[a] if a in links and links[a].beside == b else links.get(b)
        if link is not None and link.beside in (a, b):
            places = places[distances(places, link.ostium) > _CLUSTER]
        elif a in links and b in links and links[a].parent == links[b].parent != root:
            # the ridge where a trunk parts in two is no bridge
            for one in (links[a], links[b]):
                if len(places):
                    places = places[distances(places, one.ostium) > one.radius + _CLUSTER]
        elif (a, b) in beside:
            places = places[distances(places, links[beside[a, b]].ostium) > _CLUSTER]
        elif any(_is_mouth(places, areas, links[n]) for n in (a, b) if n in links):
            continue
        if len(places):
            false.append((a, b, places))
    return false


def _contacts(box: Box, spacing: Array) -> Touching:
    """Places (n, 3) m where two vessels touch, and the area (n,) m^2 of each, by pair; edges and corners have none."""
    area = [spacing[1] * spacing[2], spacing[0] * spacing[2], spacing[0] * spacing[1]]
    steps = list(np.ndindex(3, 3, 3))
    offsets = [tuple(int(n) - 1 for n in step) for step in steps]
    offsets = [o for o in offsets if o > (0, 0, 0)]
    contacts: dict[tuple[int, int], list[tuple[Array, Array]]] = {}
    for offset in offsets:
        window = tuple(slice(max(-o, 0), n - max(o, 0)) for o, n in zip(offset, box.shape, strict=True))
        shifted = tuple(slice(max(o, 0), n - max(-o, 0)) for o, n in zip(offset, box.shape, strict=True))
        a, b = box[window], box[shifted]
        places = np.argwhere((a != b) & (a > 0) & (b > 0))
        if len(places) == 0:
            continue
        first, second = a[tuple(places.T)].astype(int), b[tuple(places.T)].astype(int)
        middle = (places + [s.start for s in window] + np.array(offset) / 2) * spacing
        size = area[offset.index(1)] if offset in _AXES else 0.0
        for pair in {tuple(sorted(p)) for p in zip(first.tolist(), second.tolist(), strict=True)}:
            chosen = ((first == pair[0]) & (second == pair[1])) | ((first == pair[1]) & (second == pair[0]))
            contacts.setdefault((pair[0], pair[1]), []).append((middle[chosen], np.full(int(chosen.sum()), size)))
    return {pair: (np.concatenate([p for p, _ in parts]), np.concatenate([s for _, s in parts]))
            for pair, parts in contacts.items()}  # fmt: skip


def _parent(
    number: int,
    box: Box,
    names: Sequence[str],
    placed: Sequence[int],
    touching: Touching,
    spacing: Array,
    closed: bool,
) -> int | None:
    """The vessel that a vessel leaves; None as long as that has no place in the family itself."""
    areas = {b if a == number else a: float(sizes.sum()) for (a, b), (_, sizes) in touching.items() if number in (a, b)}
    largest = max(areas.values(), default=0.0)
    wide = {other: area for other, area in areas.items() if area > 0 and area >= _LEAST_SHARE * largest}
    usual = PARENTS.get(names[number - 1], ())
    possible = [other for name in usual for other in wide if names[other - 1] == name]
    if possible:
        parent = _take_off(number, box, possible, touching, spacing)[0]
        return parent if parent in placed else None
    if usual and not closed:
        return None  # a gap may part it from where it belongs
    wide = {other: area for other, area in wide.items() if other in placed}
    return max(wide, key=lambda other: wide[other]) if wide else None


def _take_off(number: int, box: Box, possible: Sequence[int], touching: Touching, spacing: Array) -> list[int]:
    """Vessels that a vessel may leave: the likeliest first, and without those that it only runs along.

    One that it touches with its whole section comes before one that it touches with less.

    Args:
        possible: that it touches, the most usual parent first.
    """
    if len(possible) < 2:
        return list(possible)
    links = {other: _link(number, other, touching) for other in possible}
    along, radius = from_far_end(box == number, {other: link.ostium for other, link in links.items()}, spacing)
    whole = [other for other in possible if links[other].radius >= _SLIVER * radius] or list(possible)
    first = max(along[other] for other in whole) - max(_ALONG[0] * radius, _ALONG[1])
    at_end = [other for other in possible if along[other] >= first]
    return sorted(at_end, key=lambda other: other not in whole)


def _is_mouth(places: Array, areas: Array, link: Link) -> bool:
    """Whether a contact with another vessel than the parent is too wide, and too near to the take-off, for a bridge."""
    wide = float(areas.sum()) > _MOUTH * np.pi * link.radius**2
    return wide and float(distances(places, link.ostium).min()) < _CLUSTER


def _raise_sisters(links: dict[int, Link], names: Sequence[str]) -> None:
    """Makes a vessel that leaves its sister right at the sister's own take-off a daughter of their trunk.

    The label of one of a trunk's two daughters often holds the place where they part.
    """
    for number, link in links.items():
        sister = links.get(link.parent)
        usual = PARENTS.get(names[number - 1], ())
        if (
            sister is None
            or names[link.parent - 1] not in PARENTS
            or names[sister.parent - 1] not in usual[: _rank(usual, names[link.parent - 1])]
        ):
            continue
        gap = float(np.linalg.norm(link.ostium.mean(axis=0) - sister.ostium.mean(axis=0)))
        side_branch = names[sister.parent - 1] == AORTA and names[link.parent - 1] in usual  # as a carotid of a trunk
        if gap < (_ONE_PLACE * sister.radius if side_branch else _SISTERS * (link.radius + sister.radius)):
            link.parent = sister.parent


def _rank(usual: Sequence[str], name: str) -> int:
    return usual.index(name) if name in usual else len(usual)


def _link(number: int, parent: int, touching: Touching) -> Link:
    places, areas = touching[min(number, parent), max(number, parent)]
    cluster = _main_cluster(places, areas)
    return Link(parent, parent, places[cluster], float(np.sqrt(max(areas[cluster].sum(), 1e-6) / np.pi)))


def _main_cluster(places: Array, areas: Array) -> NDArray[np.bool_]:
    """The contacts (n,) that hang together over the largest area."""
    from scipy.spatial import cKDTree

    pairs = cKDTree(places).query_pairs(_CLUSTER, output_type="ndarray")
    which = linked_parts(pairs[:, 0], pairs[:, 1], len(places))
    sizes = np.bincount(which, weights=areas + 1e-12)
    return which == int(np.argmax(sizes))


def _close_to_parent(box: Box, number: int, names: Sequence[str], placed: Sequence[int], spacing: Array) -> str:
    """Closes the gap between a vessel and the nearest that may be its parent; returns a note, or nothing."""
    usual = PARENTS.get(names[number - 1], tuple(names[p - 1] for p in placed))
    ours = np.argwhere(box == number) * spacing
    for candidate in usual:
        other = next((n for n, name in enumerate(names, 1) if name == candidate), None)
        theirs = np.argwhere(box == other) * spacing
        if not len(theirs):
            continue
        led = led_on(box, number, ours, theirs, spacing)
        gap = led[0] if led else bridge(box, number, ours, theirs, spacing)
        if gap is not None:
            return f"a gap of {1e3 * gap:.1f} mm between {names[number - 1]} and {candidate} is closed"
    return ""


def from_far_end(
    label: NDArray[np.bool_], contacts: Mapping[int, Array], spacing: Array
) -> tuple[dict[int, float], float]:
    """How far (m) each contact of a label lies along it, from the end that is farthest from all of them.

    Args:
        label: (nx, ny, nz) voxels of a vessel.
        contacts: by the vessel that is touched, (n, 3) m, in the lattice's axes.
        spacing: (3,) m between voxels.

    Returns:
        By the same vessels, 0 where no way within the label leads there; and the radius, m, of a tube of the label's
        length and volume.
    """
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import dijkstra
    from scipy.spatial import cKDTree

    voxels = np.argwhere(label)
    corner = voxels.min(axis=0)
    step = max(int(np.ceil((len(voxels) / _MOST_VOXELS) ** (1 / 3))), 1)
    places = np.unique((voxels - corner) // step, axis=0)
    pairs, lengths = neighbours(places, step * spacing)
    graph = csr_matrix((lengths, (pairs[:, 0], pairs[:, 1])), shape=(len(places),) * 2)
    tree = cKDTree((corner + places * step + (step - 1) / 2) * spacing)
    nodes = {other: tree.query(touched)[1] for other, touched in contacts.items()}
    near = np.unique(np.concatenate(list(nodes.values())))
    away = dijkstra(graph, directed=False, indices=near, min_only=True)
    far_end = int(np.argmax(np.where(np.isfinite(away), away, -1.0)))
    along = dijkstra(graph, directed=False, indices=far_end)
    along[~np.isfinite(along)] = 0.0
    length = max(float(along.max()), float(np.min(spacing)))
    radius = float(np.sqrt(len(voxels) * np.prod(spacing) / (np.pi * length)))
    return {other: float(np.median(along[some])) for other, some in nodes.items()}, radius
