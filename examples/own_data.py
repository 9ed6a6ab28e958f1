"""Data of your own: record episodes as logs, read windows of them with torch, fit a small network.

    python examples/own_data.py [FOLDER]

The same logs go to other software: python -m pipeline.episodes export FOLDER --to hdf5 --output OUTPUT
"""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
import torch
from torch.utils.data import DataLoader

from cathsim import NavigateEnv
from pipeline.recording.dataset import EpisodeDataset
from pipeline.recording.record import record_episode


def main(folder: str | None = None, episodes: int = 4, steps: int = 60, epochs: int = 30) -> list[float]:
    """Learn the tip's next movement from feeder and action; give the mean error of each epoch, mm."""
    logs = Path(folder or mkdtemp())
    env = NavigateEnv("type_1", "lcca", observation="tip", max_steps=steps)
    for seed in range(episodes):
        draw = np.random.default_rng(seed)
        policy = lambda observation, info, draw=draw: np.array([1.0, draw.uniform(-1, 1)])  # noqa: E731
        record_episode(env, policy, logs / f"{seed:03d}.mcap", seed=seed, operator="mine", pictures=False)
    data = EpisodeDataset(logs, fields=("tip", "feeder", "action"), window=2)
    torch.manual_seed(0)
    network = torch.nn.Sequential(torch.nn.Linear(8, 32), torch.nn.ReLU(), torch.nn.Linear(32, 3))
    optimiser, errors = torch.optim.Adam(network.parameters(), 0.01), []
    for _ in range(epochs):
        distances = []
        for batch in DataLoader(data, batch_size=16, shuffle=True):
            seen = torch.cat((100 * batch["tip"][:, 0], batch["feeder"][:, 0], batch["action"][:, 0]), dim=1).float()
            moved = 1e3 * (batch["tip"][:, 1] - batch["tip"][:, 0]).float()  # mm
            error = (network(seen) - moved).norm(dim=1)
            optimiser.zero_grad()
            error.mean().backward()
            optimiser.step()
            distances.append(error.mean().item())
        errors.append(float(np.mean(distances)))
    print(f"{len(data)} windows in {logs}; error {errors[0]:.2f} mm in the first epoch, {errors[-1]:.2f} in the last")
    return errors


if __name__ == "__main__":
    main(*sys.argv[1:2])
