"""Small settings, tasks and jobs of the stage `unseen` for its tests."""

from pathlib import Path
from typing import Any

from pipeline.recording.trials import Origin
from pipeline.stages.unseen.image_policy import ImagePolicyJob
from pipeline.stages.unseen.settings import UnseenSettings
from pipeline.stages.unseen.task import UnseenTask
from pipeline.stages.unseen.trials import HeldOutSet
from pipeline.task import Task

TASK = UnseenTask(("lcca",), Task(wire_length_mm=312.0, image_size_px=96, max_steps=16))
TESTS = (HeldOutSet("unseen", (1,)),)


def small_settings(**changed: Any) -> UnseenSettings:
    values = {"curve": [1, 4], "anatomies": 8, "image_anatomies": 20, "phantoms": ["type_1"], "wires": ["softer"],
              "image": True, "clutter": 0.0, "demonstrations": 12,
              "decisions": 16_000, "curve_decisions": 8_000}  # fmt: skip
    return UnseenSettings(**{**values, **changed})


def image_job(folder: Path, rounds: int, row: str = "image_true_mask") -> ImagePolicyJob:
    small = {"segmenter_epochs": 1, "rounds": rounds, "advised_episodes": 1, "epochs": 1, "wire_epochs": 1}
    return ImagePolicyJob(
        folder=folder / "unseen",
        origin=Origin("unseen", row, 0, "desk"),
        task=TASK,
        anatomies=(0,),
        tests=TESTS,
        settings=small_settings(**small),
    )


def variety(**changed: Any) -> UnseenSettings:
    values = {"arches": "arch_variety", "phantoms": [], "wires": [], "anatomies": 8, "validation_anatomies": 6}
    task = Task(wire="arch_variety", pace="arch_variety", max_steps=8, success_radius_mm=5.0)
    return UnseenSettings(**{**values, "task": task, "points": 2, "image": False, "xray": False, **changed})
