"""The profile of ``make fuzz``, and its table of verdicts."""

import hypothesis
import pytest

from tests.fuzz.promise import verdicts

hypothesis.settings.register_profile("fuzz")


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Prints what every fuzzed reader did: cases, verdicts, cases a minute."""
    if hypothesis.settings.get_current_profile_name() != "fuzz":
        return
    row = "{:<22} {:>7} {:>8} {:>7} {:>9} {:>12}"
    lines = [row.format("reader", "cases", "refused", "equal", "accepted", "a minute")]
    for name, count in sorted(verdicts.items()):
        cases = count["refused"] + count["equal"] + count["accepted"]
        if cases:
            rate = f"{60_000 * cases / max(count['ms'], 1):.0f}"
            lines.append(row.format(name, cases, count["refused"], count["equal"], count["accepted"], rate))
    terminalreporter.section("damaged inputs")
    terminalreporter.write_line("\n".join(lines))
