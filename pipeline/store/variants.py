"""Variants of a stage: the folders that runs with different seeds and overrides leave beside each other.

``runs/<name>/<stage>`` holds the results of seed 0. A run with another seed has ``<stage>@seed=<n>``, and a job of a
sweep ``<stage>@<its overrides>``: none removes what another has left. A stage that reads an earlier one reads the
variant that fits its own overrides best.
"""

from __future__ import annotations

import hashlib
import logging
import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from pipeline.printing import written
from pipeline.store.errors import StageError
from pipeline.store.manifest import Manifest, read_manifest

_LONGEST_VARIANT = 100
# Overrides that already choose the folder, or cannot change a result.
_NOT_IN_VARIANT = {"stage", "name", "runs_dir", "force", "engine"}

_LOGGER = logging.getLogger(__name__)


def variant_of(overrides: Sequence[str]) -> str:
    """Names a sweep job after its overrides, e.g. ``seed=1``: no two share a folder; long ones are cut and hashed."""
    full = ",".join(effective_overrides(overrides))
    readable = re.sub(r"[^A-Za-z0-9_.=,+-]", "_", full)
    if readable == full and len(full) <= _LONGEST_VARIANT:
        return full
    # Replaced characters and cut ends could make two jobs look alike: the hash keeps them apart.
    return f"{readable[:_LONGEST_VARIANT]}-{hashlib.sha256(full.encode()).hexdigest()[:8]}"


def effective_overrides(overrides: Sequence[str]) -> list[str]:
    """The overrides that can change a result, sorted, without Hydra's signs for adding and deleting."""
    bare = (override.lstrip("+~") for override in overrides)
    keys = {override: override.split("=", 1)[0] for override in bare}
    return sorted(word for word, key in keys.items() if key not in _NOT_IN_VARIANT and not key.startswith("engine."))


@dataclass(frozen=True)
class RunRequest:
    """What a run was asked for, as far as it chooses among folders."""

    overrides: tuple[str, ...] = ()
    in_sweep: bool = False
    seed: int = 0
    budget: str = "desk"

    def variant(self, *, seeded: bool) -> list[str]:
        """The overrides that the folder of its results is named after, by whether results depend on the seed."""
        if self.in_sweep:
            return effective_overrides(self.overrides)
        return [f"seed={self.seed}"] if seeded and self.seed else []

    def fit(self, variant: Sequence[str]) -> tuple[int, int] | None:
        """How well a variant of another stage fits.

        Returns:
            How many of its overrides were asked for, and minus how many are merely so by default, to be compared;
            None: one of its overrides is something else than what was asked for.
        """
        request_values, default = _shared(self.overrides), {"seed": str(self.seed), "budget": self.budget}
        variant_values = _shared(variant)
        if any(({**default, **request_values}).get(key) != value for key, value in variant_values.items()):
            return None
        stated = sum(key in request_values for key in variant_values)
        return stated, stated - len(variant_values)


def require_input(run_path: Path, stage: str, reader: str, request: RunRequest) -> tuple[Path, Manifest]:
    """Finds the finished results of an earlier stage and checks that they are as it left them."""
    manifests = _variants(run_path, stage)
    fits = {folder: fit for folder, manifest in manifests.items() if (fit := request.fit(manifest.variant)) is not None}
    plain = run_path / stage
    several_seeds = any("seed" in _shared(manifest.variant) for manifest in manifests.values())
    if plain in fits and manifests[plain].seed != request.seed and several_seeds:
        del fits[plain]  # the stage ran for several seeds: then another's is not meant
    best = [folder for folder, fit in fits.items() if fit == max(fits.values())]
    if not best:
        raise StageError(_missing_input(run_path, stage, reader, request, list(manifests)))
    if len(best) > 1:
        raise StageError(
            f"stage {reader} could read {' or '.join(map(str, best))}: remove the one that is not meant, or say more "
            "(seed=…, target=…)"
        )
    (folder,) = best
    manifest = manifests[folder]
    _require_unchanged(folder, manifest, reader)
    if manifest.seed != request.seed or folder != plain:
        _LOGGER.info("%s reads %s (seed %d)", reader, folder.name, manifest.seed)
    return folder, manifest


def _variants(run_path: Path, stage: str) -> dict[Path, Manifest]:
    folders = [run_path / stage, *sorted(run_path.glob(f"{stage}@*"))]
    manifests = {folder: read_manifest(folder) for folder in folders}
    return {folder: manifest for folder, manifest in manifests.items() if manifest is not None}


def _require_unchanged(folder: Path, manifest: Manifest, reader: str) -> None:
    changed = manifest.changed_output(folder)
    if changed is not None:
        in_sweep = bool(manifest.variant) and manifest.variant == manifest.overrides
        again = command(manifest.stage, folder.parent, [*manifest.overrides, "force=true"], in_sweep=in_sweep)
        raise StageError(f"stage {reader} cannot read stage {manifest.stage}: {changed}; run {again} to make it again")
    foreign = manifest.foreign_file(folder)
    if foreign is not None:
        raise StageError(
            f"stage {reader} cannot read stage {manifest.stage}: {foreign} was not written by it; move that file away"
        )


def _missing_input(run_path: Path, stage: str, reader: str, request: RunRequest, folders: Sequence[Path]) -> str:
    own = [override for override in effective_overrides(request.overrides) if not override.startswith("stage.")]
    reason = f"{run_path / stage} holds none"
    if folders:
        selection = ", ".join(own) or f"seed={request.seed}"
        reason = f"none of {', '.join(folder.name for folder in folders)} in {run_path} fits {selection}"
    missing = f"stage {reader} needs the results of stage {stage}, and {reason}"
    if request.in_sweep:
        return f"{missing}: run {command(stage, run_path, own, in_sweep=True)} first"
    return f"{missing}: run {_with_inputs(reader, run_path, request)}, which begins with all that it needs"


def _with_inputs(stage: str, run_path: Path, request: RunRequest) -> str:
    """The command that runs a stage after all that it reads, in backquotes."""
    settings = [f"stage@{stage}.{word.removeprefix('stage.')}" if word.startswith("stage.") else word
                for word in effective_overrides(request.overrides)]  # fmt: skip
    words = [*settings, f"name={run_path.name}", *_place(run_path)]
    return f"`{written('chain')} --inputs {stage} -- {shlex.join(words)}`"


def command(stage: str, run_path: Path, overrides: Sequence[str], *, in_sweep: bool) -> str:
    """The command, in backquotes, that runs a stage with overrides beside stage, name and runs_dir."""
    words = [f"stage={stage}", f"name={run_path.name}", *overrides, *_place(run_path)]
    return f"`{written('stages')} {'-m ' if in_sweep else ''}{shlex.join(words)}`"


def _place(run_path: Path) -> list[str]:
    """The override for a folder of runs that is not the usual one."""
    return [] if run_path.parent == Path("runs") else [f"runs_dir={run_path.parent}"]


def _shared(overrides: Sequence[str]) -> Mapping[str, str]:
    """The overrides that mean the same to every stage, by key."""
    pairs = (override.partition("=")[::2] for override in effective_overrides(overrides))
    return {key: value for key, value in pairs if not key.startswith("stage.")}
