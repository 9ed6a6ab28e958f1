"""Jobs of the stages compute where they are told to: their networks live on another device than the CPU."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from pipeline.jobs.pool import Job
from pipeline.jobs.worker import Report
from pipeline.stages import force, imitation
from pipeline.stages.learning.settings import ForceSettings, ImitationSettings
from pipeline.store.run_folder import RunFolder
from tests.pipeline.stages.small_expert import TASK, context, write_expert
from tests.second_device import second_device

SMALL: dict[str, Any] = {"targets": ["bca"], "epochs": 1, "task": TASK.task}
ROUNDS = {"drawn_episodes": 1, "dagger_rounds": 1, "dagger_episodes": 1, "disturbed_episodes": 0}
IMITATION = ImitationSettings(phantoms=["type_1"], episodes=[1], evaluation_episodes=1, **SMALL, **ROUNDS)
FORCE = ForceSettings(samples=[12, 30], test_samples=12, inputs=["V", "I+V"], noise=0.5, **SMALL)


@pytest.fixture
def there(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """The second device, on which the stages' jobs compute in this process."""
    with second_device() as device:

        def run(folder: RunFolder, jobs: Sequence[Job], **_: Any) -> dict[str, Any]:
            return {job.key: job.run(job.given, Report(device=device)) for job in jobs}

        monkeypatch.setattr(imitation, "run_jobs", run)
        monkeypatch.setattr(force, "run_jobs", run)
        yield device


def devices_of(monkeypatch: pytest.MonkeyPatch, module: Any, name: str) -> list[str]:
    """Notes the `device` that a function of a module is called with."""
    told: list[str] = []
    original = getattr(module, name)

    def noted(*args: Any, **kwargs: Any) -> Any:
        told.append(str(kwargs.get("device", "cpu")))
        return original(*args, **kwargs)

    monkeypatch.setattr(module, name, noted)
    return told


def test_imitation_and_force(there: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import enn.force.prediction
    import enn.imitation.distillation

    write_expert(tmp_path / "enn")
    cloned = devices_of(monkeypatch, enn.imitation.distillation, "clone")
    refined = devices_of(monkeypatch, enn.imitation.distillation, "dagger")
    fitted = devices_of(monkeypatch, enn.force.prediction, "fit_force")
    stages = ((imitation.run_imitation, IMITATION, "bc_architecture"), (force.run_force, FORCE, "force_share"))
    for run, settings, table in stages:
        place = context(tmp_path, settings.name)
        run(settings, place).write(place.path)
        assert table in json.loads((place.path / "results.json").read_text())
    assert set(cloned) == set(refined) == set(fitted) == {there}
