"""The demo's page: the card's parts as text, and plots that fill their height."""

from __future__ import annotations

from pipeline.demo.page import plot, sections

CARD = """# a

Steers.

| file |
|---|

**What it sees.** The `image`
alone.

**Command.** None.

**Figures.** Some.

| x |

**Limits.** Many,

```bash
make demo
```
"""


def test_parts_of_a_card_are_plain_text() -> None:
    assert sections(CARD) == {"What it sees": "The image alone.", "Limits": "Many, make demo"}


def test_a_plot_spans_its_width_and_height() -> None:
    assert plot([0.0, 2.0, 1.0]) == "0.0,120.0 245.0,0.0 490.0,60.0"
    assert plot([0.0]) == "0.0,120.0"
