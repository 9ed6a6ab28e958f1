"""The console in a headless Chromium: real keys move the wire, an episode is on disk, a pulled gamepad lets go."""

import json
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("fastapi", reason="the extra cathsim[console] is not installed")
pytest.importorskip("websockets", reason="the extra cathsim[console] is not installed")

from tests.headless_browser import Tab, find_browser, running_console, wait_until

pytestmark = pytest.mark.skipif(
    find_browser() is None, reason="no Chromium is installed (Debian: apt install chromium)"
)


@pytest.fixture(scope="module")
def episodes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("episodes")


@pytest.fixture(scope="module")
def address(episodes: Path) -> Iterator[str]:
    """A running console with short procedures (6 s)."""
    with running_console("--record", str(episodes), "--max-steps", "60") as address:
        yield address


@pytest.fixture(scope="module")
def tab(address: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tab]:
    with Tab(tmp_path_factory.mktemp("chromium")) as tab:
        tab.open(address)
        yield tab


def restart(tab: Tab) -> None:
    if tab.value("document.getElementById('end').open"):
        tab.value("document.getElementById('again').click()")
    else:
        tab.key("r", down=True)
        tab.key("r", down=False)
    wait_until(lambda: tab.frame()["state"] == "ready")


def stands_still(tab: Tab) -> float:
    """Waits until the wire has not moved for 0.4 s of a running clock: under load the last commands come late."""

    def still() -> bool:
        before = tab.frame()
        time.sleep(0.4)
        after = tab.frame()
        return after["step"] > before["step"] and abs(after["insertion_mm"] - before["insertion_mm"]) < 0.3

    wait_until(still)
    return float(tab.frame()["insertion_mm"])


def test_keys_move_the_wire_while_they_are_held(tab: Tab) -> None:
    restart(tab)
    assert tab.frame()["insertion_mm"] < 2
    tab.key("ArrowUp", down=True)
    wait_until(lambda: tab.frame()["insertion_mm"] > 15)
    tab.key("ArrowUp", down=False)
    stopped = stands_still(tab)
    tab.key("ArrowDown", down=True)
    wait_until(lambda: tab.frame()["insertion_mm"] < stopped - 4)
    tab.key("ArrowDown", down=False)
    assert tab.value("consoleStatistics.latencies.length") >= 2


def test_an_episode_is_on_disk_when_time_is_up_with_its_answers_and_is_replayed(tab: Tab, episodes: Path) -> None:
    restart(tab)
    tab.key("ArrowUp", down=True)
    before = tab.value("[consoleStatistics.received, performance.now()]")
    wait_until(lambda: tab.frame()["state"] == "ended")
    after = tab.value("[consoleStatistics.received, performance.now()]")
    tab.key("ArrowUp", down=False)
    rate = 1000 * (after[0] - before[0]) / (after[1] - before[1])
    assert rate > 10, "pictures come, even on a machine under load"
    wait_until(lambda: tab.value("document.getElementById('end').open"))
    recorded = Path(tab.value("document.getElementById('end-recorded').textContent").removeprefix("Recorded in "))
    assert recorded.is_file()
    assert episodes in recorded.parents
    tab.value("document.querySelectorAll('.likert').forEach((row, k) => row.querySelectorAll('input')[k % 5].click())")
    tab.value("document.getElementById('save-answers').click()")
    beside = recorded.with_name(f"{recorded.stem}.questionnaire.json")
    wait_until(beside.is_file)
    assert list(json.loads(beside.read_text())["answers"].values())[:7] == [1, 2, 3, 4, 5, 1, 2]
    wait_until(lambda: tab.value("sessionStorage.getItem('questionnaire answered')"))
    tab.value("document.getElementById('end').open && document.getElementById('end').close('closed')")
    tab.value("document.getElementById('replay').click()")
    wait_until(lambda: tab.frame()["state"] == "replay" and tab.frame()["step"] > 3)


def plug_gamepad(tab: Tab, axes: list[float], mapping: str = "") -> None:
    tab.value(f"""(() => {{
      const pad = {{ index: 0, id: "Test pad", connected: true, mapping: "{mapping}", axes: {axes}, buttons: [] }};
      window.testPads = [pad];
      navigator.getGamepads = () => window.testPads;
      const event = new Event("gamepadconnected");
      event.gamepad = pad;
      dispatchEvent(event);
    }})()""")


def pull_gamepad(tab: Tab) -> None:
    tab.value("""(() => {
      const event = new Event("gamepaddisconnected");
      event.gamepad = window.testPads[0];
      window.testPads = [null];
      dispatchEvent(event);
    })()""")


