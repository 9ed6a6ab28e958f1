"""What a generated anatomy is made from: measures, or the seed of an arch of the variety or as of a scan, or a tree."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from cathsim.anatomy.distance_grid import SignedDistanceGrid
from cathsim.anatomy.generator.arch_parameters import Aneurysm, ArchParameters
from cathsim.anatomy.generator.random_tree import RandomTree, build_random_tree
from cathsim.anatomy.generator.scan_arch import (
    COMMON,
    STEEP,
    TRUNK,
    ScanArch,
    build_scan_arch,
    drawn_relief,
    sample_parameters,
)
from cathsim.anatomy.generator.variety_arch import ARCH_TYPES, VarietyArch, build_variety_arch, drawn_type
from cathsim.anatomy.vessel_tree import VesselTree

GENERATOR_VERSION = 6  # raise it whenever the same measures give another geometry
VARIETY_VERSION = 1  # the same for the arch variety
SCAN_VERSION = 1  # ... and for arches as scans show them
FILLET = 2.5e-3  # m, rounding of the ostia where no measure says it
TREE_VERSION = 1  # ... and for trees
SCAN, VARIETY, TREE = "random_scan", "arch_variety", "random_tree"
_OF_TYPE = {f"{VARIETY}_{arch_type}": arch_type for arch_type in ARCH_TYPES}
_SCANS = {SCAN: COMMON, "random_steep": STEEP, "random_trunk": TRUNK}
RANDOM = ("random", "random_wide", *_SCANS, VARIETY, *_OF_TYPE, TREE)  # names that need a seed

Recipe = ArchParameters | VarietyArch | ScanArch | RandomTree


@lru_cache(maxsize=1024)  # those of a training come again and again, and take longer than reading the arch
def draw_recipe(name: str, seed: int) -> Recipe:
    """The arch of a name of RANDOM and a seed."""
    if name in _SCANS:
        return ScanArch(seed, _SCANS[name])
    if name == TREE:
        return RandomTree(seed)
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
    if isinstance(recipe, VarietyArch):
        return build_variety_arch(recipe)
    if isinstance(recipe, RandomTree):
        return build_random_tree(recipe)
    from cathsim.anatomy.generator.aortic_arch import build_arch

    return build_scan_arch(recipe) if isinstance(recipe, ScanArch) else build_arch(recipe)


def build_grid(recipe: Recipe, tree: VesselTree, resolution: float) -> SignedDistanceGrid:
    """The lumen of a recipe's tree as a distance grid, at a resolution in m.

    Raises:
        ValueError: the resolution is too coarse or too fine.
    """
    from cathsim.anatomy.lumen import build_lumen
    from cathsim.anatomy.wall.relief import raise_relief

    fillet = recipe.fillet_radius if isinstance(recipe, ArchParameters) else FILLET
    grid = build_lumen(tree, resolution=resolution, fillet_radius=fillet)
    return raise_relief(grid, tree, *drawn_relief(recipe)) if isinstance(recipe, ScanArch) else grid


def recipe_content(recipe: Recipe) -> dict[str, Any]:
    """All that determines the tree, as JSON holds it; for `recipe_of`."""
    values = dataclasses.asdict(recipe)
    if isinstance(recipe, VarietyArch):
        return {"variety_generator": VARIETY_VERSION, "variety": values}
    if isinstance(recipe, RandomTree):
        return {"tree_generator": TREE_VERSION, "tree": values}
    if isinstance(recipe, ScanArch):
        if recipe.shape == COMMON:
            del values["shape"]  # logs of such arches are older than the other shapes, and name their hash
        return {"scan_generator": SCAN_VERSION, "generator": GENERATOR_VERSION, "scan": values}
    return {"generator": GENERATOR_VERSION, "parameters": values}


def recipe_of(content: Mapping[str, Any]) -> Recipe:
    """The recipe of a content, whatever the generators' versions."""
    if "variety" in content:
        return VarietyArch(**content["variety"])
    if "tree" in content:
        return RandomTree(**content["tree"])
    if "scan" in content:
        return ScanArch(**content["scan"])
    measures = dict(content["parameters"])
    if measures.get("aneurysm") is not None:
        measures["aneurysm"] = Aneurysm(**measures["aneurysm"])
    return ArchParameters(**measures)
