"""The training loop of the segmenters of fluoroscopic images."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from enn.devices import bfloat16_on_processor
from enn.fitting import CHANNELS_FIRST, CHANNELS_LAST

_BATCH, _LEARNING_RATE = 8, 5e-3  # images an update; of Adam at its largest: it rises first and falls to nothing

Network = TypeVar("Network", bound=nn.Module)


def fitted(
    make: Callable[[], Network],
    count: int,
    loss_of: Callable[[Network, NDArray[np.intp], np.random.Generator], Tensor],
    *,
    epochs: int,
    seed: int,
    progress: Callable[[int, float], None] | None,
    device: torch.device | str,
) -> Network:
    """Makes and trains a network.

    Args:
        make: gives the network, with fresh weights.
        loss_of: gives the loss of a batch, from the network, the images' indices and the generator of augmentation.
        seed: of weights, order and augmentation.
        progress: called with each epoch's number and loss.
        device: where the network is trained and stays.
    """
    generator = np.random.default_rng(seed)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network = make().to(device, **CHANNELS_LAST)
    optimiser = torch.optim.Adam(network.parameters(), _LEARNING_RATE, fused=True)
    batches = -(-count // _BATCH)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, _LEARNING_RATE, total_steps=epochs * batches)
    network.train()
    for epoch in range(epochs):
        total = 0.0
        for rows in np.array_split(generator.permutation(count), batches):
            with bfloat16_on_processor():
                loss = loss_of(network, rows, generator)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            schedule.step()
            total += float(loss.detach()) * len(rows) / count
        if progress is not None:
            progress(epoch, total)
    network.to(**CHANNELS_FIRST)
    return network.eval()
