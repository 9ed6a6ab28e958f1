"""Time of what the thesis's trainings consist of: updates of SAC and PPO, and images through the networks and back.

    python benchmarks/pipeline/thesis_updates.py [--quick] [--repeats N] [--device cpu|cuda]

Networks, batches and image sizes of `budget=thesis`, observations and images random, one thread. The hours in
docs/results/computing.md are made from these. Prints tables and, in
its last line, a JSON object: by row update_ms (median of the repeats) and the seconds per decision that it comes to; by
network the seconds of an image (shape networks: of a clip of three), forward, backward, without augmentation.

On a CPU the times are CPU time, and networks are given one image. With `--device cuda` they are wall time up to the
end of the GPU's work; networks get the thesis's batch in mixed precision and in float32 (`float32_s`), with a step of
the optimiser, as in a training. Of both the memory that torch reserved at most (gpu_gb) is given, with the context
(measured) added, beside what `pipeline.stages.job_memory` expects (expected_gb).
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import statistics
import time
from collections.abc import Callable
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import gymnasium
import numpy as np
import torch
from stable_baselines3 import PPO, SAC

from enn.networks.features import MultimodalExtractor
from enn.networks.observation_spaces import modality_keys
from enn.reinforcement.training.settings import THESIS_PPO, THESIS_SAC
from guide3d.learning.build import SEGMENTER_SIZES, SEGMENTERS, SHAPE_SIZES, build_segmenter, build_shape_network
from guide3d.learning.recipes import segmentation_recipe, shape_recipe
from pipeline.stages.job_memory import network_gb, policy_gb
from splineformer.build import build, size_of
from splineformer.learning.recipes import recipe_of

NETWORKS = ("unet", "transunet", "swinunet", "shape", "published", "ordered")
PPO_EPOCHS = 10  # of stable-baselines3
# row: keys of the observation, side of the images, algorithm
ROWS: dict[str, tuple[tuple[str, ...], int, str]] = {
    **{f"enn {name}": (modality_keys(name), 80, "sac") for name in ("I", "V", "V+M", "I+V", "I+V+M")},
    **{
        f"baselines {algorithm}_{key}": ((key,), 128, algorithm)
        for algorithm in ("sac", "ppo")
        for key in ("internal", "image", "sequential")
    },
}
NUMBERS = {"joints": 336, "internal": 2352}
CHANNELS = {"image": 1, "mask": 1, "sequential": 3}
ACTIONS = {"enn": 2, "baselines": 21}


class Blank(gymnasium.Env[Any, Any]):
    """Gives one random observation of a space, for ever; takes actions of any number of values in [-1, 1]."""

    def __init__(self, observation_space: gymnasium.spaces.Space[Any], actions: int) -> None:
        self.action_space = gymnasium.spaces.Box(-1, 1, (actions,), np.float32)
        self.observation_space = observation_space
        self._observation = observation_space.sample()

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        return self._observation, {}

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        return self._observation, 0.0, False, False, {}


def spaces_of(keys: tuple[str, ...], image_px: int) -> gymnasium.spaces.Dict:
    """Observations of these names as the thesis has them."""
    return gymnasium.spaces.Dict(
        {
            key: gymnasium.spaces.Box(-np.inf, np.inf, (NUMBERS[key],), np.float32)
            if key in NUMBERS
            else gymnasium.spaces.Box(0, 255, (CHANNELS[key], image_px, image_px), np.uint8)
            for key in keys
        }
    )


def update_of(row: str, device: str) -> tuple[Callable[[], object], float]:
    """An update of a row's training with everything that it learns from, and how many a decision needs."""
    keys, image_px, algorithm = ROWS[row]
    environment = Blank(spaces_of(keys, image_px), ACTIONS[row.partition(" ")[0]])
    preset = THESIS_SAC if algorithm == "sac" else THESIS_PPO
    arguments: dict[str, Any] = {
        "net_arch": list(preset.hidden),
        "features_extractor_class": MultimodalExtractor,
        "features_extractor_kwargs": {"keys": keys, "variant": "thesis"},
    }
    batch = preset.batch_size
    if algorithm == "sac":
        sac = SAC("MultiInputPolicy", environment, policy_kwargs=arguments, seed=0, device=device, buffer_size=300,
                  batch_size=batch, learning_starts=280)  # fmt: skip
        sac.learn(280)
        return lambda: sac.train(1, batch), 1.0
    ppo = PPO("MultiInputPolicy", environment, policy_kwargs=arguments, seed=0, device=device, n_steps=batch,
              batch_size=batch, n_epochs=1)  # fmt: skip
    ppo.learn(batch)  # fills the roll-out with one batch
    return ppo.train, PPO_EPOCHS / batch


def network_s(name: str, repeats: int) -> float:
    """Median CPU time of an image through a network and back, s."""
    network, inputs = built(name)
    network.train()

    def both_ways() -> None:
        network.zero_grad()
        loss_of(network, inputs).backward()

    return measured(both_ways, repeats) / 1e3


def network_on_gpu_s(name: str, repeats: int, device: str, mixed: bool) -> float:
    """Median time of an image in a step with a whole batch, s; out-of-memory is `torch.OutOfMemoryError`."""
    batch = batch_of(name)
    network, inputs = built(name, batch)
    network, inputs = network.to(device).train(), tuple(one.to(device) for one in inputs)
    optimiser = torch.optim.AdamW(network.parameters(), 1e-5, fused=True)

    def step() -> None:
        optimiser.zero_grad()
        with torch.autocast(device, torch.bfloat16, enabled=mixed):
            loss = loss_of(network, inputs)
        loss.backward()
        optimiser.step()

    return measured(step, repeats, device) / 1e3 / batch


