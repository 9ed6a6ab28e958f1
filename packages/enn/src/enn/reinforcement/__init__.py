"""Reinforcement learning: SAC and PPO from settings to the best policy."""
