"""What a generated arch is made from: the measures of one, or type and seed of one of the arch variety."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from cathsim.anatomy.generator.aortic_arch import build_arch
from cathsim.anatomy.generator.arch_parameters import Aneurysm, ArchParameters
from cathsim.anatomy.generator.random_arch import sample_parameters
from cathsim.anatomy.generator.variety.branching_types import ARCH_TYPES
from cathsim.anatomy.generator.variety.variety_arch import VarietyArch, build_variety_arch, drawn_type
from cathsim.anatomy.vessel_tree import VesselTree

GENERATOR_VERSION = 6  # raise it whenever the same measures give another geometry
VARIETY_VERSION = 1  # the same for the arch variety
VARIETY_FILLET = 2.5e-3  # m, rounding of its ostia
VARIETY = "arch_variety"
_OF_TYPE = {f"{VARIETY}_{arch_type}": arch_type for arch_type in ARCH_TYPES}
RANDOM = ("random", "random_wide", VARIETY, *_OF_TYPE)  # names that need a seed

Recipe = ArchParameters | VarietyArch


def draw_recipe(name: str, seed: int) -> Recipe:
    """The arch of a name of RANDOM and a seed."""
    if name == VARIETY:
        return VarietyArch(drawn_type(seed), seed)
    if name in _OF_TYPE:
        return VarietyArch(_OF_TYPE[name], seed)
    return sample_parameters(np.random.default_rng(seed), wide=name == "random_wide")


def build_tree(recipe: Recipe) -> VesselTree:
    """The vessel tree of a recipe.

    Raises:
        ValueError: the measures cannot be joined to an arch.
    """
    return build_variety_arch(recipe) if isinstance(recipe, VarietyArch) else build_arch(recipe)


def fillet_radius(recipe: Recipe) -> float:
    """Rounding of the ostia, m."""
    return VARIETY_FILLET if isinstance(recipe, VarietyArch) else recipe.fillet_radius


def recipe_content(recipe: Recipe) -> dict[str, Any]:
    """All that determines the tree, as JSON holds it; for `recipe_of`."""
    values = dataclasses.asdict(recipe)
    if isinstance(recipe, VarietyArch):
        return {"variety_generator": VARIETY_VERSION, "variety": values}
    return {"generator": GENERATOR_VERSION, "parameters": values}


def recipe_of(content: Mapping[str, Any]) -> Recipe:
    """The recipe of a content, whatever the generators' versions."""
    if "variety" in content:
        return VarietyArch(**content["variety"])
    measures = dict(content["parameters"])
    if measures.get("aneurysm") is not None:
        measures["aneurysm"] = Aneurysm(**measures["aneurysm"])
    return ArchParameters(**measures)