def loss_of(network: torch.nn.Module, inputs: tuple[torch.Tensor, ...]) -> torch.Tensor:
    """A loss on everything that a network gives."""
    return torch.stack([found.float().square().mean() for found in tensors(network(*inputs))]).sum()


def batch_of(name: str) -> int:
    """Images (clips) of an update at the thesis's size."""
    if name in ("published", "ordered"):
        return int(recipe_of(name, "thesis").fit.batch_size)
    recipe = segmentation_recipe(name, "thesis") if name in SEGMENTERS else shape_recipe("thesis")
    return recipe.fit.batch_size


def built(name: str, batch: int = 1) -> tuple[torch.nn.Module, tuple[torch.Tensor, ...]]:
    """A network at the thesis's size, and random inputs."""
    if name in ("published", "ordered"):
        settings = size_of(name, "thesis")
        image = 255 * torch.rand(batch, 1, settings.image_px, settings.image_px)
        return build(settings), (image, torch.rand(batch, settings.limit - 1, 3)) if name == "published" else (image,)
    if name in SEGMENTERS:
        side = segmentation_recipe(name, "thesis").crop_px
        return build_segmenter(name, side, **SEGMENTER_SIZES[name]["thesis"]), (torch.rand(batch, 1, side, side),)
    size = SHAPE_SIZES["thesis"]
    return build_shape_network(size, None, 60), (255 * torch.rand(batch, size.frames, size.image_px, size.image_px),)


def tensors(found: Any) -> list[torch.Tensor]:
    """The tensors that a network's output holds and that gradients pass."""
    if isinstance(found, torch.Tensor):
        return [found] if found.requires_grad else []
    parts = vars(found).values() if hasattr(found, "__dict__") else found if isinstance(found, tuple | list) else ()
    return [tensor for part in parts for tensor in tensors(part)]


def measured(work: Callable[[], object], repeats: int, device: str = "cpu") -> float:
    """Median time of a call after the first, ms: CPU time, beside a GPU wall time."""
    clock = time.process_time if device == "cpu" else time.perf_counter
    finish = (lambda: None) if device == "cpu" else torch.cuda.synchronize
    work()
    finish()
    times = []
    for _ in range(repeats):
        start = clock()
        work()
        finish()
        times.append(1e3 * (clock() - start))
    return statistics.median(times)


def context_gb(device: str) -> float:
    """Memory of a GPU that this process holds outside torch's own, GB."""
    torch.zeros(1, device=device)
    free, total = torch.cuda.mem_get_info()
    return (total - free - torch.cuda.memory_reserved()) / 1e9


def fresh_memory(device: str) -> None:
    """Forgets what earlier rows took."""
    if device != "cpu":
        gc.collect()
        torch.cuda.empty_cache()
        torch.cuda.reset_peak_memory_stats()


def expected_gb(row: str) -> float:
    """What a job of this row is expected to need of a GPU."""
    if row not in ROWS:
        return network_gb(row, "thesis")
    keys, image_px, algorithm = ROWS[row]
    preset = THESIS_SAC if algorithm == "sac" else THESIS_PPO
    return policy_gb(image_px, sum(CHANNELS.get(key, 0) for key in keys), preset.batch_size)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--quick", action="store_true", help="two rows, one repeat")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    asked = parser.parse_args()
    torch.set_num_threads(1)
    device, repeats = asked.device, 1 if asked.quick else asked.repeats
    context = context_gb(device) if device != "cpu" else 0.0
    results: dict[str, dict[str, float]] = {}
    if context:
        results["context"] = {"gpu_gb": round(context, 2)}

    def with_memory(row: str) -> str:
        if device == "cpu":
            return ""
        taken = torch.cuda.max_memory_reserved() / 1e9 + context
        results[row] |= {"gpu_gb": round(taken, 2), "expected_gb": round(expected_gb(row), 2)}
        return f"  {taken:.2f} GB of the GPU ({results[row]['expected_gb']:.2f} expected)"

    print(f"{'row':26s} {'update, ms':>10s} {'s a decision':>13s}")
    for row in ("enn I", "enn V") if asked.quick else tuple(ROWS):
        fresh_memory(device)
        update, updates = update_of(row, device)
        update_ms = measured(update, repeats, device)
        results[row] = {"update_ms": round(update_ms, 2), "s_a_decision": round(update_ms * updates / 1e3, 6)}
        print(f"{row:26s} {update_ms:10.2f} {results[row]['s_a_decision']:13.6f}{with_memory(row)}", flush=True)
    print(f"\n{'network':26s} {'s an image':>10s}")
    for network in ("shape",) if asked.quick else NETWORKS:
        fresh_memory(device)
        if device == "cpu":
            seconds = network_s(network, repeats)
        else:
            seconds = network_on_gpu_s(network, repeats, device, mixed=True)
        results[network] = {"s_an_image": round(seconds, 6)}
        line = f"{network:26s} {seconds:10.5f}{with_memory(network)}"
        if device != "cpu":
            fresh_memory(device)
            results[network]["float32_s"] = round(network_on_gpu_s(network, repeats, device, mixed=False), 6)
            line += f", in float32 {results[network]['float32_s']:.5f} s"
        print(line, flush=True)
    print(json.dumps(results))


if __name__ == "__main__":
    main()
