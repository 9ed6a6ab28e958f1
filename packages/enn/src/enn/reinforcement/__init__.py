"""Reinforcement learning of policies: SAC and PPO from settings to the best policy."""
