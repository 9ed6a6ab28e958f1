"""The registry of stages: in an order that follows what they read, without being imported."""

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import pipeline
from pipeline.config import CONFIG_DIRECTORY
from pipeline.stages import available_stages, load_stage, settings_of
from pipeline.store.errors import ConfigurationError
from pipeline.store.manifest import read_manifest

YAML = """\
# Counts to a number.
defaults: [/schema/stage@_here_: count, _self_]
until: ${seed}
"""
MODULE = '''\
"""The stage count."""

from __future__ import annotations

from dataclasses import field
from typing import Any

from pipeline.settings.kinds import NO_EFFECT_ON_RESULTS, validated
from pipeline.settings.kinds import Count, Seed
from pipeline.stages import Stage
from pipeline.store.atomic_files import write_json


@validated()
class CountSettings:
    """Settings of the stage count."""

    name: str = "count"
    numbers: Count = 20
    until: Seed = 0
    step: Count = 3
    threads: int = field(default=0, metadata=NO_EFFECT_ON_RESULTS)


def run_count(settings: CountSettings, context: Any) -> None:
    """Writes the numbers."""
    write_json(context.path / "numbers.json", list(range(0, settings.numbers * settings.step, settings.step)))


STAGE = Stage(settings=CountSettings, run=run_count, reads=("user_study",))
'''


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the pipeline with one more stage, which two files and a line make."""
    folder = tmp_path_factory.mktemp("project")
    source = Path(pipeline.__file__).parent
    shutil.copytree(source, folder / "pipeline", ignore=shutil.ignore_patterns("conf"))
    shutil.copytree(CONFIG_DIRECTORY, folder / "conf")
    shutil.copy(source.parent / "Makefile", folder)
    (folder / "tests" / "pipeline" / "stages").mkdir(parents=True)
    (folder / "conf" / "stage" / "count.yaml").write_text(YAML)
    with (folder / "conf" / "sizes" / "smoke.yaml").open("a") as sizes:
        sizes.write("count: {numbers: 2}\n")
    (folder / "pipeline" / "stages" / "count.py").write_text(MODULE)
    registry = folder / "pipeline" / "stages" / "__init__.py"
    report = '    "report": ('
    registry.write_text(
        registry.read_text().replace(report, f'    "count": ("count", "count:CountSettings"),\n{report}')
    )
    return folder


@pytest.fixture
def in_project(project: Path) -> Callable[..., subprocess.CompletedProcess[str]]:
    """Runs a command in the copy."""

    def run(*words: str) -> subprocess.CompletedProcess[str]:
        environment = {**os.environ, "PYTHONPATH": str(project), "PYTHONDONTWRITEBYTECODE": ""}
        return subprocess.run(words, cwd=project, env=environment, capture_output=True, text=True, check=False)

    return run


def test_two_files_and_a_line_add_a_stage_as_the_template_does(
    project: Path, in_project: Callable[..., subprocess.CompletedProcess[str]]
) -> None:
    """Both stages are in one run, whose report has what they left; a wrong setting of one is a sentence."""
    python = (sys.executable, "-m")
    made = in_project(*python, "pipeline.command", "new", "stage", "ways_there")
    assert made.returncode == 0, made.stderr
    assert "stage: Counts to a number." in in_project("make", "help").stdout
    run = ["budget=smoke", "name=run"]
    counting = [*run, "stage.step=4"]
    commands = [
        ["chain", "--inputs", "count", "--", *counting], ["stages", "stage=count", *counting, "stage.threads=2"],
        ["stages", "stage=ways_there", *run], ["stages", "stage=report", *run],
        ["stages", "stage=count", "name=wrong", "stage.steps=2"],
    ]  # fmt: skip
    code = f"from pipeline.command import main\nprint([main(words) for words in {commands}], flush=True)"
    done = in_project(sys.executable, "-c", f"{code}\nmain(['new', 'stage', 'ways_there'])")
    assert done.stdout.splitlines()[-1] == "[0, 0, 0, 0, 2]", done.stderr
    assert done.returncode == 2
    assert "did you mean stage.step?" in done.stderr
    for told in ("stage 1 of 2: user_study", "stage 2 of 2: count", "count: up to date"):
        assert told in done.stdout
    folder = project / "runs" / "run" / "count"
    assert (folder / "numbers.json").read_text().split() == ["[", "0,", "4", "]"]
    manifest = read_manifest(folder)
    assert manifest is not None
    assert manifest.config == {"name": "count", "numbers": 2, "until": 0, "step": 4, "threads": 0}
    tested = in_project(*python, "pytest", "-q", "tests/pipeline/stages/test_ways_there.py")
    assert "1 passed" in tested.stdout
    page = (project / "runs" / "run" / "report" / "index.html").read_text()
    for words_of_it in (">Count<", ">Ways there<", "Length of the way to each target."):
        assert words_of_it in page


def test_stages_come_after_what_they_read_and_an_unknown_one_is_refused() -> None:
    order = available_stages()
    assert (order[0], order[-1]) == ("phantoms", "report")
    for position, name in enumerate(order):
        stage = load_stage(name)
        assert stage.name == name
        assert stage.settings is settings_of(name)
        assert set(stage.reads) <= set(order[:position])
    with pytest.raises(ConfigurationError, match="unknown stage 'phantom': choose one of phantoms"):
        load_stage("phantom")


def test_nothing_heavy_is_imported_before_a_stage_runs(run_python: Callable[[str], str]) -> None:
    heavy = ("torch", "mujoco", "stable_baselines3", "matplotlib", "scipy", "cathsim", "guide3d")
    told = run_python(
        "import sys\nfrom pipeline.launch import main\n"
        "main(['--help'])\nmain(['stage=navigation', '--cfg', 'job'])\n"
        f"print([name for name in {heavy} if name in sys.modules])\n"
        "from pipeline.stages import available_stages, load_stage\n"
        "print(*[name for name in map(load_stage, available_stages()) if 'torch' in sys.modules])"
    )
    assert told.splitlines()[-2:] == ["[]", ""]
