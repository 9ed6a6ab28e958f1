"""Names of anatomies, targets and entries, refused where there is none such."""

from __future__ import annotations

from collections.abc import Sequence

from pipeline.store.errors import ConfigurationError

TARGETS = ("bca", "lcca", "lsa")  # that stages navigate to by themselves
GENERATED_TARGETS = (*TARGETS, "rsa", "rcca")  # that every generated arch has


def require_known_phantoms(names: Sequence[str], *, hint: str = "") -> None:
    """Refuses unknown names with a `ConfigurationError` that lists the valid ones, followed by a hint.

    Names of random arches hold their seeds: random_7.
    """
    from cathsim.anatomy import PHANTOMS
    from cathsim.anatomy.generator.recipe import RANDOM
    from cathsim.anatomy.library import seed_in_name

    for name in names:
        if name in RANDOM:
            raise ConfigurationError(
                f"phantom {name!r} needs a seed: write {name}_7, or phantom.name={name} phantom.seed=7"
            )
    unknown = [name for name in names if name not in PHANTOMS and seed_in_name(name)[1] is None]
    if unknown:
        raise ConfigurationError(
            f"unknown phantom {', '.join(map(repr, unknown))}: choose from {', '.join(PHANTOMS)}, random_7{hint}"
        )


def require_known_targets(names: Sequence[str], phantoms: Sequence[str] = ()) -> None:
    """Refuses names that are no target's with a ConfigurationError that lists the valid ones.

    Args:
        phantoms: in which they are to be; then any target of theirs is taken, and any point as `target_name` writes it:
            point_27.0_-2.0_70.0_mm. Without, only those of every generated arch.
    """
    unknown = [name for name in names if name not in (TARGETS if phantoms else GENERATED_TARGETS)]
    for phantom in phantoms if unknown else ():
        from cathsim import load_phantom

        try:
            for name in unknown:
                load_phantom(phantom).target(name)
        except ValueError as error:
            raise ConfigurationError(str(error)) from error
    if unknown and not phantoms:
        raise ConfigurationError(
            f"unknown target {', '.join(map(repr, unknown))}: choose from {', '.join(GENERATED_TARGETS)}"
        )


def require_known_entry(entry: str, phantoms: Sequence[str]) -> None:
    """Refuses an entry that one of the phantoms does not have, with a ConfigurationError that lists the valid ones."""
    from cathsim import load_phantom

    try:
        for phantom in phantoms:
            load_phantom(phantom).entry(entry)
    except ValueError as error:
        raise ConfigurationError(str(error)) from error
