"""Which label of a volume is which vessel: by the names in the file, by published numbers, or as the user says."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.mesh.report import MeshRefusedError
from cathsim.anatomy.vessel_names import AORTA, PARENTS, TOTALSEGMENTATOR, is_other, not_taken, of_one_name, vessel_name
from cathsim.anatomy.volume.labels.parts import distances

Key = tuple[int, int]  # layer and value of a label
Labels = Mapping[int | str, str | None] | None
Misfit = Callable[[str, dict[Key, str]], str]  # of a scheme and its vessels: why they cannot be these, or nothing

# Labels of the AortaSeg24 challenge: zones of the aorta (Ishimaru's, as the Society for Vascular Surgery numbers them)
# and its branches. Source: Imran et al., arXiv 2502.05330, numbered as the challenge's own evaluation does.
AORTASEG24: dict[int, str] = {
    **dict.fromkeys((1, 3, 5, 7, 8, 9, 10, 12, 14, 17), AORTA),
    2: "bca",
    4: "lcca",
    6: "lsa",
    11: "celiac",
    13: "mesenteric",
    15: "renal_right",
    16: "renal_left",
    18: "iliac_right",
    19: "iliac_left",
    20: "internal_iliac_right",
    21: "internal_iliac_left",
    22: "external_iliac_right",
    23: "external_iliac_left",
}
# Labels of TotalSegmentator's first version that are arteries, and its greatest number.
TOTALSEGMENTATOR_1: dict[int, str] = {7: AORTA, 51: "iliac_left", 52: "iliac_right"}
_LAST_OF_VERSION_1 = 104
_HEART_TO_ILIACS = range(51, 69)  # TotalSegmentator's second version: heart, arteries and great veins
_HEAD_AND_ARMS = {54, 55, 56, 57, 58}  # its branches of the arch
ARCH_ZONES = (1, 3, 5, 7)  # of AortaSeg24, from the heart on: about BCA, LCCA and LSA, and what follows them
_FEW = 24  # labels, of which none has a known name, that may together be a lumen


CELL = 2e-3  # m: places of labels are told as finely as this
_NEAR = 1e-2  # m, with cells and small gaps, within which a vessel is taken to leave another
_TAKE_OFF = 4e-3  # m beyond the least distance, within which cells belong to a take-off
_RIGHT, _LEFT = ("bca", "rsa", "rcca"), ("lcca", "lsa")
_FROM_ARCH = (*_RIGHT, *_LEFT, "iliac_right", "iliac_left")  # vessels of which one at least hangs on the aorta
Array = NDArray[np.float64]


@dataclass(frozen=True)
class LabelChoice:
    """The labels that make the lumen."""

    vessels: dict[Key, str]  # name of the vessel of each label that is used; one vessel may have several labels
    scheme: str  # where the names come from, for the report
    named: bool = True  # whether vessels are known by name; else the lumen is one piece, named by its shape
    notes: tuple[str, ...] = ()


def choose_labels(
    present: Mapping[Key, int], names: Mapping[Key, str], own: Labels, file: str, misfit: Misfit | None = None
) -> LabelChoice:
    """Chooses the labels of vessels among those that a volume has.

    Args:
        present: voxels of each label.
        names: of labels, as the file gives them.
        own: the user's mapping from a label's number, or its name in the file, to a vessel's name; None leaves a label
            out.
        misfit: says why labels cannot be the vessels that a published scheme makes of their numbers; such a scheme is
            not used. None believes the numbers.

    Raises:
        MeshRefusedError: no label is a vessel's, or the mapping names one that is not there.
    """
    if not present:
        raise MeshRefusedError(f"{file} is empty: all its voxels are zero; export the segmentation again.")
    if own:
        return _own_choice(present, names, own, file)
    if known := {key: vessel_name(names[key]) for key in present if vessel_name(names.get(key, ""))}:
        choice = _checked(_without_lumina(known), "names in the file", present, file, names)
        return replace(choice, notes=(*choice.notes, *_nameless(present, names)))
    if others := {key: count for key, count in present.items() if is_other(names.get(key, ""))}:
        raise MeshRefusedError(
            f"{file} has no label that is named after an artery ({_listed(others, names)}); export the aorta with its "
            "branches, or say which label is the aorta by labels={number: 'aorta'}."
        )
    values = {value for _, value in present}
    if len(present) == 1:
        return LabelChoice(dict.fromkeys(present, AORTA), "one label", named=False)
    doubts = []
    for scheme, table in (
        ("TotalSegmentator 2", TOTALSEGMENTATOR),
        ("AortaSeg24", AORTASEG24),
        ("TotalSegmentator 1", TOTALSEGMENTATOR_1),
    ):
        if not _fits(scheme, values):
            continue
        vessels = {key: table[key[1]] for key in present if key[1] in table}
        if doubt := misfit(scheme, vessels) if misfit else "":
            doubts.append(f"their numbers would be {scheme}'s, but {doubt}")
            continue
        choice = _checked(vessels, scheme, present, file, names)
        return replace(choice, notes=(f"which label is which vessel is guessed by {scheme}'s numbers", *choice.notes))
    if arteries := _without_aorta(values):
        raise MeshRefusedError(
            f"{file} has no label of the aorta: {arteries} are TotalSegmentator's, whose aorta is 52; export it too, "
            "or say which label is the aorta by labels={number: 'aorta'}."
        )
    because = f" ({'; '.join(doubts)})" if doubts else ""
    if names or len(present) > _FEW:
        text = _listed(present, names)
        raise MeshRefusedError(
            f"{file} has no label that is known as the aorta ({text}){because}; say which is which by labels={{number: "
            "'aorta', ...}."
        )
    note = (
        f"the labels {_listed(present, names)} have no known names{because}: together they are the lumen, whose "
        "vessels are named by their shape; labels={number: 'aorta', ...} says which is which"
    )
    return LabelChoice(dict.fromkeys(present, AORTA), "shape", named=False, notes=(note,))


def _fits(scheme: str, values: set[int]) -> bool:
    """Whether a volume's numbers may be those of a published scheme."""
    if scheme == "AortaSeg24":
        return max(values) <= max(AORTASEG24) and sum(zone in values for zone in ARCH_ZONES) >= 3
    if scheme == "TotalSegmentator 2":
        alone = values <= set(_HEART_TO_ILIACS)
        return 52 in values and (alone or max(values) > _LAST_OF_VERSION_1 or bool(values & _HEAD_AND_ARMS))
    return 7 in values and max(values) > max(AORTASEG24)


