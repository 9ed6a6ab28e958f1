"""The choice of an engine on the command line, and what it refuses."""

from __future__ import annotations

import pytest

from pipeline.jobs.engines.settings import SETTINGS
from pipeline.store.manifest import read_manifest
from pipeline.variants import effective_overrides


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["engine=rai"], "unknown engine 'rai': choose one of local, ray, slurm"),
        (["engine=ray", "engine.retrys=3"], "unknown setting 'engine.retrys' (did you mean engine.retries?)"),
        (["engine=ray", "engine.retries=-1"], "engine.retries must be 0 or more, got -1"),
        (["engine.retries=1"], "unknown setting 'engine.retries': engine=local has none"),
        (["engine=slurm", "engine.manager=pbs"], "engine.manager has no 'pbs': choose from slurm, local"),
    ],
)
def test_what_is_no_engine_is_refused(overrides: list[str], words: str, pipeline_process) -> None:
    done = pipeline_process.run("stage=report", "budget=smoke", "name=run", *overrides)
    assert done.returncode == 2
    assert done.stderr.startswith(words)
    assert len(done.stderr.strip().splitlines()) == 1


def test_an_engine_is_no_part_of_the_result(pipeline_process) -> None:
    assert effective_overrides(["engine=ray", "engine.retries=3", "seed=1"]) == ["seed=1"]
    for engine in SETTINGS:
        done = pipeline_process.run("stage=report", "budget=smoke", "name=run", f"engine={engine}")
        assert done.returncode == 0, done.stderr
        assert ("up to date" in done.stderr + done.stdout) == (engine != "local")
    manifest = read_manifest(pipeline_process.runs / "run" / "report")
    assert manifest is not None
    assert manifest.variant == []
