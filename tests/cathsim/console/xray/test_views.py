"""Views, pictures, contrast medium and dose of the X-ray room."""

import queue
from collections.abc import Callable

import numpy as np
import pytest

from cathsim.console.procedure import Procedure, devices_between
from cathsim.console.xray.monitor import IMAGE_SIZE, CArm, FluoroscopyMonitor
from cathsim.console.xray.room import FILLING, WASHOUT, Views, XRayRoom, concentration
from cathsim.viewing.opencv import cv2
from tests.cathsim.makers import MakeEnv


def test_a_turned_view_is_shown_when_it_is_built(make_env: MakeEnv) -> None:
    calls: queue.Queue[tuple[str, Callable[[], None]]] = queue.Queue()
    env = make_env()
    env.reset(seed=0)
    turned: list[bool] = []
    views = Views(XRayRoom(), lambda name, call: calls.put((name, call)), lambda: turned.append(True))
    views.open(env.simulation)
    views.turn("a", CArm(primary_deg=30.0))
    name, show = calls.get(timeout=60)
    assert name == "turned a"
    assert views.marks(env.task)["a"]["primary_deg"] == 0.0
    show()
    assert views.marks(env.task)["a"]["primary_deg"] == 30.0
    assert turned == [True]
    views.turn("b", CArm(primary_deg=60.0))
    _, late = calls.get(timeout=60)
    other = make_env()
    other.reset(seed=0)
    views.open(other.simulation)
    late()
    assert turned == [True], "a view of a simulation that is gone is not shown"
    views.close()


@pytest.mark.parametrize("catheter", [None, "vertebral_6f"])
def test_a_picture_shows_what_the_environment_sees(make_env: MakeEnv, catheter: str | None) -> None:
    env = make_env(catheter=catheter, image_size=IMAGE_SIZE)
    procedure = Procedure(env, None, seed=0)
    for _ in range(20):
        procedure.step(1.0, 0.3, (0.5, 0.0))
    monitor = FluoroscopyMonitor(env.simulation)
    devices = devices_between(*procedure.samples[-2:], 1.0, env.simulation.wire.links)
    jpeg = np.frombuffer(monitor.jpeg(*devices, contrast=1.0), np.uint8)
    shown = cv2.imdecode(jpeg, cv2.IMREAD_UNCHANGED).astype(float)
    assert shown.ndim == 2
    seen = env.fluoroscope.image().astype(float)
    bright = seen.max() * 0.8  # beyond it one of both images is overexposed
    dark = (shown < bright) & (seen < bright)
    ratio = shown[dark] / np.maximum(seen[dark], 1)
    assert np.median(np.abs(ratio - np.median(ratio))) < 0.02, "but for the exposure, the same image"
    if catheter is not None:
        covered = env.fluoroscope.mask("catheter").astype(bool) & ~env.fluoroscope.mask("wire").astype(bool)
        bare = np.median(ratio) * np.asarray(env.fluoroscope.renderer.background).astype(float)
        assert covered.sum() > 20
        assert (shown - bare)[covered].mean() < -5, "the catheter is seen beside the wire"


def test_contrast_and_roadmap_show_vessels_and_turned_arms_see_the_target_elsewhere(
    make_env: MakeEnv,
) -> None:
    env = make_env()
    procedure = Procedure(env, None, seed=0)
    monitor, wire = FluoroscopyMonitor(env.simulation, size=240), procedure.samples[0].points
    plain, filled, map_ = (
        monitor.image(wire, **seen).astype(float).copy() for seen in ({}, {"contrast": 1.0}, {"roadmap": True})
    )
    changed = np.abs(filled - plain) > 10
    assert 0.03 < changed.mean() < 0.5
    assert (filled[changed] < plain[changed]).all()
    assert (map_[changed] >= plain[changed]).all()
    half = monitor.image(wire, contrast=0.5).astype(float)
    assert np.abs(half[changed] ** 2 - filled[changed] * plain[changed]).max() < 700, "transmissions multiply"
    frontal, lateral, near = (
        FluoroscopyMonitor(env.simulation, view, size=240).mark(env.task)
        for view in (CArm(), CArm(primary_deg=90), CArm(zoom=2))
    )
    assert abs(frontal["pixel"][0] - lateral["pixel"][0]) > 5
    assert frontal["pixel"][1] == pytest.approx(lateral["pixel"][1], abs=8)
    assert near["radius"] == pytest.approx(2 * frontal["radius"])
    off = np.array(near["pixel"]) - 119.5
    assert off == pytest.approx(2 * (np.array(frontal["pixel"]) - 119.5))


def test_contrast_fills_and_washes_out() -> None:
    assert concentration(-1.0) == 0.0
    assert concentration(FILLING / 2) == pytest.approx(0.5)
    assert concentration(FILLING) == pytest.approx(1.0)
    assert concentration(FILLING + WASHOUT) == pytest.approx(0.3679, abs=1e-4)
    assert concentration(30.0) == 0.0


def test_the_dose_is_the_control_steps_in_which_the_beam_was_on() -> None:
    room = XRayRoom()
    assert room.contrast == 0.0
    room.advance(1.0)
    assert room.dose == 0.0, "no step has begun"
    assert [room.step().on for _ in range(3)] == [True] * 3
    room.beam = False
    assert not room.step().on
    room.beam = True
    room.beam = False
    assert [room.step().on for _ in range(2)] == [True, False], "a tap counts for one step"
    assert room.dose == pytest.approx(0.4)
    room.beam = True
    room.beam = False
    room.wait()
    assert not room.step().on, "nor does a tap before the procedure"


def test_a_c_arm_turns_within_its_limits() -> None:
    assert CArm(primary_deg=-30, secondary_deg=20, zoom=2).zoom == 2
    for wrong in ({"primary_deg": 180}, {"secondary_deg": 60}, {"zoom": 0.5}):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            CArm(**wrong)
