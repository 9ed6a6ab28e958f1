"""Untrained policies in the place of the shipped ones: what they do means nothing, but they see what those see."""

import functools
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from enn import shipped
from enn.imitation.images.lumen_segmentation import LumenSegmenter
from enn.imitation.images.perception import ONE_CAMERA, ImagePerception
from enn.imitation.images.wire_segmentation import WireSegmenter
from enn.imitation.recurrent_policy import RecurrentPolicy, RecurrentPolicySettings
from enn.networks.network import NetworkSettings, build_network
from enn.policy import Policy
from pipeline.stages.unseen.task import ROADMAP_KEYS, UnseenTask
from pipeline.task import TASK, Task

TASK_OF_DEMO = Task(wire_length_mm=380.0, image_size_px=64, max_steps=7)
CARD = "# {0}\n\nSteers `{0}`.\n\n| file |\n\n**What it sees.** The `image`\nalone.\n\n**Figures.** None.\n"


@functools.cache
def spaces_of_demo() -> tuple[Any, Any]:
    """Of observations by the scan, and of actions; a simulation is made to ask it for them."""
    environment = UnseenTask(("bca",), TASK_OF_DEMO).test_environment("type_1", "bca", "default", ROADMAP_KEYS)
    return environment.observation_space, environment.action_space


def ship(folder: Path, monkeypatch: pytest.MonkeyPatch, cameras: tuple[str, ...] = ONE_CAMERA) -> Path:
    """Puts two untrained policies where enn finds the shipped ones; gives their folder.

    Args:
        cameras: whose images the navigator sees.
    """
    monkeypatch.setattr(shipped, "files", lambda package: folder / package)
    weights = folder / "enn.weights"
    metadata = {TASK: asdict(TASK_OF_DEMO)}
    perception = ImagePerception(LumenSegmenter(4, 32), WireSegmenter(4), cameras=cameras)
    settings = RecurrentPolicySettings(features=perception.size, hidden=8, action_repeat=3)
    RecurrentPolicy(settings, perception=perception.content()).save(weights / "navigator.pt", **metadata)
    spaces, network = spaces_of_demo(), NetworkSettings(hidden=(8, 8), keys=ROADMAP_KEYS)
    Policy(network, build_network(network, *spaces), *spaces, action_repeat=3, metadata=metadata).save(
        weights / "generalist.pt"
    )
    for name in ("navigator", "generalist"):
        (weights / f"{name}.md").write_text(CARD.format(name))
    return weights


def ship_for_two_devices(weights: Path) -> None:
    """Puts an untrained policy of a wire in a catheter beside the navigator's."""
    perception = ImagePerception(LumenSegmenter(4, 32), WireSegmenter(4), catheter=WireSegmenter(4))
    settings = RecurrentPolicySettings(features=perception.size, hidden=8, action_repeat=3, actions=4)
    metadata = {TASK: asdict(replace(TASK_OF_DEMO, catheter="simmons2"))}
    RecurrentPolicy(settings, perception=perception.content()).save(weights / "navigator_simmons2.pt", **metadata)
    (weights / "navigator_simmons2.md").write_text(CARD.format("navigator_simmons2"))


def inside(places: np.ndarray) -> bool:
    """Whether some of the places, shares of an image's side, lie in it."""
    return bool(((places >= 0) & (places <= 1)).all(axis=1).any())
