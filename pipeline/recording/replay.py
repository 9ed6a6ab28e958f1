"""Replay: a log's actions once more in the simulator, which gives back every state and any observation of its moments.

A log keeps what happened, not what a learner wants to see: its episode is repeated from its seed and its actions. The
simulator is deterministic, so the tip must go through the very same positions, bit for bit.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import ValidationError

from pipeline.episodes import EpisodeReader, EpisodeReadError
from pipeline.recording.record import ANATOMY
from pipeline.settings.kinds import sentence, shown
from pipeline.store.atomic_files import atomic_path
from pipeline.store.errors import StageError

if TYPE_CHECKING:
    from cathsim import Guidewire, NavigateEnv, Phantom
    from cathsim.devices.catheter import Catheter
    from cathsim.viewing.film import Film
    from enn.trajectory import Trajectory
    from pipeline.episodes import EpisodeInfo

_MM = 1e3


class ReplayError(StageError):
    """An episode that the simulator does not repeat."""


def replay(
    log: Path | str,
    observation: Sequence[str] = (),
    *,
    image_size: int | None = None,
    reward: str | None = None,
    force_penalty: float | None = None,
    path_penalty: float | None = None,
    film: Film | None = None,
) -> Trajectory:
    """Repeats a logged episode.

    Args:
        log: of an episode that a feeder or tip motors steered.
        image_size: of images among them, px; None: as the log's camera has it, or 80.
        reward: of the steps, "distance" or "geodesic"; None: as it was recorded, also where it was a function.
        force_penalty: of the reward; None: as it was recorded.
        film: gets every moment.

    Returns:
        The episode, with a state at every moment that an episode can start from.
    """
    from enn.trajectory import Trajectory

    with EpisodeReader(log) as reader:
        info, outcome = reader.info, reader.outcome
        arrays = reader.load_arrays(pictures=False)
        size = image_size or (reader.camera(reader.cameras[0]).width if reader.cameras else 80)
    if outcome.missing_steps:
        raise ReplayError(f"{log} lacks step {outcome.missing_steps[0]} and cannot be repeated: leave it out")
    actions = arrays["action"][1:].astype(np.float32)
    changed = {"reward": reward, "force_penalty": force_penalty, "path_penalty": path_penalty}
    env = _environment(info, actions.shape[1], observation, size, changed)
    if env.phantom.hash != info.phantom_hash:
        raise ReplayError(
            f"{log} was recorded in {info.phantom} ({info.phantom_hash[:8]}), the simulator has {env.phantom.name} "
            f"({env.phantom.hash[:8]}): record it again"
        )
    if actions.shape[1:] != env.action_space.shape or not np.isfinite(actions).all():
        raise ReplayError(
            f"{log} holds actions of shape {actions.shape[1:]}, the environment takes finite ones of "
            f"{env.action_space.shape}: record it again"
        )
    tips, forces = arrays["tip"], arrays["resultant_force_norm"][1:]
    seen, moment = env.reset(seed=info.seed)
    _compare(log, 0, tips[0], moment["tip"])
    observations, states, rewards = [seen], [env.start_state()], []
    terminated = False
    if film is not None:
        film.add(env)
    for step, action in enumerate(actions):
        seen, earned, terminated, _, moment = env.step(action)
        _compare(log, step + 1, tips[step + 1], moment["tip"])
        observations.append(seen)
        states.append(env.start_state())
        rewards.append(earned)
        if film is not None:
            film.add(env)
    return Trajectory(
        observations={
            name: np.stack([one[name] for one in observations]) for name in observations[0] if name in observation
        },
        actions=actions,
        rewards=arrays["reward"][1:] if reward is None and _has_own_reward(info) else np.array(rewards),
        terminated=bool(terminated),
        forces=forces,
        tips=tips,
        simulation_states=np.stack(states),
        metadata={
            "file": str(log),
            "phantom": info.phantom,
            "target": info.target,
            "seed": info.seed,
            "operator": info.operator,
        },
    )


def film_of(log: Path, destination: Path) -> Path:
    """Repeats a logged episode and films it into a GIF, which appears under its name only when it is whole.

    Raises:
        ReplayError: the episode does not repeat, or the destination's name is no GIF's.
    """
    from cathsim.viewing.film import Film

    if destination.suffix.lower() != ".gif":
        raise ReplayError(f"{destination} is no name of a GIF: let it end in .gif")
    film = Film()
    try:
        replay(log, film=film)
        with atomic_path(destination) as temporary:
            film.write(temporary)
    finally:
        film.close()
    return destination


def _environment(
    info: EpisodeInfo, actions: int, observation: Sequence[str], image_size: int, changed: Mapping[str, Any]
) -> NavigateEnv:
    """The environment that an episode was recorded in, with another observation and reward."""
    from cathsim import NavigateEnv, NavigationTask
    from cathsim.presets import Accuracy, Pace

    fields = {field.name for field in dataclasses.fields(NavigationTask)}
    with checked_values(info, "task"):
        recorded = {name: value for name, value in info.configuration.items() if name in fields}
        if _has_own_reward(info):
            recorded.pop("reward")
        task = NavigationTask(**{**recorded, **{name: value for name, value in changed.items() if value is not None}})
    with checked_values(info, "time stepping"):
        accuracy = Accuracy(**info.configuration["numerics"])
    with checked_values(info, "pace"):
        pace = Pace(**info.configuration.get("pace", {}))
    with checked_values(info, "phantom, entry or camera"):
        return NavigateEnv(
            recorded_phantom(info),
            task=task,
            entry=info.entry,
            **recorded_devices(info),
            accuracy=accuracy,
            pace=pace,
            actions="feeder" if actions == 2 or info.has_catheter else "tip_motors",
            observation=tuple(observation) or ("tip",),
            image_size=image_size,
        )


def recorded_phantom(info: EpisodeInfo) -> Phantom:
    """The anatomy that an episode was recorded in; an EpisodeReadError where its file is gone or has changed."""
    from cathsim import load_phantom
    from cathsim.anatomy.library import phantom_from_spec

    description = info.configuration.get(ANATOMY)
    if description is None:
        return load_phantom(info.phantom)
    try:
        return dataclasses.replace(phantom_from_spec(description), name=info.phantom)
    except ValueError as error:
        raise EpisodeReadError(f"the log of seed {info.seed} was recorded in the anatomy of a file: {error}") from error


def _has_own_reward(info: EpisodeInfo) -> bool:
    """Whether the reward was not one of `NavigationTask`, so that only the log has its values."""
    from cathsim.navigation import OWN

    return str(info.configuration.get("reward")).startswith(OWN)


@contextlib.contextmanager
def checked_values(info: EpisodeInfo, what: str) -> Iterator[None]:
    """Refuses values of a log that cannot be used, e.g. because another version wrote them."""
    try:
        yield
    except (AttributeError, IndexError, KeyError, OverflowError, TypeError, ValueError) as error:
        if isinstance(error, EpisodeReadError):
            raise
        reason = sentence(error) if isinstance(error, ValidationError) else f"{type(error).__name__}: {error}"
        raise EpisodeReadError(
            f"the log of seed {info.seed} in {shown(info.phantom)} says a {what} that cannot be used "
            f"({shown(reason)}): record it again"
        ) from error


def recorded_devices(info: EpisodeInfo) -> dict[str, Any]:
    """Wire, and where there was one, catheter and torsion, as arguments of `NavigateEnv`."""
    devices: dict[str, Any] = {"wire": recorded_wire(info)}
    if info.has_catheter:
        devices |= {"catheter": recorded_catheter(info), "torsion": info.configuration.get("torsion", "elastic")}
    return devices


def recorded_wire(info: EpisodeInfo) -> Guidewire | None:
    """The guidewire that an episode was recorded with; None: with a catheter alone."""
    from cathsim import Guidewire

    with checked_values(info, "wire"):
        values = info.configuration["wire"]
        if values is None and info.has_catheter:
            return None
        fields: dict[str, Any] = {
            name: tuple(value) if isinstance(value, list) else value for name, value in values.items()
        }
        return Guidewire(**fields)


def recorded_catheter(info: EpisodeInfo) -> Catheter | None:
    """The catheter that an episode was recorded with; None: there was none."""
    from cathsim.devices.catheter import Catheter

    if not info.has_catheter:
        return None
    with checked_values(info, "catheter"):
        return Catheter(**info.configuration["catheter"])


def _compare(log: Path | str, step: int, recorded: np.ndarray, now: np.ndarray) -> None:
    if not np.array_equal(recorded, now):
        away = _MM * float(np.linalg.norm(recorded - now))
        raise ReplayError(
            f"{log} does not repeat: at step {step} the tip is {away:.2g} mm from where it was; it was recorded by "
            "another version or with other settings, so record it again"
        )
