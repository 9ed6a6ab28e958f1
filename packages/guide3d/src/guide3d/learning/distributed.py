"""Ranks: the processes that train one network together, as torchrun starts them; one process is the plain case."""

from __future__ import annotations

import gc
import os
from dataclasses import dataclass

import torch
from torch import Tensor, distributed, nn


@dataclass(frozen=True)
class Ranks:
    """This process among its like, counted by `rank` from 0; rank 0 writes files."""

    rank: int
    count: int
    device: torch.device

    @classmethod
    def join(cls, device: str = "auto") -> Ranks:
        """Joins the processes that torchrun started; without torchrun this process is the only one.

        Args:
            device: "cpu", "cuda", or "auto": a GPU where there is one.

        Raises:
            ValueError: "cuda" where there is no GPU, or another word.
        """
        if device not in ("auto", "cpu", "cuda"):
            raise ValueError(f"unknown device '{device}'; there are auto, cpu, cuda")
        if device == "cuda" and not torch.cuda.is_available():
            raise ValueError("device cuda was asked for, but torch finds no GPU: take cpu or auto")
        kind = ("cuda" if torch.cuda.is_available() else "cpu") if device == "auto" else device
        count, rank = int(os.environ.get("WORLD_SIZE", "1")), int(os.environ.get("RANK", "0"))
        place = torch.device(kind, int(os.environ.get("LOCAL_RANK", "0"))) if kind == "cuda" else torch.device(kind)
        if kind == "cuda":
            torch.cuda.set_device(place)
        if count > 1 and not distributed.is_initialized():
            distributed.init_process_group("nccl" if kind == "cuda" else "gloo")
        return cls(rank, count, place)

    def leave(self) -> None:
        """Leaves the other processes."""
        if self.count > 1 and distributed.is_initialized():
            # a wrapped module that is still about keeps its share of the group beyond the end: gloo aborts there
            gc.collect()
            distributed.destroy_process_group()

    def wrapped(self, module: nn.Module) -> nn.Module:
        """The module, whose gradients are averaged over the ranks."""
        if self.count == 1:
            return module
        ids = [self.device.index] if self.device.type == "cuda" else None
        return nn.parallel.DistributedDataParallel(module, device_ids=ids)

    def summed(self, *values: float) -> list[float]:
        """Sums of numbers over the ranks."""
        if self.count == 1:
            return list(values)
        sums: Tensor = torch.tensor(values, dtype=torch.float64, device=self.device)
        distributed.all_reduce(sums)
        return [float(value) for value in sums]

    def wait(self) -> None:
        """Waits until every rank is here."""
        self.summed(0.0)
