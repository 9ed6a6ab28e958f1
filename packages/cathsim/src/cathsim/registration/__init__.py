"""Entry in Gymnasium's registry, made by `import cathsim` or `gymnasium.make("cathsim:cathsim/Navigate-v0")`."""

from __future__ import annotations

from typing import Any

import gymnasium

ENVIRONMENT = "cathsim/Navigate-v0"
DUAL = "cathsim/NavigateDual-v0"
MANY = "cathsim/NavigateMany-v0"
GOAL = "cathsim/NavigateGoal-v0"
COPIES = "cathsim/NavigateCopies-v0"
ARCH_VARIETY = "cathsim/ArchVariety-v0"
DUAL_DEVICE_NAV = "cathsim/DualDeviceNav-v0"
RANDOM_TREES = "cathsim/RandomTrees-v0"

_ENTRIES: dict[str, tuple[str, str | None, dict[str, Any]]] = {
    ENVIRONMENT: ("cathsim.environment:NavigateEnv", "cathsim.vector:ThreadedVectorEnv", {}),
    DUAL: ("cathsim.environment:NavigateEnv", "cathsim.vector:ThreadedVectorEnv", {"catheter": "vertebral"}),
    GOAL: ("cathsim.goals.environment:NavigateGoalEnv", "cathsim.goals.environment:ThreadedGoalVectorEnv", {}),
    MANY: ("cathsim.many_anatomies:NavigateManyEnv", "cathsim.vector:ThreadedManyVectorEnv", {}),
    ARCH_VARIETY: (
        "cathsim.arch_variety:ArchVarietyEnv",
        "cathsim.arch_variety:ThreadedArchVarietyVectorEnv",
        {},
    ),
    DUAL_DEVICE_NAV: (
        "cathsim.dual_device_nav:DualDeviceNavEnv",
        "cathsim.dual_device_nav:ThreadedDualDeviceNavVectorEnv",
        {},
    ),
    RANDOM_TREES: (
        "cathsim.dual_device_nav:RandomTreesEnv",
        "cathsim.dual_device_nav:ThreadedRandomTreesVectorEnv",
        {},
    ),
    COPIES: ("cathsim.rehearsal.environment:NavigateCopiesEnv", None, {}),
}


class _ThreadedArguments(dict[str, Any]):
    """Arguments of an entry whose vector steps threads.

    `gymnasium.make_vec` refuses `wrappers` and `vector_kwargs` there without saying what takes them; it asks the
    entry's arguments for both first.
    """

    def pop(self, key: str, *default: Any) -> Any:
        value = super().pop(key, *default)
        if key == "vectorization_mode":
            self._threads = value in (None, "vector_entry_point")
        if key in ("wrappers", "vector_kwargs") and value and getattr(self, "_threads", False):
            instead = "; autoreset_mode is an argument of make_vec itself" if key == "vector_kwargs" else ""
            raise ValueError(
                f"{key} need environments of their own: pass vectorization_mode='sync' or 'async' to make_vec{instead}"
            )
        return value


def register() -> None:
    """Registers the environments; safe to call again."""
    for name, (entry, vector, arguments) in _ENTRIES.items():
        if name not in gymnasium.registry:
            defaults = _ThreadedArguments(arguments) if vector else arguments
            gymnasium.register(name, entry_point=entry, vector_entry_point=vector, kwargs=defaults)
