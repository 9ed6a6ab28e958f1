"""Expert episodes: the logs with images that the enn stage leaves, read for what learns from them."""

from __future__ import annotations

import contextlib
import itertools
import logging
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.episodes import EpisodeReader
from pipeline.episodes.records import EpisodeReadError
from pipeline.recording.replay import ReplayError, recorded_catheter, recorded_devices, recorded_wire, replay
from pipeline.recording.trials import POLICY
from pipeline.stages.learning.task import LearningTask
from pipeline.store.errors import StageError
from pipeline.task import FEEDER, MOTION, NO_WIRE, TASK, TIP_MOTORS, Task, require_same_task, task_from

if TYPE_CHECKING:
    from cathsim import Catheter
    from enn.policy import Policy
    from enn.trajectory import Trajectory

EXPERT = "expert"  # of a training: the folder of its logs with images
CAMERA = "frontal"
_MM = 1e3

_LOGGER = logging.getLogger(__name__)


def read_episode(log: Path, *, pictures: bool = True) -> Trajectory:
    """Reads an episode as a learner sees it.

    Args:
        pictures: whether its images are wanted, which must have been logged then.

    Returns:
        Observations `joints`, `feeder` and `shape` as the environment gives them; with pictures also `image` and `mask`
        (T + 1, 1, H, W).

    Raises:
        EpisodeReadError: the log is damaged or unfinished.
        StageError: it holds no images.
        ValueError: it holds no step, or a value that is not finite.
    """
    from enn.trajectory import Trajectory

    with EpisodeReader(log) as reader:
        info, outcome = reader.info, reader.outcome
        if pictures and (CAMERA not in reader.cameras or not reader.has(CAMERA, "image")):
            raise StageError(f"{log} was logged without images: nothing can be learnt to see from it")
        arrays = reader.load_arrays(pictures=pictures)
        devices = recorded_devices(info)
    feeder = np.column_stack((arrays["insertion"], np.cos(arrays["rotation"]), np.sin(arrays["rotation"])))
    if info.has_catheter and devices["wire"] is not None:
        inserted, turned = arrays["devices/insertions"][:, 1], arrays["devices/hub_rotations"][:, 1]
        feeder = np.column_stack((feeder, inserted, np.cos(turned), np.sin(turned), arrays["devices/lead"]))
    joints = np.concatenate((arrays["joint_positions"], arrays["joint_velocities"]), axis=1)
    observations: dict[str, np.ndarray[Any, Any]] = {
        "joints": joints.astype(np.float32),
        "feeder": feeder.astype(np.float32),
        "shape": arrays["wire_points"].astype(np.float32),
    }
    if pictures:
        observations["image"] = arrays[f"image/{CAMERA}"][:, None]
        observations["mask"] = arrays[f"mask/{CAMERA}"][:, None] * np.uint8(255)
    return Trajectory(
        observations=observations,
        actions=arrays["action"][1:].astype(np.float32),
        rewards=arrays["reward"][1:],
        terminated=bool(outcome.success),
        forces=np.linalg.norm(arrays["resultant_force"][1:], axis=1),
        tips=arrays["tip"],
        metadata={
            "file": str(log),
            "phantom": info.phantom,
            "target": info.target,
            "seed": info.seed,
            "devices": devices,  # as arguments of an environment
        },
    )


def readable(logs: Iterable[Path], read: Callable[[Path], Trajectory]) -> Iterator[Trajectory]:
    """Reads logs; one that cannot be read is left out with a warning."""
    for log in logs:
        try:
            episode = read(log)
        except (EpisodeReadError, ReplayError, ValueError) as error:
            _LOGGER.warning("%s is left out: %s", log, error)
        else:
            yield episode


def read_episodes(logs: Sequence[Path], count: int | None = None) -> list[Trajectory]:
    """Reads so many episodes (None: all) with images that are to be learnt from together."""
    episodes = list(itertools.islice(readable(logs, read_episode), count))
    if not episodes:
        raise StageError(
            f"there is no expert episode to learn from{_of(logs)}: run stage=enn with stage.expert_episodes>0"
        )
    require_alike(episodes)
    if count is not None and len(episodes) < count:
        _LOGGER.warning("%d expert episodes were asked for, there are %d", count, len(episodes))
    return episodes


def _of(logs: Sequence[Path]) -> str:
    return f" of {len(logs)} in {logs[0].parent}" if logs else ""


def require_alike(episodes: Sequence[Trajectory]) -> None:
    """Refuses episodes of several wires, catheters or image sizes."""
    from enn.trajectory import require_same_shapes

    for episode in episodes:
        if episode.metadata["devices"] != episodes[0].metadata["devices"]:
            raise StageError(
                f"{episode.label} was recorded with another wire or catheter than {episodes[0].label}: keep episodes "
                "of one kind together"
            )
    try:
        require_same_shapes(episodes, ("image", "joints"))
    except ValueError as error:
        raise StageError(str(error)) from error


def expert_folder(enn: Path, task: str, row: str) -> Path:
    """The training of a task (``type_1/bca``) and row that is the expert: the first seed with episodes, or a policy."""
    folders = sorted((enn / task / row).glob("seed*"), key=lambda folder: int(folder.name.removeprefix("seed")))
    trained = [folder for folder in folders if (folder / POLICY).is_file()]
    recorded = [folder for folder in trained if any((folder / EXPERT).glob("*.mcap"))]
    for folder in (*recorded, *trained):
        return folder
    raise StageError(
        f"stage enn has trained no {row} for {task}: run stage=enn with this phantom and target, or choose others"
    )


