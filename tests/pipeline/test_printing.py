"""What commands print, also where nobody reads it, where the stream is closed and where the disk is full."""

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


@pytest.mark.parametrize("words", ["-m pipeline.command models", "-m guide3d"])
def test_output_that_is_closed_is_no_error_and_a_full_disk_is_one_sentence(words: str) -> None:
    for redirection, code, lines in ((">&-", 0, 0), ("2>&-", 0, 0), (">/dev/full", 1, 1)):
        shell = ["sh", "-c", f'exec "{sys.executable}" {words} {redirection}']
        process = subprocess.run(shell, capture_output=True, text=True, check=False)
        assert (process.returncode, len(process.stderr.splitlines())) == (code, lines), (redirection, process.stderr)


def test_texts_go_where_they_belong(capfd: pytest.CaptureFixture[str]) -> None:
    say("a result\n")
    say("an error", error=True)
    assert capfd.readouterr() == ("a result\n", "an error\n")
