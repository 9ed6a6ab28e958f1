"""Pace of a machine: the processor seconds that it takes for a small workload of what stages spend their time with.

Processor time and not wall time: what else runs at that moment need not run as long as a chain does.

``python -m pipeline.chain.pace`` prints them; minutes of a budget are of a machine whose seconds are known
(`conf/budget`), and become those of this one by their ratio.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

from pipeline.jobs.engines.local import ONE_THREAD, available_workers

CORES = 2  # on which a budget's minutes were measured
_PARTS = 3  # of the workload; the middle one counts, since others may need the machine for a moment
_LONGEST_S = 60.0
_TRAINING_STEPS, _SIMULATION_STEPS, _LINKS = 8, 600, 80


def machine_seconds() -> float | None:
    """Processor seconds of the workload with both cores at work, twice as many on one; None where it fails."""
    count = min(available_workers(), CORES)
    command = [sys.executable, "-m", "pipeline.chain.pace", "--alone"]
    environment = os.environ | ONE_THREAD
    processes = [
        subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        for _ in range(count)
    ]
    found = []
    try:
        for process in processes:
            told, _ = process.communicate(timeout=_LONGEST_S)
            found.append(float(told))
    except (subprocess.TimeoutExpired, ValueError):
        return None
    finally:
        for process in processes:
            process.kill()
            process.wait()
    return CORES / count * sum(found) / count


def alone() -> float:
    """Processor seconds of the workload in this process."""
    import mujoco

    training = _training_step()
    model = mujoco.MjModel.from_xml_string(_chain_of_links())
    data = mujoco.MjData(model)
    training()  # the first makes what later ones use
    seconds = []
    for _ in range(_PARTS):
        began = time.process_time()
        for _ in range(_TRAINING_STEPS):
            training()
        mujoco.mj_resetData(model, data)
        mujoco.mj_step(model, data, _SIMULATION_STEPS)
        seconds.append(time.process_time() - began)
    return sorted(seconds)[_PARTS // 2]


def _training_step() -> Callable[[], None]:
    """A step of training of convolutions and a transformer's block, in the precision that networks are trained in."""
    import torch
    from torch import nn

    from guide3d.learning.precision import bfloat16_on_processor
    from guide3d.modeling.vision_transformer import TransformerBlock

    torch.manual_seed(0)
    torch.set_num_threads(1)
    layout: Any = {"memory_format": torch.channels_last}  # as networks are trained
    network = nn.Sequential(
        nn.Conv2d(2, 24, 3, 2, 1), nn.ReLU(), nn.Conv2d(24, 48, 3, 2, 1), nn.ReLU(), nn.Conv2d(48, 96, 3, 2, 1),
        nn.Flatten(2), TransformerBlock(256, 4, 512), nn.Linear(256, 2),
    ).to(**layout)  # fmt: skip
    optimiser = torch.optim.Adam(network.parameters(), lr=1e-4)
    images = torch.rand(8, 2, 128, 128)

    def step() -> None:
        optimiser.zero_grad()
        with bfloat16_on_processor():
            predicted = network(images)
        predicted.float().square().mean().backward()
        optimiser.step()

    return step


def _chain_of_links() -> str:
    """A hanging chain, as a model of MuJoCo."""
    link = (
        '<body pos="0 0 -.004"><joint type="ball" damping="1e-5"/>'
        '<geom type="capsule" size=".0005" fromto="0 0 0 0 0 -.004"/>'
    )
    option = '<option timestep=".002" integrator="implicitfast"><flag contact="disable"/></option>'
    return f"<mujoco>{option}<worldbody>{link * _LINKS}{'</body>' * _LINKS}</worldbody></mujoco>"


if __name__ == "__main__":
    print(alone() if "--alone" in sys.argv else machine_seconds())  # noqa: T201 - what a command line says
