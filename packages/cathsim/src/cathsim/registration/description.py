"""Arguments of environments as plain JSON values, and environments made again from them.

Settings are described by their class and fields, phantoms by what they were built from: arch's measures or mesh.
"""

from __future__ import annotations

import dataclasses
import functools
import importlib
import inspect
import json
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import numpy as np
from gymnasium.envs.registration import EnvSpec

from cathsim.anatomy import Phantom
from cathsim.anatomy.library import phantom_from_spec, phantom_to_spec
from cathsim.validation import named

Kind = TypeVar("Kind")

CLASS = "class"  # the key of a described object's class; its other keys are fields or arguments

FUNCTION = "function"


def to_spec(value: Any) -> Any:
    """An environment's argument, or a list or mapping of such, as JSON holds it; for `from_spec`.

    Raises:
        ValueError: it cannot be made again from a description.
    """
    from cathsim.fluoroscopy.biplane import BiplaneFluoroscope

    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return {str(key): to_spec(one) for key, one in value.items()}
    if isinstance(value, list | tuple | range):
        return [to_spec(one) for one in value]
    if inspect.isfunction(value):
        if "<" in value.__qualname__ or value.__module__ == "__main__":
            raise ValueError(
                f"the function {value.__qualname__} cannot be written as JSON: define it by name in a module that can "
                "be imported"
            )
        return {CLASS: FUNCTION, "name": f"{value.__module__}:{value.__qualname__}"}
    if isinstance(value, Phantom):
        return {CLASS: "Phantom", **phantom_to_spec(value)}
    if isinstance(value, BiplaneFluoroscope):
        if value.recipe is None:
            raise ValueError(
                "a BiplaneFluoroscope of cameras of your own cannot be written as JSON: make it with "
                "BiplaneFluoroscope.of, or name cameras 'guide3d' or 'clinical'"
            )
        return {CLASS: "BiplaneFluoroscope", **to_spec(value.recipe)}
    kind = type(value)
    if not dataclasses.is_dataclass(value) or "<" in kind.__qualname__ or kind.__module__ == "__main__":
        raise ValueError(
            f"a {kind.__name__} cannot be written as JSON: expected a name, a number, a Phantom, or settings whose "
            "class a module can be asked for"
        )
    fields = {one.name: to_spec(getattr(value, one.name)) for one in dataclasses.fields(value) if one.init}
    return {CLASS: f"{kind.__module__}:{kind.__qualname__}", **fields}


def from_spec(value: Any) -> Any:
    """The value that `to_spec` has made plain; other values as they are.

    Raises:
        ValueError: a class or phantom that there is not, or that is another by now.
    """
    if isinstance(value, list | tuple):
        return tuple(from_spec(one) for one in value)
    if not isinstance(value, Mapping) or CLASS not in value:
        return value
    kind = value[CLASS]
    if kind == "Phantom":
        return phantom_from_spec({key: one for key, one in value.items() if key != CLASS})
    arguments = {key: from_spec(one) for key, one in value.items() if key != CLASS}
    if kind == "BiplaneFluoroscope":
        from cathsim.fluoroscopy.biplane import BiplaneFluoroscope

        return BiplaneFluoroscope.of(**arguments)
    if kind == FUNCTION:
        function = _found(str(value.get("name")))
        if not inspect.isfunction(function):
            raise ValueError(f"there is no function {value.get('name')!r}: expected module:function")
        return function
    settings_class = _found(str(kind))
    if not (isinstance(settings_class, type) and dataclasses.is_dataclass(settings_class)):
        raise ValueError(f"there is no settings class {kind!r}: expected module:class of a dataclass")
    try:
        return settings_class(**arguments)
    except TypeError as error:
        raise ValueError(f"{kind} cannot be made of {', '.join(arguments)}: {error}") from None


def _found(place: str) -> Any:
    """What a module calls a name, from module:name; None: nothing."""
    module, _, name = place.partition(":")
    try:
        return functools.reduce(getattr, name.split("."), importlib.import_module(module))
    except (ImportError, AttributeError, ValueError):
        return None


def resolve_argument(
    argument: str, value: Any, kind: type[Kind], by_name: Callable[[str], Kind] | Mapping[str, Kind] | None = None
) -> Kind:
    """An argument that is a name, an object of a kind, or an object's description.

    Args:
        by_name: gives the object of a name; None: it has none.

    Raises:
        ValueError: it is something else.
    """
    if by_name is not None and isinstance(value, str):
        return by_name(value) if callable(by_name) else named(argument, value, by_name)
    value = from_spec(value)
    if not isinstance(value, kind):
        article = "an" if kind.__name__[0] in "AEIOU" else "a"
        name = "" if by_name is None else "a name or "
        raise ValueError(f"{argument} must be {name}{article} {kind.__name__}, got {value!r}")
    return value


@dataclasses.dataclass
class Specification(EnvSpec):
    """An `EnvSpec` whose JSON describes phantoms and settings among the arguments; `make` takes both."""

    @classmethod
    def of(cls, spec: EnvSpec) -> Specification:
        """The same specification."""
        return cls(**{one.name: getattr(spec, one.name) for one in dataclasses.fields(spec) if one.init})

    def to_json(self) -> str:
        """As JSON, for `EnvSpec.from_json`.

        Raises:
            ValueError: an argument cannot be described.
        """
        plain = {one.name: getattr(self, one.name) for one in dataclasses.fields(self) if one.init}
        plain["kwargs"] = to_spec(self.kwargs)
        plain["additional_wrappers"] = [to_spec(vars(wrapper)) for wrapper in self.additional_wrappers]
        self._check_can_jsonify(plain)
        return json.dumps(plain)


class Specified:
    """Keeps the specification that Gymnasium gives an environment as a `Specification`."""

    _specification: EnvSpec | None = None

    @property
    def spec(self) -> EnvSpec | None:
        """What makes an equal environment: `gymnasium.make(EnvSpec.from_json(env.spec.to_json()))`."""
        return self._specification

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        self._specification = None if spec is None else Specification.of(spec)
