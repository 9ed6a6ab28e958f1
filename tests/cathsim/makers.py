"""Kinds of the fixtures that make environments and simulations with the fast preset."""

from collections.abc import Callable

from cathsim import NavigateEnv, Simulation

MakeEnv = Callable[..., NavigateEnv]
MakeSimulation = Callable[..., Simulation]