def expert_logs(folder: Path) -> list[Path]:
    """Logs of the expert episodes of a training, in their order."""
    return sorted((folder / EXPERT).glob("*.mcap"))


def load_expert(folder: Path, device: str = "cpu") -> Policy:
    """The policy of a training of the stage enn; errors are those of `load_policy`."""
    return load_policy(folder / POLICY, "enn", device)


def load_policy(file: Path, maker: str, device: str = "cpu") -> Policy:
    """Reads the policy that stage `maker` trained onto a device."""
    from enn.policy import Policy

    try:
        return Policy.load(file, device)
    except ValueError as error:
        raise StageError(f"{error}; run stage={maker} again") from error


def require_expert(stage: str, task: LearningTask, folder: Path) -> None:
    """Refuses an expert that was trained for another task than a stage was asked for."""
    trained = task_from(load_expert(folder).metadata.get(TASK))
    if trained is not None:
        require_same_task(stage, task.task, trained, f"the expert policy of {task.name}", "enn")
    logs = expert_logs(folder) or sorted(folder.glob("evaluation/*/*.mcap"))
    require_same_task(
        stage, task.task, task_of_logs(logs, task.task).task, f"the expert's first episode of {task.name}", "enn"
    )


def require_demonstrations(stage: str, task: LearningTask, logs: Sequence[Path]) -> None:
    """Refuses episodes of the sampling expert with another wire or other actions than a stage learns with.

    Where they started and when they were cut off does not matter.
    """
    for log in logs:
        with contextlib.suppress(EpisodeReadError):
            log_task = task_of_log(log, task.task).task
            require_same_task(stage, task.task, log_task, f"the episode {log}", "expert", MOTION)


def task_of_logs(logs: Sequence[Path], like: Task | None = None) -> LearningTask:
    """The task that episodes were recorded in: that of the first one that can be read."""
    for log in logs:
        with contextlib.suppress(EpisodeReadError):
            return task_of_log(log, like)
    raise StageError(f"there is no episode that can be read{_of(logs)}: run stage=enn again")


def task_of_log(log: Path, like: Task | None = None) -> LearningTask:
    """The task of an episode; that of `like` may have a catheter of a file, which the log knows by its values alone."""
    from cathsim.anatomy.entry import TOWARDS
    from cathsim.guidewire import preset_of

    with EpisodeReader(log) as reader:
        info, wire, catheter = reader.info, recorded_wire(reader.info), recorded_catheter(reader.info)
        size = reader.camera(CAMERA).width if CAMERA in reader.cameras else 80
        actions = len(reader.step(0).action)
    recorded: dict[str, Any] = dict(info.configuration)
    preset = (NO_WIRE, 0.0) if wire is None else preset_of(wire)
    if preset is None:
        raise StageError(f"{log} was recorded with a wire that this version does not have: record it again")
    name = None if catheter is None else _catheter_name(catheter, like)
    if catheter is not None and name is None:
        raise StageError(
            f"{log} was recorded with a catheter that is no preset of this version, nor the one that was asked for: "
            "give task.catheter=… the file that it was recorded with, or record it again"
        )
    rule, usual = recorded.get("success", "straight"), Task().success_in(info.phantom)
    task = Task(
        wire=preset[0],
        wire_length_mm=_MM * preset[1],
        catheter=name,
        torsion=recorded.get("torsion", "elastic"),
        actions=FEEDER if actions == 2 or catheter is not None else TIP_MOTORS,
        pace=_pace_name(log, recorded),
        image_size_px=recorded.get("image_size", size),
        max_steps=recorded["max_steps"],
        success_radius_mm=_MM * recorded["success_radius"],
        success=None if rule == usual else rule,
        start_jitter_mm=_MM * recorded["start_jitter"],
        start_rotation_deg=math.degrees(recorded["start_rotation"]),
        entry=info.entry.partition(TOWARDS)[0],
    )
    return LearningTask(info.phantom, info.target, task)


def _pace_name(log: Path, recorded: Mapping[str, Any]) -> str:
    """The name of the pace that an episode was recorded at."""
    from cathsim.presets import PACES, Pace

    own = Pace(**recorded.get("pace", {}))
    for name, pace in PACES.items():
        if pace == own:
            return name
    raise StageError(f"{log} was recorded at a pace that has no name: record it again at one of {', '.join(PACES)}")


def _catheter_name(catheter: Catheter, like: Task | None) -> str | None:
    """The preset that a catheter is, or the file of a task that names the same one."""
    from cathsim.devices.shelf import catheter_preset_of

    if like is not None and like.guiding_catheter() == catheter:
        return like.catheter
    return catheter_preset_of(catheter)


def repeat(logs: Sequence[Path], task: LearningTask, observation: tuple[str, ...] = ()) -> list[Trajectory]:
    """Repeats an expert's episodes; one that cannot be used is left out with a warning, those of tip motors, too."""
    if task.task.actions != FEEDER:
        return []

    def again(log: Path) -> Trajectory:
        with EpisodeReader(log) as reader:
            if recorded_devices(reader.info) != task.task.devices():
                raise ReplayError(f"it was recorded with another wire or catheter than {task.task.device_names}")
        return replay(
            log,
            observation,
            image_size=task.task.image_size_px,
            reward=task.reward,
            force_penalty=task.force_penalty,
            path_penalty=task.path_penalty,
        )

    return list(readable(logs, again))
