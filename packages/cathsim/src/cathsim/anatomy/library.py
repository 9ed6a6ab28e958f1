"""The named phantoms, built from their parameters and cached."""

from __future__ import annotations

import hashlib
import json
import math
import os
import threading
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from cathsim.anatomy.entry import locate_entries
from cathsim.anatomy.generator.arch_parameters import Aneurysm, ArchParameters
from cathsim.anatomy.generator.random_tree import RandomTree
from cathsim.anatomy.generator.recipe import (
    RANDOM,
    Recipe,
    build_grid,
    build_tree,
    draw_recipe,
    recipe_content,
    recipe_of,
)
from cathsim.anatomy.generator.scan_arch import ScanArch
from cathsim.anatomy.phantom import Phantom, Target, locate_targets, target_share
from cathsim.anatomy.phantom_cache import PhantomCache, default_cache_directory
from cathsim.anatomy.vessel_tree import VesselTree

NAMED: dict[str, ArchParameters] = {
    "type_1": ArchParameters(),
    "type_2": ArchParameters(
        apex_ratio=1.4,
        lcca_diameter=0.0098,
        arch_skew=0.03,
        arch_width=0.068,
        ascending_height=0.090,
        bca_takeoff=math.radians(46),
        winding_seed=2,
    ),
    "type_1_aneurysm": ArchParameters(
        apex_ratio=0.6,
        arch_width=0.074,
        aneurysm=Aneurysm("fusiform", distance=0.052, length=0.075, bulge=0.010),
        winding_seed=3,
    ),
    "low_tortuosity": ArchParameters(
        apex_ratio=0.4,
        tortuosity=0.0,
        branch_tortuosity=0.0003,
        out_of_plane=0.002,
        ascending_lean=0.12,
        arch_tilt=0.0,
        bca_takeoff=math.radians(28),
        lcca_takeoff=math.radians(8),
        lsa_takeoff=math.radians(14),
        winding_seed=4,
    ),
    "type_3": ArchParameters(
        apex_ratio=2.6,
        lcca_diameter=0.0095,
        arch_skew=0.04,
        arch_width=0.066,
        ascending_height=0.100,
        bca_takeoff=math.radians(40),
        winding_seed=5,
    ),
    "bovine": ArchParameters(apex_ratio=0.6, bovine=True, bca_diameter=0.0165, lcca_diameter=0.0088, winding_seed=6),
}
PHANTOMS: tuple[str, ...] = tuple(NAMED)

_DIGITS = 16  # of a seed in a name, fewer than
_loading = threading.Lock()


def load_phantom(
    name: str | Path,
    *,
    seed: int | None = None,
    resolution: float = 1e-3,
    cache_dir: Path | None = None,
    parameters: Recipe | None = None,
    **of_file: Any,
) -> Phantom:
    """Loads a phantom by its name or from a file, from the process, from the disk cache, or by building it.

    Args:
        name: one of PHANTOMS; one of RANDOM, which need a seed: "random", "random_wide" (rare shapes as often as common
            ones), "random_scan" (as scans show them: of any size, cut, not round, rough), "random_steep" and
            "random_trunk" (the same, branches far below the top of the arch; a left carotid that turns off a trunk),
            "arch_variety" (six branching types) or "arch_variety_IV" (one of them), "random_tree" (from the groin to
            the head), or have it in their name, "random_7"; the path of a surface, of a label volume or of a folder of
            them; or with `parameters` any name of your own.
        seed: of the random arch.
        resolution: m between lattice points of the distance grid.
        cache_dir: where built phantoms are kept; by default $CATHSIM_CACHE, else the user's cache directory.
        parameters: measures of an arch of your own, or a `VarietyArch`.
        of_file: unit, labels, names, transform and extend of a file, as `import_anatomy` takes them.

    Returns:
        The phantom; calls with the same arguments share one object.

    Raises:
        ValueError: for an unknown name, a missing or misplaced seed, or an impossible resolution.
    """
    name = str(name)
    if parameters is None:
        if seed is None:
            name, seed = seed_in_name(name)
        if name not in (*NAMED, *RANDOM):
            return _import(name, seed, resolution=resolution, cache_dir=cache_dir, **of_file)
        parameters = _parameters_of(name, seed)
        if name in RANDOM:
            name = f"{name}_{seed}"
    elif seed is not None or name in NAMED or name in RANDOM:
        raise ValueError(
            f"with parameters of your own give a name of your own and no seed; got name {name!r} and seed {seed!r}."
        )
    if of_file:
        raise ValueError(f"phantom {name!r} takes no {', '.join(of_file)}; only a phantom from a file does.")
    return _load_arch(name, parameters, resolution, cache_dir)


def _load_arch(name: str, parameters: Recipe, resolution: float, cache_dir: Path | None = None) -> Phantom:
    if not (isinstance(resolution, int | float) and math.isfinite(resolution)):
        raise ValueError(f"resolution must be a finite length in m, got {resolution!r}.")
    directory = default_cache_directory() if cache_dir is None else Path(cache_dir)
    with _loading:  # threads asking at once for one phantom get one object
        return _load(name, parameters, float(resolution), directory)


