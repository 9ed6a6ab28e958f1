"""torchrun from a stage: much on its error stream does not stop it, a failure is one sentence."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.stages.networks.training import train_together
from pipeline.store.errors import StageError

TALKER = """
import sys
from pathlib import Path
sys.stderr.write("much to say\\n" * 30_000)
Path(sys.argv[1]).write_text("finished")
"""


@pytest.fixture
def talker(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    (tmp_path / "talker.py").write_text(TALKER)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    return "talker"


def test_an_error_stream_that_nobody_reads_does_not_stop_the_training(talker: str, tmp_path: Path) -> None:
    looks: list[str] = []
    train_together(talker, [str(tmp_path / "written")], 1, lambda share, words="": looks.append(words))
    assert (tmp_path / "written").read_text() == "finished"
    assert looks[0] == "1 processes"


def test_a_failure_is_told_in_a_sentence() -> None:
    with pytest.raises(StageError, match=r"torchrun ended with code 1: .*no_such_training"):
        train_together("no_such_training", [], 1, lambda share, words="": None)
