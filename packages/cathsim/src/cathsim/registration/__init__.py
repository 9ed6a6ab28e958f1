"""Entry in Gymnasium's registry, made by `import cathsim` or `gymnasium.make("cathsim:cathsim/Navigate-v0")`."""

from __future__ import annotations

import gymnasium

ENVIRONMENT = "cathsim/Navigate-v0"
DUAL = "cathsim/NavigateDual-v0"
MANY = "cathsim/NavigateMany-v0"
GOAL = "cathsim/NavigateGoal-v0"
COPIES = "cathsim/NavigateCopies-v0"
ARCH_VARIETY = "cathsim/ArchVariety-v0"


def register() -> None:
    """Registers the environments; safe to call again."""
    if ENVIRONMENT not in gymnasium.registry:
        gymnasium.register(
            id=ENVIRONMENT,
            entry_point="cathsim.environment:NavigateEnv",
            vector_entry_point="cathsim.vector:ThreadedVectorEnv",
        )
    if DUAL not in gymnasium.registry:
        gymnasium.register(
            id=DUAL,
            entry_point="cathsim.environment:NavigateEnv",
            vector_entry_point="cathsim.vector:ThreadedVectorEnv",
            kwargs={"catheter": "vertebral"},
        )
    if GOAL not in gymnasium.registry:
        gymnasium.register(
            id=GOAL,
            entry_point="cathsim.goals.environment:NavigateGoalEnv",
            vector_entry_point="cathsim.goals.environment:ThreadedGoalVectorEnv",
        )
    if MANY not in gymnasium.registry:
        gymnasium.register(
            id=MANY,
            entry_point="cathsim.many_anatomies:NavigateManyEnv",
            vector_entry_point="cathsim.vector:ThreadedManyVectorEnv",
        )
    if ARCH_VARIETY not in gymnasium.registry:
        gymnasium.register(
            id=ARCH_VARIETY,
            entry_point="cathsim.arch_variety.environment:ArchVarietyEnv",
            vector_entry_point="cathsim.arch_variety.environment:ThreadedArchVarietyVectorEnv",
        )
    if COPIES not in gymnasium.registry:
        gymnasium.register(id=COPIES, entry_point="cathsim.rehearsal.environment:NavigateCopiesEnv")
