"""The command line of training refuses with one sentence."""

from __future__ import annotations

from pathlib import Path

import pytest

from splineformer.learning.training_command import main as command
from tests.guide3d.learning.drawn_data import draw


@pytest.mark.parametrize(
    "more", [("--epochs", "0"), ("--epochs", "10000000000000"), ("--calibration", "{none}"), ("--output", "{file}")]
)
def test_command_refuses_with_one_sentence(
    more: tuple[str, str], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    draw(tmp_path)
    (tmp_path / "file").write_text("no folder")
    words = [str(tmp_path), "--variant", "ordered", "--size", "smoke", "--device", "cpu", "--output", str(tmp_path)]
    given = [word.format(none=tmp_path / "none", file=tmp_path / "file") for word in more]
    with caplog.at_level("ERROR"):
        assert command([*words, *given]) == 2
    messages = [record.getMessage() for record in caplog.records if record.levelname == "ERROR"]
    assert len(messages) == 1
    assert "\n" not in messages[0]
    with pytest.raises(SystemExit):
        command([*words, "--seed=-1"])