def test_a_gamepad_steers_and_lets_go_when_it_is_pulled_out(tab: Tab) -> None:
    restart(tab)
    plug_gamepad(tab, [0, -1, 0, 0])
    wait_until(lambda: tab.frame()["insertion_mm"] > 8)
    pull_gamepad(tab)
    assert tab.value("consoleStatistics.controls") == [0, 0]
    assert "gamepad was pulled out" in tab.value("document.getElementById('notice').textContent")
    stands_still(tab)


def choose_catheter(tab: Tab, name: str) -> None:
    tab.value(f"""(() => {{
      const select = document.getElementById("catheter");
      select.value = "{name}";
      select.dispatchEvent(new Event("change"));
    }})()""")
    wait_until(lambda: tab.value("consoleStatistics.task.catheter ?? ''") == name)
    # the task comes before the first picture of it
    wait_until(lambda: tab.frame()["state"] == "ready" and ("lead_mm" in tab.frame()) == bool(name))


def steered(tab: Tab) -> list[float]:
    return list(tab.value("consoleStatistics.controls"))


def test_two_devices_are_steered_by_keys(tab: Tab) -> None:
    restart(tab)
    choose_catheter(tab, "vertebral_6f")
    assert "VERTEBRAL 6F" in tab.value("document.getElementById('label-task').textContent")
    for name in ("w", "ArrowUp"):
        tab.key(name, down=True)
    wait_until(lambda: steered(tab) == [1, 0, 1, 0])
    wait_until(lambda: tab.frame()["catheter_insertion_mm"] > 15)
    tab.key("w", down=False)
    tab.key("d", down=True)
    tab.key("Shift", down=True)
    wait_until(lambda: steered(tab) == [0.25, 0, 0, 0.25])
    tab.key("Shift", down=False)
    wait_until(lambda: tab.frame()["lead_mm"] > 8 and tab.frame()["catheter_rotation_rad"] > 0.3)
    for name in ("d", "ArrowUp"):
        tab.key(name, down=False)
    wait_until(lambda: steered(tab) == [0, 0, 0, 0])
    frame = tab.frame()
    assert frame["rotation_rad"] == 0, "the catheter's keys do not turn the wire"
    assert len(frame["feeder_forces_n"]) == 2
    assert tab.value("document.getElementById('wire-insertion').textContent").endswith(" mm")


def test_two_fingers_steer_two_devices_on_a_phone(tab: Tab) -> None:
    restart(tab)
    tab.phone(390, 844)
    catheter, wire = ".pad:nth-of-type(1) [data-key=KeyW]", ".pad:nth-of-type(2) [data-key=ArrowUp]"
    tab.touch(catheter, wire)
    wait_until(lambda: steered(tab) == [1, 0, 1, 0])
    wait_until(lambda: tab.frame()["catheter_insertion_mm"] > 5)
    tab.touch()
    wait_until(lambda: steered(tab) == [0, 0, 0, 0])
    assert tab.value("document.documentElement.scrollWidth <= innerWidth"), "nothing sticks out to the side"
    shown = tab.value("""(() => {
      const pads = document.getElementById("pads").getBoundingClientRect();
      const picture = document.getElementById("fluoroscopy").getBoundingClientRect();
      const xray = document.getElementById("xray").getBoundingClientRect();
      return [pads.bottom <= innerHeight + 1, picture.top >= 0, picture.bottom <= xray.top + 1,
        document.getElementById("pedal").getBoundingClientRect().bottom <= pads.top + 1];
    })()""")
    assert shown == [True] * 4, "fluoroscopy, pedal and pads are on the screen together"
    assert "mm to go" in tab.value("document.getElementById('label-devices').innerText")
    assert not overlap(tab, "label-devices", "label-beam")
    tab.value("document.getElementById('setup').open = true")
    menu = tab.value("(() => { const box = document.querySelector('#setup > div').getBoundingClientRect(); "
                     "return [box.left >= 0, box.right <= innerWidth, box.bottom <= innerHeight]; })()")  # fmt: skip
    assert menu == [True] * 3, "the menu of the setup is on the screen"
    tab.value("document.getElementById('setup').open = false")
    tab.desktop()
    choose_catheter(tab, "")
    assert steered(tab) == [0, 0] or steered(tab) == [0, 0, 0, 0]
    assert "lead_mm" not in tab.frame()