def _without_aorta(values: set[int]) -> str:
    """The arteries of TotalSegmentator's second version among labels that lack its aorta, for a message."""
    arteries = sorted(values & _HEAD_AND_ARMS)
    if 52 in values or not (values <= set(_HEART_TO_ILIACS) or max(values) > _LAST_OF_VERSION_1):
        return ""
    return ", ".join(f"{value} ({TOTALSEGMENTATOR[value]})" for value in arteries)


def _own_choice(present: Mapping[Key, int], names: Mapping[Key, str], own: Labels, file: str) -> LabelChoice:
    assert own is not None
    chosen: dict[Key, str] = {}
    for label, vessel in own.items():
        keys = [key for key in present if _is(label, key, names)]
        if not keys:
            raise MeshRefusedError(f"{file} has no label {label!r}; it has {_listed(present, names)}.")
        if vessel is not None:
            if len({names.get(key, "") for key in keys}) > 1:
                text = _listed({key: present[key] for key in keys}, names)
                raise MeshRefusedError(
                    f"{file} has the label {label} in {len(keys)} layers ({text}); give their names."
                )
            chosen |= dict.fromkeys(keys, vessel_name(str(vessel)) or str(vessel))
    others = {key: vessel_name(names.get(key, "")) for key in present if not any(_is(w, key, names) for w in own)}
    known = {key: name for key, name in others.items() if name not in ("", *chosen.values())}
    choice = _checked({**known, **chosen}, "given", present, file, names)
    return replace(choice, notes=(*choice.notes, *_nameless((key for key in others if key not in known), names)))


def _is(label: int | str, key: Key, names: Mapping[Key, str]) -> bool:
    text = str(label).strip()
    return text == str(key[1]) or text.lower() == names.get(key, "").strip().lower() != ""


def _without_lumina(known: dict[Key, str]) -> dict[Key, str]:
    """Leaves out the lumina of a dissected aorta where the whole one has a label."""
    if AORTA in known.values():
        return {key: name for key, name in known.items() if not name.endswith("_lumen")}
    return {key: AORTA if name == "true_lumen" else name for key, name in known.items() if name != "false_lumen"}


