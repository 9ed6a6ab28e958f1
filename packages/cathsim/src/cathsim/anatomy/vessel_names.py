"""Names of vessels as files give them (labels, parts of a scene, files of a folder), and what this project calls them.

A name is an artery's where all its words are: one known term, its side, and words that say nothing of what it is. Any
other word makes it a name that only resembles one ("iliac bone", "aortic wall"), which is none.

Sources: the class list of TotalSegmentator v2 (Wasserthal et al., Radiology: AI 2023); preferred names and synonyms of
the Foundational Model of Anatomy for the aorta and the arteries of its arch; Terminologia Anatomica for the Latin ones.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Mapping

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


def _spelled(words: Mapping[str, str]) -> dict[str, str]:
    """The word that is meant, by each of its spellings."""
    return {spelling: word for word, spellings in words.items() for spelling in (word, *spellings.split())}


def _these(words: str) -> frozenset[str]:
    return frozenset(words.split())


# English, Latin, and what German, French, Spanish and Italian have of their own, without accents
_SPELLINGS = _spelled(
    {
        "left": "l lt li links linke linker gauche izquierda izquierdo sin sinistra sinister sinistrum sx",
        "right": "r rt re rechts rechte rechter droite derecha derecho dex dx dextra dexter dextrum destra der",
        "artery": "arteria arterie artere arterial arteriel art",
        "trunk": "truncus tronc tronco tr",
        "aorta": "aortae aorte aortenbogen ao",
        "aortic": "aortica aortique aortico",
        "arch": "arcus arco bogen crosse",
        "root": "bulb bulbus radix",
        "ascending": "ascendens ascendente ascendante asc",
        "descending": "descendens descendente descendante desc",
        "thoracic": "thoracica thoracalis thorakale thoracique toracica",
        "abdominal": "abdominalis abdominale",
        "common": "communis commune comune comun",
        "internal": "interna interne int",
        "external": "externa externe esterna ext",
        "superior": "sup superieure",
        "inferior": "inf inferieure",
        "superficial": "superficialis",
        "deep": "profunda profonda",
        "carotid": "carotis carotide carotida carotidea",
        "bicarotid": "bicaroticus bicarotideus",
        "subclavian": "subclavia succlavia sousclaviere sca sub",
        "brachiocephalic": "brachiocephalicus brachiocephalica brachiocephalique brachiocefalico braquiocefalico",
        "innominate": "innominata innom anonyma anonima",
        "vertebral": "vertebralis vertebrale",
        "axillary": "axillaris axillaire ascellare axilar",
        "iliac": "iliaca iliaque",
        "femoral": "femoralis femorale",
        "renal": "renalis renale",
        "celiac": "coeliac celiaca coeliaca coeliacus celiaco celiaque",
        "mesenteric": "mesenterica mesenterique",
    }
)
_PARTS_OF_AORTA = _these(
    "arch root isthmus ascending descending transverse thoracic abdominal infrarenal suprarenal juxtarenal"
)
# Words that do not say which vessel it is: of parts, of what a program makes, endings of files
_STRETCH = _these("proximal distal part segment section portion")
_PASSING = _STRETCH | _these(
    "lumen lumina vessel blood contrast enhanced main whole the of a b "
    "c d e f version final new edited smooth smoothed clean cleaned remeshed closed open cut mask label "
    "labels seg segmentation surface mesh model object group geometry roi patient pat case subject vhf vhm scan "
    "ct cta cect mra mr stl obj ply vtp vtk glb gltf nii gz nrrd nhdr mha mhd dcm"
)
# Vessels by the words that name them. Those of the second table are adjectives, of bones and organs as well: they need
# a side, or the word artery or trunk.
_NOUNS: dict[str, str] = {
    "brachiocephalic": "bca",
    "brachiocephalic trunk": "bca",
    "innominate": "bca",
    "innominate trunk": "bca",
    "bovine": "bca",
    "bovine trunk": "bca",
    "carotid": "carotid",
    "common carotid": "carotid",
    "internal carotid": "internal_carotid",
    "external carotid": "external_carotid",
    "carotid trunk": "carotid_trunk",
    "common carotid trunk": "carotid_trunk",
    "bicarotid trunk": "carotid_trunk",
    "subclavian": "subclavian",
    "aberrant subclavian": "subclavian",
    "subclavian trunk": "subclavian_trunk",
}
_ADJECTIVES: dict[str, str] = {
    "vertebral": "vertebral",
    "axillary": "axillary",
    "iliac": "iliac",
    "common iliac": "iliac",
    "internal iliac": "internal_iliac",
    "external iliac": "external_iliac",
    "femoral": "femoral",
    "common femoral": "femoral",
    "superficial femoral": "superficial_femoral",
    "deep femoral": "deep_femoral",
    "renal": "renal",
    "celiac": "celiac",
    "celiac trunk": "celiac",
    "mesenteric": "mesenteric",
    "superior mesenteric": "mesenteric",
    "inferior mesenteric": "inferior_mesenteric",
}
_TERMS = {frozenset(term.split()): vessel for term, vessel in (*_NOUNS.items(), *_ADJECTIVES.items())}
# Abbreviations that are whole names; those of the second table need a side, or have it as their first letter.
_ABBREVIATIONS: dict[str, str] = {
    **dict.fromkeys(("aa", "dao", "aao", "aoa", "arch"), AORTA),
    **dict.fromkeys(("bca", "bct", "bcta", "tbc", "tabc", "btrunk", "co"), "bca"),
    **dict.fromkeys(("lccar", "ccal"), "lcca"),
    **dict.fromkeys(("rccar", "ccar"), "rcca"),
    **dict.fromkeys(("arsa", "lusoria"), "rsa"),
    "tl": "true_lumen",
    "fl": "false_lumen",
}
_SIDED: dict[str, str] = {
    "cca": "carotid",
    "ica": "internal_carotid",
    "eca": "external_carotid",
    **dict.fromkeys(("sa", "sca", "scla", "sub", "sc"), "subclavian"),
    **dict.fromkeys(("va", "vert"), "vertebral"),
    "cia": "iliac",
    "iia": "internal_iliac",
    "eia": "external_iliac",
    "cfa": "femoral",
}
_ABBREVIATIONS |= {
    f"{side[0]}{short}": f"{vessel} {side}" for short, vessel in _SIDED.items() for side in ("left", "right")
}
_PAIRED = {"carotid": ("lcca", "rcca"), "subclavian": ("lsa", "rsa")}
_OWN_NAMES = frozenset(
    {AORTA, *SUPRA_AORTIC, *LUMINA, *PARENTS, *_TERMS.values()}
    - {"vertebral", "axillary", "iliac", "femoral", "renal"}  # without a side they are no artery's
)
# Words of what is no artery of interest, in small letters and the singular.
_OTHER = _these(
    "v vv vn ven vein vena venous vene veine venae vc ivc svc sinus portal azygos jugular bone os spine spinal "
    "column vertebra vertebrae body rib costa sternum sacrum femur hip ilium pelvis humerus scapula clavicle "
    "clavicula skull mandible crest cord disc discs liver kidney spleen stomach pancreas bladder prostate uterus "
    "colon bowel intestine duodenum esophagus oesophagus trachea bronchus bronchi lung pleura heart cardiac "
    "ventricle atrium atrial auricle appendage myocardium pericardium valve leaflet cusp coronary pulmonary brain "
    "cerebellum thyroid gland adrenal muscle musc gluteus iliopsoas iliacus psoas autochthon fat skin n nn nerve "
    "ganglion sheath lymph ln node gtv ctv itv ptv prv tumor tumour cyst lesion wall thromb thrombus thrombosis ilt "
    "flt pvat clot calcification calcium calcified plaque aneurysm hematoma haematoma dissection flap stent graft "
    "endograft prosthesis catheter guidewire wire air background tissue table"
)
_FEW_NAMES = 8  # in a list


def vessel_name(text: str) -> str:
    """The project's name of a vessel that a file calls `text`; empty where it is none of the known arteries.

    "aorta", "bca", "rsa", "rcca", "lcca", "lsa", and for others a plain one with its side: "iliac_left",
    "vertebral_right", "internal_carotid_left"; "true_lumen" and "false_lumen" of a dissected aorta; "carotid_trunk"
    and "subclavian_trunk" that both sides share.
    """
    if text.strip().lower() in _OWN_NAMES:
        return text.strip().lower()
    plain = _words(text)
    words = [_SPELLINGS.get(word, word) for word in plain]
    side = {"left", "right"}.intersection(words)
    lumen = {"true", "false"}.intersection(words) if "lumen" in words else set()
    rest = frozenset(words) - _PASSING - side - lumen - {"artery"}
    if len(side) > 1 or len(lumen) > 1:
        return ""
    if lumen:
        return f"{lumen.pop()}_lumen" if rest <= {AORTA, "aortic", *_PARTS_OF_AORTA} else ""
    if AORTA in rest or ("aortic" in rest and _PARTS_OF_AORTA & rest):
        return AORTA if rest <= {AORTA, "aortic", *_PARTS_OF_AORTA} else ""
    which = side.pop() if side else ""
    if vessel := _TERMS.get(rest, ""):
        latin = plain[0] == "a" and plain[1] != words[1]  # "A vertebralis", not "a vertebral"
        sure = latin or {"artery", "trunk"}.intersection(words)
        if vessel == "bca":
            return vessel if sure or not which else ""  # those of a side are veins where nothing else is said
        level = vessel == "vertebral" and not {"left", "right"}.intersection(plain)  # "vertebral L" is a bone
        if " ".join(sorted(rest)) in _NEED_MORE and not sure and (level or not which):
            return ""
        return _with_side(vessel, which)
    short = frozenset(plain) - _PASSING - {"artery", "arteria"} - {w for w in plain if _SPELLINGS.get(w) == which}
    if len(short) != 1:
        return ""
    word = next(iter(short))
    if which:
        return _with_side(_SIDED[word], which) if word in _SIDED else ""
    return _with_side(*_ABBREVIATIONS.get(word, "").partition(" ")[::2])


def is_other(text: str) -> bool:
    """Whether a name is that of something else than a lumen of arteries: a bone, an organ, a vein, a wall."""
    return not vessel_name(text) and any(word in _OTHER or word.removesuffix("s") in _OTHER for word in _words(text))


def name_of_segment(label: str, meanings: Iterable[str]) -> str:
    """A segment's label, or, where that says nothing, the first of its codes' meanings that is an artery's."""
    if vessel_name(label) or is_other(label):
        return label
    return next(filter(vessel_name, meanings), label)


