"""Vessels are known by the names that segmentations, atlases and modelling tools give them, and by whole ones alone."""

import pytest

from cathsim.anatomy.mesh.report import MeshRefusedError
from cathsim.anatomy.vessel_names import (
    ACCESS,
    LUMINA,
    PARENTS,
    SUPRA_AORTIC,
    TOTALSEGMENTATOR,
    not_taken,
    vessel_name,
)
from cathsim.anatomy.volume.labels.choice import AORTASEG24, choose_labels

KNOWN = {
    "aorta": (
        "aorta.nii.gz", "VHF_descending_aorta_b", "aortic arch", "AAo", "Thoracic Aorta", "Aorta descendens",
        "Arcus aortae", "thoracic aorta", "aortic root", "sub-01_aorta", "patient7_aorta_final_v2",
        "s0011_AscendingAorta", "A_Aorta_Asc", "Aortenbogen", "Arco aortico", "node_12_aorta",
    ),
    "bca": (
        "brachiocephalic_trunk", "VHF_brachiocephalic_artery_a", "Innominate", "bct", "BCA.stl", "co",
        "Truncus brachiocephalicus", "Tr. brachiocephalicus", "TABC",
        "tronc artériel brachio-céphalique", "left brachiocephalic artery",
    ),
    "lcca": (
        "common_carotid_artery_left", "LCCA", "LeftCommonCarotid2", "A. carotis communis sinistra", "L CCA", "VHM_LCCA",
        "A. carotis communis sin.", "artère carotide commune gauche", "arteria carótida común izquierda",
        "carotid_l", "lt-carotid",
    ),
    "rcca": ("right common carotid artery", "rcca_01", "A. carotis communis dx"),
    "lsa": ("subclavian_artery_left", "left subclavian", "LSCA", "A. subclavia sin.", "artère sous-clavière gauche"),
    "rsa": ("R_SCA", "arteria subclavia dextra", "ARSA", "A. subclavia dex", "aberrant right subclavian artery"),
    "vertebral_left": ("left vertebral artery", "LVA", "Arteria vertebralis sinistra", "A vertebralis sin."),
    "internal_carotid_right": ("Right Internal Carotid Artery", "internal_carotid_artery_right", "R ICA"),
    "internal_iliac_left": ("internal_iliac_artery_L",),
    "external_iliac_left": ("A. iliaca externa sin.",),
    "iliac_left": ("left iliac artery", "LCIA", "lt_iliac"),
    "superficial_femoral_right": ("right superficial femoral artery",),
    "mesenteric": ("superior mesenteric artery",),
    "inferior_mesenteric": ("inferior mesenteric artery",),
    "carotid_trunk": ("common carotid trunk", "Truncus bicaroticus"),
    "true_lumen": ("aorta_true_lumen", "TL"),
    "false_lumen": ("false lumen of the aorta",),
    "": (
        "brachiocephalic_vein_left", "left coronary artery", "pulmonary_artery_R", "aortic valve", "mesh", "", "part 3",
        # bones
        "lumbar vertebral column", "vertebral body", "vertebrae_T12", "vertebral L3", "vertebral L",
        "left iliac crest", "femoral head left", "iliac bone", "vertebrae_body",
        "zygomatic_arch_left", "vertebral arch",
        # organs and tissue
        "iliacus", "renal pelvis", "left kidney", "carotid sheath", "carotid body", "subclavius", "celiac ganglion",
        "mesenteric fat", "quadriceps_femoris_left", "prevertebral_left", "LEFT KIDNEY AORTA", "myocardial scar",
        # veins
        "iliac vein left", "iliac_vena_left", "superior mesenteric vein", "innominate vein", "left brachiocephalic",
        "V_Subclavian_L", "V. subclavia sinistra", "v. carotis", "V_Iliac_L", "VEN_ILIACA_L", "VN_SUBCLAVIA_L",
        # nerves, lymph nodes, volumes to irradiate, vertebrae, and what a first word denies
        "N. femoralis links", "N_Femoral_L", "LN_Iliac_L", "GTV_Carotid_L", "PTV aorta", "PRV05_Aorta", "A_Aorta_PRV05",
        "PTV5040_Iliac_L", "C7_vertebral_left", "L4 left vertebral", "MUSC_femoral_left", "NOT_AORTA", "NO AORTA",
        # of arteries, but no lumen of one
        "THROMB_AORTA", "ILT2_aorta", "IMH aorta", "CALC_AORTA", "RING_aorta", "PLAQ_carotid_left",
        "aortic wall", "aorta calcification", "aortic aneurysm thrombus", "stent graft aorta", "false lumen thrombus",
        "FLT", "aorta plaque", "PVAT_aorta", "periaortic lymph node", "left_coronary_cusp",
        "Left iliac node", "Iliac_Node_L", "Node_Carotid_L", "carotid nodes left", "a vertebral L",
        # of no one vessel, or of no known one
        "left and right iliac artery", "iliac arteries", "femoral", "RCA", "LCA", "true and false lumen",
    ),
}  # fmt: skip


def test_a_vessel_is_known_by_its_name():
    expected = {text: name for name, texts in KNOWN.items() for text in texts}
    assert {text: vessel_name(text) for text in expected} == expected


def test_the_projects_own_names_mean_themselves():
    own = {*SUPRA_AORTIC, *ACCESS, *LUMINA, *PARENTS, *TOTALSEGMENTATOR.values(), *AORTASEG24.values()}
    assert {name: vessel_name(name) for name in own} == {name: name for name in own}


def test_what_is_not_taken_is_listed_with_those_that_resemble_first():
    (note,) = not_taken(["spleen", *(f"rib_left_{n}" for n in range(1, 9)), "aortic wall", "aorta"], "labels")
    assert note.startswith("labels not taken")
    assert "aortic wall, spleen, rib_left_1" in note
    assert note.endswith("rib_left_6 and 2 more")
    assert not_taken(["aorta"], "labels") == ()


def test_beside_an_aorta_only_names_of_arteries_are_taken():
    texts = [text for text in KNOWN[""] if text]
    names = {(0, 1): "aorta"} | {(0, number): text for number, text in enumerate(texts, 2)}
    choice = choose_labels(dict.fromkeys(names, 100), names, None, "a.nii.gz")
    assert choice.vessels == {(0, 1): "aorta"}
    assert any(note.endswith(f" and {len(texts) - 8} more") for note in choice.notes)


def test_published_numbers_do_not_overrule_names():
    names = {(0, 52): "liver", (0, 58): "spleen"}
    with pytest.raises(MeshRefusedError, match=r"no label that is named after an artery \(liver"):
        choose_labels(dict.fromkeys(names, 100), names, None, "a.nii.gz")
