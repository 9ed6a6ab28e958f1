"""The page in a headless Chromium: its height, nothing wider than the screen, figures sharp; run and empty."""

from collections.abc import Iterator

import pytest

pytest.importorskip("websockets", reason="the extra cathsim[console] is not installed")

from tests.headless_browser import Tab, find_browser, wait_until
from tests.pipeline.report.full_run import add_full_run
from tests.pipeline.stages.test_report import run_report

pytestmark = pytest.mark.skipif(
    find_browser() is None, reason="no Chromium is installed (Debian: apt install chromium)"
)

MOST_PIXELS = 9_000
WIDER = """(() => {
  const inside = e => e.closest('.scroll');  // which are looked at themselves
  return [...document.querySelectorAll('body *')]
    .filter(e => e.getBoundingClientRect().right > innerWidth + 1 && !inside(e))
    .concat([...document.querySelectorAll('.scroll')].filter(e => e.scrollWidth > e.clientWidth + 1))
    .map(e => e.tagName + ' ' + (e.closest('section') || e).id).slice(0, 9);
})()"""
BLURRED = """[...document.querySelectorAll('figure:not(.film) img')]
  .filter(e => e.getBoundingClientRect().width * 2 > e.naturalWidth + 2).map(e => e.alt)"""


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Addresses of the page of a run with everything, and of an empty one."""
    runs = tmp_path_factory.mktemp("runs")
    add_full_run(runs / "full")
    return {name: (run_report(runs, name) / "index.html").as_uri() for name in ("full", "empty")}


@pytest.fixture(scope="module")
def tab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tab]:
    with Tab(tmp_path_factory.mktemp("chromium")) as tab:
        yield tab


def show(tab: Tab, address: str, width: int, *, unfolded: bool = False) -> None:
    tab.call("Emulation.setDeviceMetricsOverride", width=width, height=900, deviceScaleFactor=2, mobile=width < 700)
    tab.call("Page.navigate", url=address)
    wait_until(lambda: tab.value("document.readyState === 'complete' && !!document.querySelector('footer')"))
    if unfolded:
        tab.value("document.querySelectorAll('details').forEach(one => { one.open = true; })")


@pytest.mark.parametrize("name", ["full", "empty"])
def test_the_page_is_short_and_its_first_screen_compares(tab: Tab, pages: dict[str, str], name: str) -> None:
    show(tab, pages[name], 1440)
    assert 500 < tab.value("document.documentElement.scrollHeight") <= MOST_PIXELS
    assert tab.value("document.getElementById('headlines').getBoundingClientRect().bottom") <= 900
    assert tab.value(BLURRED) == []


@pytest.mark.parametrize("name", ["full", "empty"])
@pytest.mark.parametrize("width", [390, 1440])
def test_nothing_is_wider_than_the_screen(tab: Tab, pages: dict[str, str], name: str, width: int) -> None:
    show(tab, pages[name], width, unfolded=True)
    assert tab.value("document.documentElement.scrollWidth") <= width
    assert tab.value(WIDER) == []


def test_a_link_to_a_folded_table_opens_it(tab: Tab, pages: dict[str, str]) -> None:
    show(tab, pages["empty"], 1440)
    assert not tab.value("document.getElementById('segmentation').checkVisibility()")
    tab.value("document.querySelector('a[href=\"#segmentation\"]').click()")
    wait_until(lambda: tab.value("document.getElementById('segmentation').checkVisibility()"))


def test_a_figure_is_enlarged_by_a_click(tab: Tab, pages: dict[str, str]) -> None:
    show(tab, pages["full"], 1440)
    tab.value("document.querySelector('.figures img').click()")
    assert tab.value("document.querySelector('figure.large img').getBoundingClientRect().height") > 300
    tab.value("dispatchEvent(new KeyboardEvent('keydown', {key: 'Escape'}))")
    assert tab.value("document.querySelector('figure.large')") is None
