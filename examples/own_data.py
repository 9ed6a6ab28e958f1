"""Data of your own: record episodes as logs, read their steps as arrays, fit a small network with torch.

    python examples/own_data.py [FOLDER]

The same logs go to other software: python -m pipeline.episodes export FOLDER --to hdf5 --output OUTPUT
"""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
import torch
from torch.utils.data import DataLoader, TensorDataset

from cathsim import NavigateEnv
from pipeline.episodes import EpisodeReader
from pipeline.recording.record import record_episode


def read_steps(path: Path) -> list[torch.Tensor]:
    """Before each action of a log what is known (tip, insertion, rotation, action), and how the tip then moves, mm."""
    with EpisodeReader(path) as log:
        arrays = log.load_arrays(pictures=False)
    feeder = np.column_stack((arrays["insertion"], arrays["rotation"]))[:-1]
    known = np.column_stack((100 * arrays["tip"][:-1], feeder, arrays["action"][1:]))
    return [torch.tensor(values, dtype=torch.float32) for values in (known, 1e3 * np.diff(arrays["tip"], axis=0))]


def main(folder: str | None = None, episodes: int = 4, steps: int = 60, epochs: int = 30) -> list[float]:
    """Learn the tip's next movement from feeder and action; give the mean error of each epoch, mm."""
    logs = Path(folder or mkdtemp())
    env = NavigateEnv("type_1", "lcca", observation="tip", max_steps=steps)
    for seed in range(episodes):
        draw = np.random.default_rng(seed)
        policy = lambda observation, info, draw=draw: np.array([1.0, draw.uniform(-1, 1)])  # noqa: E731
        record_episode(env, policy, logs / f"{seed:03d}.mcap", seed=seed, operator="mine", pictures=False)
    known, moves = zip(*map(read_steps, sorted(logs.glob("*.mcap"))), strict=True)
    data = TensorDataset(torch.cat(known), torch.cat(moves))
    torch.manual_seed(0)
    network = torch.nn.Sequential(torch.nn.Linear(7, 32), torch.nn.ReLU(), torch.nn.Linear(32, 3))
    optimiser, errors = torch.optim.Adam(network.parameters(), 0.01), []
    for _ in range(epochs):
        distances = []
        for seen, moved in DataLoader(data, batch_size=16, shuffle=True):
            error = (network(seen) - moved).norm(dim=1)
            optimiser.zero_grad()
            error.mean().backward()
            optimiser.step()
            distances.append(error.mean().item())
        errors.append(float(np.mean(distances)))
    print(f"{len(data)} steps in {logs}; error {errors[0]:.2f} mm in the first epoch, {errors[-1]:.2f} in the last")
    return errors


if __name__ == "__main__":
    main(*sys.argv[1:2])
