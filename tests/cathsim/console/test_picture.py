"""The operator's picture is the environment's frontal image."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from cathsim import NavigateEnv
from cathsim.console.picture import IMAGE_SIZE, FluoroscopyMonitor
from cathsim.console.procedure import Procedure, devices_between
from cathsim.opencv import cv2


@pytest.mark.parametrize("catheter", [None, "vertebral_6f"])
def test_a_picture_shows_what_the_environment_sees(make_env: Callable[..., NavigateEnv], catheter: str | None) -> None:
    env = make_env(catheter=catheter, image_size=IMAGE_SIZE)
    procedure = Procedure(env, None, seed=0)
    for _ in range(20):
        procedure.step(1.0, 0.3, (0.5, 0.0))
    monitor = FluoroscopyMonitor(env.simulation)
    devices = devices_between(*procedure.samples[-2:], 1.0, env.simulation.wire.links)
    jpeg = np.frombuffer(monitor.jpeg(*devices), np.uint8)
    shown = cv2.imdecode(jpeg, cv2.IMREAD_UNCHANGED).astype(float)
    assert shown.ndim == 2
    seen = env.fluoroscope.image().astype(float)
    assert np.abs(shown - seen).max() < 20, "no more apart than JPEG makes them"
    if catheter is not None:
        covered = env.fluoroscope.mask("catheter").astype(bool) & ~env.fluoroscope.mask("wire").astype(bool)
        bare = np.asarray(env.fluoroscope.renderer.background).astype(float)
        assert covered.sum() > 20
        assert (shown - bare)[covered].mean() < -5, "the catheter is seen beside the wire"