def not_taken(texts: Iterable[str], what: str) -> tuple[str, ...]:
    """A note on names that are no known artery's, those that resemble one first; none where all are.

    Args:
        what: things have these names, in the plural.
    """
    left = [text for text in texts if text and not vessel_name(text)]
    left.sort(key=lambda text: not _VESSEL_WORDS.intersection(_SPELLINGS.get(word, word) for word in _words(text)))
    more = f" and {len(left) - _FEW_NAMES} more" if len(left) > _FEW_NAMES else ""
    listing = ", ".join(left[:_FEW_NAMES])
    return (f"{what} not taken, whose names are no known artery's: {listing}{more}",) if left else ()


def of_one_name(texts: Iterable[str], what: str) -> tuple[str, ...]:
    """A note on names that say the same of one vessel ("aorta", "aorta_new"), not of stretches of it; none if none do.

    Args:
        what: things have these names, in the plural.
    """
    same: dict[tuple[str, frozenset[str]], list[str]] = {}
    for text in texts:
        if vessel := vessel_name(text):
            words = frozenset(_SPELLINGS.get(word, word) for word in _words(text)) - (_PASSING - _STRETCH)
            same.setdefault((vessel, words), []).append(text)
    twice = [" and ".join(some[:_FEW_NAMES]) for some in same.values() if len(some) > 1]
    return (f"{what} of one vessel's name are taken together: {', '.join(twice)}",) if twice else ()


