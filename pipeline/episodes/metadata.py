"""The metadata records of a log: an episode's information and outcome as JSON, with checksum and version."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from typing import Any

from pydantic import ValidationError
from pydantic_core import from_json

from pipeline.episodes.camera import Camera, require_name
from pipeline.episodes.encoding.schema import EPISODE_METADATA, SCHEMA_VERSION
from pipeline.episodes.records import ContainerError, EpisodeInfo, EpisodeOutcome, as_json
from pipeline.settings.kinds import sentence, shown

_LONGEST_REASON = 200


class VersionError(ContainerError):
    """The record has no schema version, or one that this reader does not know."""


def _checksum(schema_version: str, text: str) -> str:
    return f"{zlib.crc32(f'{schema_version} {text}'.encode()):08x}"


def seal(values: Mapping[str, Any]) -> dict[str, str]:
    """Make the content of a metadata record of plain values: JSON with its checksum and the schema version."""
    text, schema_version = as_json(values), str(SCHEMA_VERSION)
    return {"schema_version": schema_version, "json": text, "crc32": _checksum(schema_version, text)}


def unseal(record: Mapping[str, str]) -> dict[str, Any]:
    """Read the values of a metadata record; a VersionError where its schema version is missing or too new."""
    if "schema_version" not in record:
        raise VersionError("it has no schema version, so it was not written as an episode log")
    schema_version = record["schema_version"]
    text = record.get("json", "")
    if record.get("crc32") != _checksum(schema_version, text):
        raise ContainerError("the checksum of its metadata does not match")
    if schema_version not in map(str, range(1, SCHEMA_VERSION + 1)):
        found = shown(schema_version)[1:-1]
        raise VersionError(
            f"it has schema version {found}, this reader knows up to {SCHEMA_VERSION}: update the software"
        )
    try:
        # unlike the standard library's, this parser ends at 200 levels and refuses halves of surrogate pairs
        values = from_json(text, allow_inf_nan=False)
    except ValueError as error:
        raise ContainerError(f"its metadata is no JSON that can be read ({error})") from error
    if not isinstance(values, dict):
        raise ContainerError("its metadata is no JSON object")
    return values


def seal_episode(info: EpisodeInfo, cameras: Mapping[str, Camera]) -> dict[str, str]:
    """Make the content of the record `endonav.episode`."""
    ordered = [{"name": name, **camera.to_json()} for name, camera in cameras.items()]
    return seal({"info": info.to_json(), "cameras": ordered})


def open_episode(record: Mapping[str, str]) -> tuple[EpisodeInfo, dict[str, Camera]]:
    """Read the record `endonav.episode`: information, and cameras by name in their order; raises as `unseal` does."""
    values = unseal(record)
    try:
        cameras: dict[str, Camera] = {}
        for given in values["cameras"]:
            name, camera = require_name(given["name"]), Camera.from_json(given)
            if name in cameras:
                raise ValueError(f"two cameras have the name {shown(name)}")
            _require_as_written(given, {"name": name, **camera.to_json()})
            cameras[name] = camera
        info = EpisodeInfo(**values["info"])
        _require_as_written(values["info"], info.to_json())
        return info, cameras
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise ContainerError(f"the metadata record {EPISODE_METADATA} cannot be used ({_reason(error)})") from error


def _require_as_written(given: Mapping[str, Any], understood: Mapping[str, Any]) -> None:
    """Refuse values that a writer writes otherwise, such as a truth in words, which a validator takes for the same."""
    for name, value in given.items():
        if name not in understood:
            raise ValueError(f"{shown(name)} is no field")
        if as_json(value) != as_json(understood[name]):
            raise ValueError(f"{name} must be {shown(understood[name])}, got {shown(value)}")


def _reason(error: Exception) -> str:
    if isinstance(error, ValidationError):
        return sentence(error, "")[:_LONGEST_REASON]
    return f"{error} is missing" if isinstance(error, KeyError) else " ".join(str(error).split())[:_LONGEST_REASON]


def seal_outcome(outcome: EpisodeOutcome) -> dict[str, str]:
    """Make the content of the record `endonav.outcome`."""
    return seal(outcome.to_json())


def open_outcome(record: Mapping[str, str]) -> EpisodeOutcome:
    """Read the content of the record `endonav.outcome`; raises as `unseal` does."""
    values = unseal(record)
    try:
        outcome = EpisodeOutcome(**values)
        _require_as_written(values, outcome.to_json())
        return outcome
    except (TypeError, ValueError, OverflowError) as error:
        raise ContainerError(f"the episode's outcome cannot be used ({_reason(error)})") from error
