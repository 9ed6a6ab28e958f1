"""Jobs of the stages compute where they are told to: their networks live on another device than the CPU."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from pipeline.jobs.pool import Job
from pipeline.jobs.worker import Report
from pipeline.stages import force, imitation
from pipeline.store.run_folder import RunFolder
from tests.pipeline.stages import test_force as force_tests
from tests.pipeline.stages import test_imitation as imitation_tests
from tests.pipeline.stages.small_expert import context, write_expert
from tests.second_device import second_device


@pytest.fixture
def there(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """The second device, on which the stages' jobs compute in this process."""
    with second_device() as device:

        def run(folder: RunFolder, jobs: Sequence[Job], **_: Any) -> dict[str, Any]:
            return {job.key: job.run(job.given, Report(device=device)) for job in jobs}

        monkeypatch.setattr(imitation, "run_jobs", run)
        monkeypatch.setattr(force, "run_jobs", run)
        yield device


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run with an expert's episodes."""
    folder = tmp_path_factory.mktemp("run")
    write_expert(folder / "enn")
    return folder


def devices_of(monkeypatch: pytest.MonkeyPatch, module: Any, name: str) -> list[str]:
    """Notes the `device` that a function of a module is called with."""
    told: list[str] = []
    original = getattr(module, name)

    def noted(*args: Any, **kwargs: Any) -> Any:
        told.append(str(kwargs.get("device", "cpu")))
        return original(*args, **kwargs)

    monkeypatch.setattr(module, name, noted)
    return told


def test_imitation(there: str, run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import enn.imitation.distillation

    cloned = devices_of(monkeypatch, enn.imitation.distillation, "clone")
    refined = devices_of(monkeypatch, enn.imitation.distillation, "dagger")
    place = context(run, "imitation")
    imitation.run_imitation(
        imitation_tests.settings(episodes=[1], evaluation_episodes=1, disturbed_episodes=0), place
    ).write(place.path)
    assert set(cloned) == set(refined) == {there}
    assert "bc_architecture" in json.loads((place.path / "results.json").read_text())


def test_force(there: str, run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import enn.force.prediction

    fitted = devices_of(monkeypatch, enn.force.prediction, "fit_force")
    place = context(run, "force")
    force.run_force(force_tests.settings(inputs=["V", "I+V"]), place).write(place.path)
    assert set(fitted) == {there}
    assert "force_share" in json.loads((place.path / "results.json").read_text())