def overlap(tab: Tab, one: str, other: str) -> bool:
    """Whether two elements of the page lie over each other."""
    return bool(
        tab.value(f"""(() => {{
          const [a, b] = ["{one}", "{other}"].map((id) => document.getElementById(id).getBoundingClientRect());
          return a.left < b.right && b.left < a.right && a.top < b.bottom && b.top < a.bottom;
        }})()""")
    )


def test_a_finger_that_still_steers_at_the_end_answers_no_question(tab: Tab) -> None:
    tab.value("sessionStorage.removeItem('questionnaire answered')")
    restart(tab)
    tab.phone(390, 844)
    tab.touch(".pad:nth-of-type(2) [data-key=ArrowUp]")
    wait_until(lambda: tab.value("document.getElementById('end').open"))
    assert tab.value("document.getElementById('end').scrollTop") == 0, "the score is seen first"
    tab.touch()
    time.sleep(0.3)
    assert not tab.value("document.getElementById('questions').hidden")
    assert tab.value("document.querySelectorAll('#criteria input:checked').length") == 0
    tab.touch("#criteria label:nth-of-type(4)")
    tab.touch()
    wait_until(lambda: tab.value("document.querySelectorAll('#criteria input:checked').length") == 1)
    tab.desktop()
    restart(tab)


def grey(tab: Tab, screen: str) -> float:
    """Mean grey level of the middle of a fluoroscopic screen."""
    return float(
        tab.value(f"""(() => {{
          const pen = document.getElementById("{screen}").getContext("2d");
          const data = pen.getImageData(100, 100, 280, 280).data;
          return data.reduce((sum, x, k) => sum + (k % 4 ? 0 : x), 0) / (data.length / 4);
        }})()""")
    )


def tap(tab: Tab, key: str) -> None:
    tab.key(key, down=True)
    tab.key(key, down=False)


def test_vessels_are_seen_after_an_injection_and_on_the_roadmap(tab: Tab) -> None:
    restart(tab)
    wait_until(lambda: tab.frame()["contrast"] == 0)
    plain = [grey(tab, screen) for screen in ("fluoroscopy", "second")]
    tap(tab, "c")
    wait_until(lambda: grey(tab, "fluoroscopy") < plain[0] - 2 and grey(tab, "second") < plain[1] - 2)
    wait_until(lambda: tab.frame()["contrast"] == 0 and abs(grey(tab, "fluoroscopy") - plain[0]) < 0.5)
    tap(tab, "m")
    wait_until(lambda: grey(tab, "fluoroscopy") > plain[0] + 1)
    tap(tab, "m")
    wait_until(lambda: not tab.frame()["roadmap"])


def test_the_pedal_holds_the_last_image_and_counts_the_dose(tab: Tab) -> None:
    restart(tab)
    tap(tab, "f")
    wait_until(lambda: not tab.frame()["beam"])
    held = grey(tab, "fluoroscopy")
    tab.key("ArrowUp", down=True)
    wait_until(lambda: tab.frame()["insertion_mm"] > 10)
    assert grey(tab, "fluoroscopy") == held
    assert tab.frame()["dose_s"] == 0
    tab.key(" ", down=True)
    wait_until(lambda: tab.frame()["dose_s"] > 0.3)
    tab.key(" ", down=False)
    tab.key("ArrowUp", down=False)
    wait_until(lambda: not tab.frame()["beam"])
    tap(tab, "f")
    wait_until(lambda: tab.frame()["beam"])


def test_c_arms_turn_by_dragging_and_zoom_by_the_wheel(tab: Tab) -> None:
    restart(tab)
    tab.drag("#fluoroscopy", (-75, 40))
    wait_until(lambda: tab.value("consoleStatistics.task.views.a.primary_deg") == -30)
    assert tab.value("consoleStatistics.task.views.a.secondary_deg") == 10
    assert tab.value("document.getElementById('angles-a').textContent") == "RAO 30° CRAN 10°"
    tab.call("Input.dispatchMouseEvent", type="mouseWheel", x=1100, y=300, deltaX=0, deltaY=-700)
    wait_until(lambda: tab.value("consoleStatistics.task.views.b.zoom") > 1.9)
    for screen in ("fluoroscopy", "second"):
        tab.value(f"document.getElementById('{screen}').dispatchEvent(new MouseEvent('dblclick'))")
    wait_until(lambda: tab.value("consoleStatistics.task.views.b.zoom") == 1)
    tab.value("document.getElementById('swap').click()")
    assert tab.value("document.getElementById('second').hidden && !document.getElementById('space').hidden")
    tab.value("document.getElementById('swap').click()")