def _checked(
    vessels: dict[Key, str], scheme: str, present: Mapping[Key, int], file: str, names: Mapping[Key, str]
) -> LabelChoice:
    if AORTA not in vessels.values():
        raise MeshRefusedError(
            f"{file} has no label of the aorta ({_listed(present, names)}); say which it is by "
            "labels={number: 'aorta'}, or export it too."
        )
    left = (names.get(key, "") for key in sorted(present, key=lambda key: -present[key]) if key not in vessels)
    notes = (*not_taken(left, "labels"), *of_one_name((names.get(key, "") for key in vessels), "labels"))
    return LabelChoice(vessels, scheme, named=len(set(vessels.values())) > 1, notes=notes)


def _nameless(keys: Iterable[Key], names: Mapping[Key, str]) -> tuple[str, ...]:
    """A note on labels that are not taken, as nobody names them in a file that names others."""
    numbers = [str(key[1]) for key in keys if not names.get(key)]
    more = f" and {len(numbers) - 8} more" if len(numbers) > 8 else ""
    return (f"labels without a name are not taken: {', '.join(numbers[:8])}{more}",) if numbers else ()


def _listed(present: Mapping[Key, int], names: Mapping[Key, str]) -> str:
    label_names = [names.get(key, "") or str(key[1]) for key in sorted(present, key=lambda key: -present[key])]
    return ", ".join(label_names[:8]) + (f" and {len(label_names) - 8} more" if len(label_names) > 8 else "")


def misfit(scheme: str, vessels: Mapping[Key, str], places: Mapping[Key, Array], sizes: Mapping[Key, int]) -> str:
    """Why labels cannot be the vessels that a scheme makes of them, for a message; empty if they can.

    Args:
        scheme: as `choose_labels` names it.
        vessels: of every label, as the scheme has it.
        places: (n, 3) m, left, posterior and superior, of each label's voxels or of cells of `CELL` that hold some.
        sizes: voxels of each label.
    """
    if AORTA not in vessels.values():
        return "none would be the aorta"
    held = {name: sum(sizes[key] for key in vessels if vessels[key] == name) for name in vessels.values()}
    largest = max(held, key=lambda name: held[name])
    if largest != AORTA:
        return f"the {largest} would be larger than the aorta"
    clouds = {name: np.concatenate([places[k] for k in vessels if vessels[k] == name]) for name in held}
    first = [name for name in _FROM_ARCH if name in clouds]
    if first and not any(_hangs(name, clouds) for name in first):
        return f"{', '.join(first)} would not touch the aorta"
    if scheme == "AortaSeg24":
        return _zones_misfit(places, sizes) or sides_exchanged(clouds)
    return ""


def sides_exchanged(clouds: Mapping[str, Array]) -> str:
    """Which vessel of the left side lies to the right of one of the right side, for a message; empty where none does.

    Args:
        clouds: (n, 3) m, left, posterior and superior, by vessel.
    """
    for right in _RIGHT:
        for left in _LEFT:
            if right in clouds and left in clouds and clouds[left][:, 0].mean() < clouds[right][:, 0].mean():
                return f"the {left} would lie to the patient's right of the {right}"
    return ""


def _hangs(name: str, clouds: Mapping[str, Array]) -> bool:
    parents = [parent for parent in (AORTA, *PARENTS.get(name, ())) if parent in clouds]
    return any(distances(clouds[name], clouds[parent]).min() < _NEAR for parent in parents)


def _zones_misfit(places: Mapping[Key, Array], sizes: Mapping[Key, int]) -> str:
    """Why labels are no zones of the arch with its branches: each branch leaves its own zone, zones are wide."""
    zones = {key: places[key] for key in places if key[1] in ARCH_ZONES}
    branches = {key: places[key] for key in places if key[1] in (4, 6)}
    for key, branch in branches.items():
        away = {zone[1]: distances(branch, cloud) for zone, cloud in zones.items()}
        least = np.min(list(away.values()), axis=0)
        foot = least <= least.min() + _TAKE_OFF
        if 1 in away and np.mean(away[1][foot] <= least[foot]) > 0.5:
            return f"label {key[1]} leaves label 1, not the zone of the arch behind it"
    wide = {key[1]: _section(places[key], sizes[key]) for key in (*zones, *branches)}
    for stretch in (3, 5):
        for number in (4, 6):
            if stretch in wide and number in wide and wide[stretch] < wide[number]:
                return f"label {stretch} is no stretch of the arch: it is thinner than label {number}"
    return ""


def _section(cloud: Array, size: int) -> float:
    """Voxels per m of a label's greatest extent: its mean section, in a unit that all labels of a volume share."""
    offset = cloud - cloud.mean(axis=0)
    axis = np.linalg.svd(offset, full_matrices=False)[2][0]
    return size / (float(np.ptp(offset @ axis)) + CELL)
