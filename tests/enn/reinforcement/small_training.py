"""A training of the toy environment that takes about a second."""

from __future__ import annotations

import dataclasses

from enn.reinforcement.training import DESK_SAC

SMALL = dataclasses.replace(
    DESK_SAC,
    action_repeat=1,
    decisions=900,
    hidden=(32, 32),
    critic_layer_norm=False,
    final_learning_rate=1.0,
    batch_size=32,
    learning_starts=200,
    gradient_steps=0.5,
    evaluate_every=300,
    evaluation_episodes=5,
    curve_every=100,
    buffer_size=2000,
)