_NEED_MORE = frozenset(" ".join(sorted(term.split())) for term in _ADJECTIVES)
_VESSEL_WORDS = frozenset(
    {AORTA, "aortic", "artery", *(word for term in _TERMS for word in term)} - {"common", "internal", "external"}
)


def _with_side(vessel: str, side: str) -> str:
    if side and vessel in _PAIRED:
        return _PAIRED[vessel][side == "right"]
    return f"{vessel}_{side}" if side and not vessel.endswith(("_trunk", "celiac", "mesenteric")) else vessel


def _words(text: str) -> list[str]:
    """Words in small letters, without accents and numbers; capitals within a word part it ("LeftCommonCarotid2").

    A letter with a number stays one, for that is a vertebra ("L3"), but for a version ("v2"). A subject's number at the
    beginning ("sub-01", "s0011") is left out, no other word: "NOT_AORTA" and "PRV05_Aorta" are no aortas.
    """
    ascii_text = unicodedata.normalize("NFKD", text).encode("ascii", "ignore").decode()
    ascii_text = re.sub(r"(?i)\b(brachio|sous)[-_ ](?=c)", r"\1", ascii_text)  # French
    ascii_text = re.sub(r"(?i)^node[-_. ]*\d+", "", ascii_text)  # a scene's; any other node is a lymph node
    parted = re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", " ", ascii_text)
    raw = [word for word in re.split(r"[^a-z0-9]+", parted.lower()) if word and not re.fullmatch(r"v\d+", word)]
    if len(raw) > 2 and raw[0] == "sub" and raw[1].isdecimal():
        raw = raw[2:]
    if len(raw) > 1 and re.fullmatch(r"[a-z]?\d{3,}", raw[0]):
        raw = raw[1:]
    words = [word if re.fullmatch(r"[a-z]\d+", word) else word.rstrip("0123456789") for word in raw]
    return [word for word in words if word]
