"""What commands print where the reader leaves before the end."""

from __future__ import annotations

import subprocess
import sys

import pytest

from pipeline.printing import say

LEFT = "import sys; from pipeline.printing import say; sys.stdin.read(); say('first'); say('second'); sys.exit(3)"


def test_a_reader_that_has_gone_is_no_error() -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", LEFT], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdin is not None
    assert process.stdout is not None
    assert process.stderr is not None
    process.stdout.close()  # as `head` does
    process.stdin.close()
    assert process.stderr.read() == ""
    assert process.wait(60) == 3


def test_texts_go_where_they_belong(capfd: pytest.CaptureFixture[str]) -> None:
    say("a result\n")
    say("an error", error=True)
    assert capfd.readouterr() == ("a result\n", "an error\n")
