"""Names of vessels as files give them (labels, parts of a scene, files of a folder), and what this project calls them.

Sources: the class list of TotalSegmentator v2 (Wasserthal et al., Radiology: AI 2023); preferred names and synonyms of
the Foundational Model of Anatomy for the aorta and the arteries of its arch.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

AORTA = "aorta"
SUPRA_AORTIC = ("bca", "rsa", "rcca", "lcca", "lsa")  # from the heart on, as in an arch of three branches
ACCESS = ("iliac_right", "iliac_left", "femoral_right", "femoral_left")  # the way of a wire from the groin
LUMINA = ("true_lumen", "false_lumen")  # of a dissected aorta

# Where a vessel can leave, the usual place first; others leave whatever they touch most.
PARENTS: dict[str, tuple[str, ...]] = {
    "bca": (AORTA,),
    "lcca": ("carotid_trunk", AORTA, "bca"),
    "lsa": ("subclavian_trunk", AORTA),
    "rsa": ("subclavian_trunk", "bca", AORTA),
    "rcca": ("carotid_trunk", "bca", "rsa", AORTA),
    "vertebral_left": ("lsa", AORTA),
    "vertebral_right": ("rsa", "bca"),
}

# Labels of TotalSegmentator's task "total", version 2, that are arteries.
TOTALSEGMENTATOR: dict[int, str] = {
    52: AORTA,
    54: "bca",
    55: "rsa",
    56: "lsa",
    57: "rcca",
    58: "lcca",
    65: "iliac_left",
    66: "iliac_right",
}

_ABBREVIATIONS: dict[str, str] = {
    **dict.fromkeys(("ao", "aa", "asc", "desc", "dao", "aao", "aoa", "arch"), AORTA),
    **dict.fromkeys(("bca", "bct", "bcta", "tbc", "innom", "co"), "bca"),
    **dict.fromkeys(("lcca", "lcc", "lccar", "ccal"), "lcca"),
    **dict.fromkeys(("rcca", "rcc", "rccar", "ccar"), "rcca"),
    **dict.fromkeys(("lsa", "lsca", "lscla", "lsub", "lsc", "scal"), "lsa"),
    **dict.fromkeys(("rsa", "rsca", "rscla", "rsub", "rsc", "arsa", "scar"), "rsa"),
    **dict.fromkeys(("lva", "lvert"), "vertebral_left"),
    **dict.fromkeys(("rva", "rvert"), "vertebral_right"),
    **dict.fromkeys(("lica",), "internal_carotid_left"),
    **dict.fromkeys(("rica",), "internal_carotid_right"),
    **dict.fromkeys(("leca",), "external_carotid_left"),
    **dict.fromkeys(("reca",), "external_carotid_right"),
}
_LEFT, _RIGHT = {"left", "l", "lt", "sinistra", "sinister"}, {"right", "r", "rt", "dextra", "dexter"}
# What a word that begins so says about a name; the first that fits counts, and None says: no artery of interest.
_STEMS: tuple[tuple[tuple[str, ...], str | None], ...] = (
    (("vein", "vena", "venous", "sinus", "portal", "atri", "ventric", "valve", "myocard", "heart"), None),
    (("pulmon", "coronar", "circumflex", "cardiac", "marginal", "diagonal", "lung"), None),
    (("brachioceph", "innominat", "anonym", "bovine"), "bca"),
    (("subclav",), "subclavian"),
    (("vertebral",), "vertebral"),
    (("axillar",), "axillary"),
    (("iliac", "iliaca"), "iliac"),
    (("femoral",), "femoral"),
    (("renal",), "renal"),
    (("celiac", "coeliac"), "celiac"),
    (("mesenteric",), "mesenteric"),
    (("carotid", "carotis"), "carotid"),
    (("aort",), AORTA),
)
_PAIRED = {"carotid": ("lcca", "rcca"), "subclavian": ("lsa", "rsa")}


def vessel_name(text: str) -> str:
    """The project's name of a vessel that a file calls `text`; empty where it is none of the known arteries.

    "aorta", "bca", "rsa", "rcca", "lcca", "lsa", and for others a plain one with its side: "iliac_left",
    "vertebral_right", "internal_carotid_left"; "true_lumen" and "false_lumen" of a dissected aorta.
    """
    words = _words(text)
    joined = " ".join(words)
    for stems, meaning in _STEMS:
        if meaning is None and any(word.startswith(stems) for word in words):
            return ""
    side = "left" if _LEFT & set(words) else "right" if _RIGHT & set(words) else ""
    for lumen in ("true", "false"):
        if f"{lumen} lumen" in joined:
            return f"{lumen}_lumen"
    for stems, meaning in _STEMS:
        if meaning is not None and any(word.startswith(stems) for word in words):
            return _sided(meaning, side, words)
    if "cca" in words and side:
        return _PAIRED["carotid"][side == "right"]
    if {"sca", "sa", "sub"} & set(words) and side:
        return _PAIRED["subclavian"][side == "right"]
    for word in words:
        if word in _ABBREVIATIONS:
            return _ABBREVIATIONS[word]
    return ""


def vessel_names(texts: Iterable[str]) -> dict[str, str]:
    """The project's name of every text that is a known artery's."""
    found = {text: vessel_name(text) for text in texts}
    return {text: name for text, name in found.items() if name}


def _sided(meaning: str, side: str, words: list[str]) -> str:
    if meaning in ("carotid", "iliac") and (part := next((w for w in words if w in ("internal", "external")), "")):
        return "_".join(word for word in (part, meaning, side) if word)
    if meaning in _PAIRED:
        return _PAIRED[meaning][side == "right"] if side else meaning
    if meaning in (AORTA, "bca"):
        return meaning
    return f"{meaning}_{side}" if side else meaning


def _words(text: str) -> list[str]:
    """Lower-case words; capitals within a word and digits part them, as in "LeftCommonCarotid2"."""
    parted = re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", " ", text)
    return [word.lower() for word in re.split(r"[^A-Za-z]+", parted) if word]
