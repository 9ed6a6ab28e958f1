"""Plain state: nested state with numpy arrays as numbers, texts, containers and tensors, which a file can hold as data.

A checkpoint is read without running code (`torch.load` with `weights_only`), which takes neither arrays nor all bytes.
Both are kept as tensors, and what they were beside them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

_SINGLE = (type(None), bool, int, float, str)
_KEYS = (str, int)
Place = tuple[Any, ...]


def plain(state: Any) -> dict[str, Any]:
    """Turns state into what `enn.model_file.encoded` takes.

    Args:
        state: None, numbers, texts, bytes, arrays, tensors, and lists, tuples and dictionaries of them.

    Returns:
        For `restored`.

    Raises:
        TypeError: something else is in it; its place is named.
    """
    kinds: dict[Place, str] = {}
    return {"state": _plain(state, (), kinds), "kinds": kinds}


def restored(content: dict[str, Any]) -> Any:
    """The state that `plain` was given: the same values, arrays in the same order of memory."""
    return _restored(content["state"], (), content["kinds"])


def _plain(value: Any, place: Place, kinds: dict[Place, str]) -> Any:
    if type(value) in _SINGLE:
        return value
    if isinstance(value, torch.Tensor):
        return value.detach()
    if isinstance(value, bytes):
        kinds[place] = "bytes"
        return torch.from_numpy(np.frombuffer(value, np.uint8).copy())
    if isinstance(value, np.ndarray | np.generic):
        kinds[place] = "array" if isinstance(value, np.ndarray) else "scalar"
        try:
            return torch.from_numpy(np.array(value, order="K"))
        except (TypeError, ValueError):
            raise _refused(f"an array of type {value.dtype}", place) from None
    if isinstance(value, dict):
        odd = next((key for key in value if type(key) not in _KEYS), None)
        if odd is not None:
            raise _refused(f"a dictionary with a {type(odd).__name__} as a key", place)
        return {key: _plain(part, (*place, key), kinds) for key, part in value.items()}
    if type(value) in (list, tuple):
        return type(value)(_plain(part, (*place, k), kinds) for k, part in enumerate(value))
    raise _refused(f"a {type(value).__name__}", place)


def _restored(value: Any, place: Place, kinds: dict[Place, str]) -> Any:
    if isinstance(value, torch.Tensor):
        kind = kinds.get(place)
        if kind is None:
            return value
        array = value.numpy()
        return array if kind == "array" else array[()] if kind == "scalar" else array.tobytes()
    if isinstance(value, dict):
        return {key: _restored(part, (*place, key), kinds) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(_restored(part, (*place, k), kinds) for k, part in enumerate(value))
    return value


def _refused(what: str, place: Place) -> TypeError:
    name = "/".join(map(str, place)) or "the state"
    return TypeError(
        f"{name} is {what}, which a checkpoint cannot hold: state() of environments may give None, numbers, texts, "
        "bytes, arrays, and lists, tuples and dictionaries of them"
    )
