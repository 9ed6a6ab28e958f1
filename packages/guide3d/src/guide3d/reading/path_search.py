"""Search for the wire: the sequence of pieces, tip first, that gathers most probability at the least cost of links."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from guide3d.geometry.polyline import Array
from guide3d.reading.links import Link

# end, pieces walked once and twice: score, px of pieces, px of empty gaps, entries
_States = dict[tuple[int, int, int], tuple[float, float, float, tuple[int, ...]]]


# What a path costs besides its links, in px of certain wire.
_STARTS = 10  # ends that are tried as tips, the cheapest ones
_BEAM = 24  # partial paths from one tip that are followed at a time
CANDIDATES = 5  # paths that are returned
TWICE_PX = 90.0  # longest piece that may be walked twice, where a wire lies over itself
_TWICE_PER_PX = 0.2  # cost of a px that is walked twice
_FOLD = 8.0  # cost of turning back at the end of a piece, as a tip does that lies over its wire
_DEEPEST = 40  # most pieces of a path
GUESSED = 1 / 3  # largest share of a path that is empty gaps; beyond, two devices may have been joined


@dataclass(frozen=True)
class Path:
    """An ordered walk over pieces.

    score: px of certain wire
    entries: ends by which the pieces are entered, tip first; a path leaves piece k by the other end, entry ^ 1
    """

    score: float
    entries: tuple[int, ...]

    @property
    def pieces(self) -> frozenset[int]:
        """Numbers of the pieces."""
        return frozenset(entry // 2 for entry in self.entries)


def search(
    worth: Array,
    lengths: Array,
    links: list[list[Link]],
    start_cost: Array,
    end_cost: Array,
    shared: NDArray[np.bool_],
) -> list[Path]:
    """Finds the best paths by beam search.

    Args:
        worth, lengths: (k,) px of each piece.
        links: of each end that is left, those that may follow.
        start_cost, end_cost: (2 k,) of starting (the tip) and of ending at an end.
        shared: (k,) whether a piece may be walked twice.

    Returns:
        Paths of different pieces or starts, best first, at most eight times `CANDIDATES`.
    """
    worths, spans = worth.tolist(), lengths.tolist()
    starts, stops, may_share = start_cost.tolist(), end_cost.tolist(), shared.tolist()
    again = [_TWICE_PER_PX * span if may else np.inf for span, may in zip(spans, may_share, strict=True)]
    likely = sorted(range(2 * len(worths)), key=lambda end: starts[end] - 0.3 * min(worths[end // 2], 100.0))
    finished: dict[tuple[int, int], Path] = {}
    # each start has a beam of its own: a path that begins with short pieces must not lose to one that begins with long
    for start in likely[:_STARTS]:
        states: _States = {
            (start, 1 << (start // 2), 0): (worths[start // 2] - starts[start], spans[start // 2], 0.0, (start,))
        }
        for depth in range(_DEEPEST):
            best = sorted(states.items(), key=lambda item: -item[1][0])[:_BEAM]
            states = {}
            for (entered, once, twice), (score, seen, empty, entries) in best:
                leaving = entered ^ 1
                whole = score - stops[leaving]
                key = (start, once)
                joined = empty <= GUESSED * (empty + seen)
                if joined and (key not in finished or finished[key].score < whole):
                    finished[key] = Path(whole, entries)
                onward = links[leaving]
                if depth == 0 and may_share[entered // 2]:
                    onward = [*onward, Link(leaving, _FOLD, 0.0)]
                for end, cost, gap in onward:
                    piece = end // 2
                    bit = 1 << piece
                    if not once & bit:
                        gained, after = worths[piece] - cost, (end, once | bit, twice)
                    elif not twice & bit and may_share[piece]:
                        gained, after = -cost - again[piece], (end, once, twice | bit)
                    else:
                        continue
                    value = score + gained
                    if after not in states or states[after][0] < value:
                        states[after] = (value, seen + spans[piece], empty + gap, (*entries, end))
            if not states:
                break
    paths = sorted(finished.values(), key=lambda path: -path.score)
    return paths[: 8 * CANDIDATES]
