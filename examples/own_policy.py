"""A policy of your own, scored beside others: success with its 95 % interval, path, force.

python examples/own_policy.py
"""

from __future__ import annotations

import numpy as np

from cathsim import NavigateEnv
from cathsim.metrics import EpisodeMetrics, Summary, summarise
from cathsim.metrics.episodes import wilson_interval


class TurnWhenStuck:
    """Feeds the wire; a second after its tip came nearer, draws it back by 20 mm and turns it at random."""

    def __init__(self, seed: int) -> None:
        self.generator = np.random.default_rng(seed)
        self.best, self.waited, self.retreat, self.turn = np.inf, 0, 0, 0.0

    def __call__(self, info: dict) -> np.ndarray:
        self.waited = 0 if info["distance"] < self.best - 1e-3 else self.waited + 1
        self.best = min(self.best, info["distance"])
        if self.waited > 10:
            self.retreat, self.waited, self.best = 10, 0, np.inf
            self.turn = self.generator.uniform(-1, 1)
        self.retreat -= 1
        return np.array([-1.0, self.turn] if self.retreat >= 0 else [1.0, 0.0])


def main(episodes: int = 10, steps: int = 300) -> Summary:
    """Run episodes from different starts; give their mean metrics."""
    env = NavigateEnv("type_1", "bca", observation="tip", max_steps=steps, start_rotation=np.pi)
    results = []
    for seed in range(episodes):
        policy, (_, info), ended = TurnWhenStuck(seed), env.reset(seed=seed), False
        tips, forces, rewards = [info["tip"]], [], []
        while not ended:
            _, reward, terminated, truncated, info = env.step(policy(info))
            tips.append(info["tip"])
            forces.append(info["force"])
            rewards.append(reward)
            ended = terminated or truncated
        arrays = np.array(tips), np.array(forces), np.array(rewards)
        results.append(EpisodeMetrics.from_arrays(*arrays, terminated, ending=info))
        print(f"start {seed}: {'reached' if terminated else 'missed'} after {0.1 * len(forces):.1f} s")
    low, high = wilson_interval(sum(one.success for one in results), episodes)
    found = summarise(results)
    print(f"target reached in {found.success_pct.mean:.0f} % (95 % interval {100 * low:.0f} to {100 * high:.0f})")
    print(f"way of the tip {found.path_length_cm.mean:.0f} cm, contact force {found.force_n.mean:.3f} N on average")
    return found


if __name__ == "__main__":
    main()
