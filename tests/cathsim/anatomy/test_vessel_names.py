"""Vessels are known by the names that segmentations, atlases and modelling tools give them."""

from __future__ import annotations

import pytest

from cathsim.anatomy.vessel_names import SUPRA_AORTIC, TOTALSEGMENTATOR, vessel_name, vessel_names

KNOWN = {
    "aorta": ("aorta.nii.gz", "VHF_descending_aorta_b", "aortic arch", "AAo", "Thoracic Aorta"),
    "bca": ("brachiocephalic_trunk", "VHF_brachiocephalic_artery_a", "Innominate", "bct", "BCA.stl", "co"),
    "lcca": ("common_carotid_artery_left", "LCCA", "LeftCommonCarotid2", "A. carotis communis sinistra", "L CCA"),
    "rcca": ("right common carotid artery", "rcca_01"),
    "lsa": ("subclavian_artery_left", "left subclavian", "LSCA"),
    "rsa": ("R_SCA", "arteria subclavia dextra", "ARSA"),
    "vertebral_left": ("left vertebral artery", "LVA"),
    "internal_carotid_right": ("Right Internal Carotid Artery",),
    "internal_iliac_left": ("internal_iliac_artery_L",),
    "true_lumen": ("aorta_true_lumen",),
    "": (
        "brachiocephalic_vein_left",
        "left coronary artery",
        "pulmonary_artery_R",
        "aortic valve",
        "mesh",
        "",
        "part 3",
    ),
}


@pytest.mark.parametrize(("text", "name"), [(text, name) for name, texts in KNOWN.items() for text in texts])
def test_a_vessel_is_known_by_its_name(text: str, name: str):
    assert vessel_name(text) == name


def test_only_arteries_are_named():
    assert vessel_names(["aorta", "inferior vena cava", "LSA"]) == {"aorta": "aorta", "LSA": "lsa"}
    assert set(SUPRA_AORTIC) < set(TOTALSEGMENTATOR.values())
