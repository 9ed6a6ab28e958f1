"""Cores that stages share: as many jobs as cores, no more memory than there is, locks that end with their process."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from pipeline.jobs.engines.shared_cores import FOLDER, SharedCores, shared_cores


def test_there_are_as_many_jobs_as_cores() -> None:
    with shared_cores(2, 8.0):
        one, other = SharedCores.of_environment(), SharedCores.of_environment()
        assert one is not None
        assert other is not None
        first, second = one.take(1.0), other.take(1.0)
        assert first is not None
        assert second is not None
        assert one.take(0.1) is None
        second.free()
        third = one.take(0.1)
        assert third is not None
    assert SharedCores.of_environment() is None


def test_jobs_of_all_stages_share_the_memory() -> None:
    with shared_cores(3, 4.0):
        cores = SharedCores.of_environment()
        assert cores is not None
        assert cores.room_gb == 4.0
        large = cores.take(3.0)
        assert large is not None
        assert cores.take(1.5) is None
        small = cores.take(1.0)
        assert small is not None
        large.free()
        again = cores.take(2.9)
        assert again is not None


def test_a_core_is_free_when_its_stage_was_killed() -> None:
    hold = (
        "import sys, time\n"
        "from pipeline.jobs.engines.shared_cores import SharedCores\n"
        "core = SharedCores.of_environment().take(0.5)\n"
        "print('taken', flush=True)\n"
        "time.sleep(60)\n"
    )
    with shared_cores(1, 1.0):
        cores = SharedCores.of_environment()
        assert cores is not None
        with subprocess.Popen([sys.executable, "-c", hold], stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == "taken\n"
            assert cores.take(0.1) is None
            process.kill()
        assert cores.take(0.1) is not None


def test_a_folder_that_is_gone_means_no_sharing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(FOLDER, str(tmp_path / "gone"))
    assert SharedCores.of_environment() is None
    with shared_cores(1, 1.0):
        folder = Path(os.environ[FOLDER])
        assert folder.is_dir()
    assert not folder.exists()