def phantom_to_spec(phantom: Phantom) -> dict[str, Any]:
    """What a phantom was built from, as JSON holds it.

    Returns:
        For `phantom_from_spec`: name, hash, resolution (m), and measures or the arguments of the import.

    Raises:
        ValueError: it is neither of this library, nor of `build_phantom`, nor from a mesh's file.
    """
    description = {"name": phantom.name, "hash": phantom.hash, "resolution": phantom.grid.spacing}
    if phantom.source is not None:
        mesh = dict(phantom.source)
        return {**description, "resolution": mesh.pop("resolution"), "mesh": mesh}
    parameters = phantom.parameters
    if parameters is None or phantom_hash(parameters, phantom.grid.spacing) != phantom.hash:
        raise ValueError(
            f"phantom {phantom.name!r} was put together by hand and cannot be written as JSON: load it by its name, "
            "with ArchParameters of your own, or from a mesh's file."
        )
    return description if NAMED.get(phantom.name) == parameters else {**description, **recipe_content(parameters)}


def phantom_from_spec(description: Mapping[str, Any]) -> Phantom:
    """Loads or builds the phantom of a description.

    Raises:
        ValueError: the mesh's file or the generator has changed since.
    """
    name, resolution = description["name"], description["resolution"]
    if "mesh" in description:
        return _import_from_spec(description)
    if any(key in description for key in ("parameters", "variety", "scan", "tree")):
        phantom = _load_arch(name, recipe_of(description), resolution)
    else:
        phantom = _load_arch(name, _parameters_of(name, None), resolution)
    _require_same(description, phantom.hash)
    return phantom


def _import_from_spec(description: Mapping[str, Any]) -> Phantom:
    from cathsim.anatomy.importing import import_again, import_digest

    source, resolution = description["mesh"], float(description["resolution"])
    _require_same(description, import_digest(source, resolution))  # before the import, which takes its time
    return import_again(source, resolution)


def _require_same(description: Mapping[str, Any], digest: str) -> None:
    if digest != description["hash"]:
        raise ValueError(
            f"phantom {description['name']!r} is another than the one described (hash {digest} instead of "
            f"{description['hash']}): its mesh or the generator of arches has changed since."
        )


def phantom_hash(parameters: Recipe, resolution: float) -> str:
    """Digest of everything that determines a phantom's geometry, 32 hexadecimal digits; the resolution is in m."""
    content = {**recipe_content(parameters), "resolution": float(resolution)}
    return hashlib.blake2b(json.dumps(content, sort_keys=True).encode(), digest_size=16).hexdigest()


def build_phantom(name: str, parameters: Recipe, *, resolution: float = 1e-3) -> Phantom:
    """Builds a phantom without any cache, at a resolution in m; its geodesic fields are computed at first use."""
    tree = build_tree(parameters)
    grid = build_grid(parameters, tree, resolution)
    return Phantom(
        name=name,
        hash=phantom_hash(parameters, resolution),
        parameters=parameters,
        tree=tree,
        grid=grid,
        targets=_targets(tree, parameters),
        entries=locate_entries(tree),
    )


def _targets(tree: VesselTree, parameters: Recipe) -> dict[str, Target]:
    if isinstance(parameters, RandomTree):
        from cathsim.anatomy.mesh.completion import propose_targets

        return propose_targets(tree)[0]
    return locate_targets(tree, target_share(tree) if isinstance(parameters, ScanArch) else 1.0)


def _import(name: str, seed: int | None, **options: Any) -> Phantom:
    from cathsim.anatomy.importing import import_anatomy, is_anatomy_path

    if not is_anatomy_path(name) and not (name and os.path.exists(name)):
        raise _unknown(name)
    if seed is not None:
        raise ValueError(f"a phantom from a file takes no seed, got {seed!r}; only 'random' does.")
    return import_anatomy(name, **options)


def seed_in_name(name: str) -> tuple[str, int | None]:
    """A random arch's kind and seed from the name that it gets, "random_7"; any other name as it is, without a seed."""
    kind, _, number = name.rpartition("_")
    return (kind, int(number)) if kind in RANDOM and number.isdecimal() and len(number) < _DIGITS else (name, None)


def _parameters_of(name: str, seed: int | None) -> Recipe:
    if name in RANDOM:
        if seed is None or isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
            raise ValueError(f"phantom '{name}' needs a seed, a whole number from 0 on; got {seed!r}.")
        return draw_recipe(name, int(seed))
    if name not in NAMED:
        raise _unknown(name)
    if seed is not None:
        raise ValueError(f"phantom {name!r} takes no seed, got {seed!r}; only 'random' does.")
    return NAMED[name]


def _unknown(name: str) -> ValueError:
    known = f"{', '.join(PHANTOMS)}, random or arch_variety (with a seed)"
    return ValueError(f"unknown phantom {name!r}; choose from {known}, or give the path of a mesh or label volume.")


@lru_cache(maxsize=32)
def _load(name: str, parameters: Recipe, resolution: float, directory: Path) -> Phantom:
    cache = PhantomCache(directory)
    digest = phantom_hash(parameters, resolution)
    phantom = cache.read(name, digest, parameters)
    if phantom is None:
        phantom = build_phantom(name, parameters, resolution=resolution)
        phantom = cache.write(phantom)
    return phantom
