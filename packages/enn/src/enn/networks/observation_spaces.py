"""Observations by name: modality sets, and what is taken of an observation space; it imports no torch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium

MODALITIES = {"I": ("joints",), "V": ("image",), "M": ("mask",), "R": ("roadmap", "history")}
MODALITY_SETS = ("I", "V", "M", "I+V", "I+M", "V+M", "I+V+M", "R")
COMPACT = MODALITIES["R"]  # a few numbers in the tip's frame: nothing is left for an encoder to do
OBSERVATIONS = ("internal", "image", "sequential")  # of the reinforcement-learning chapter


def modality_keys(modalities: str) -> tuple[str, ...]:
    """Names of the observations of a modality set.

    Args:
        modalities: such as "I+V+M": I are the joints, V the image, M the mask; "R", the way ahead and the walls in the
            tip's frame, with the last movements; or one of the baselines' observations.

    Raises:
        ValueError: there is no such set; names those that there are.
    """
    if modalities in OBSERVATIONS:
        return (modalities,)
    if modalities not in MODALITY_SETS:
        valid = ", ".join((*MODALITY_SETS, *OBSERVATIONS))
        raise ValueError(f"unknown modality set '{modalities}'; there are {valid}")
    return tuple(key for letter in modalities.split("+") for key in MODALITIES[letter])


def vector_spaces(space: gymnasium.Space, keys: Sequence[str] = ()) -> dict[str, gymnasium.spaces.Box]:
    """The vector observations of a space by name; a single `Box` has the name "".

    Raises:
        ValueError: a key that there is not, or an image among them.
    """
    if isinstance(space, gymnasium.spaces.Dict):
        spaces = {key: space[key] for key in select_keys(space, keys)}
    else:
        spaces = {"": space}
    images = [key or "the observation" for key, one in spaces.items() if len(one.shape or ()) == 3]
    if images:
        raise ValueError(
            f"{', '.join(images)} is an image: give it an encoder, or a network with extractor='multimodal'"
        )
    return spaces  # type: ignore[return-value]


def select_keys(space: gymnasium.spaces.Dict, keys: Sequence[str]) -> tuple[str, ...]:
    """The keys asked for, or all of a space.

    Raises:
        ValueError: a key that there is not.
    """
    unknown = [key for key in keys if key not in space.spaces]
    if unknown:
        raise ValueError(f"no observation {', '.join(unknown)}; the environment gives {', '.join(space.spaces)}")
    return tuple(keys) or tuple(space.spaces)


def kept_space(space: gymnasium.Space[Any], keys: Sequence[str]) -> gymnasium.Space[Any]:
    """The observations of a `Dict` to keep; none: all."""
    if keys and isinstance(space, gymnasium.spaces.Dict):
        return gymnasium.spaces.Dict([(key, space[key]) for key in select_keys(space, keys)])
    return space


def require_keys(keys: Sequence[str], observations: Mapping[str, Any]) -> None:
    """Refuses observations among which one of a policy's is missing.

    Raises:
        ValueError: says which.
    """
    missing = [key for key in keys if key not in observations]
    if missing:
        raise ValueError(
            f"the policy sees {', '.join(keys)}, but {', '.join(missing)} is missing: make the environment with these "
            "observations"
        )
