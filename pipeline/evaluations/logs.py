"""Evaluations: what the logs of learning stages say, with the metrics of their arrays.

A log counts by its metadata: `stage`, `row`, `mode` ("deterministic" or "stochastic"), `training_seed` and `variant` of
its configuration, beside task and wire. Two kinds of episodes stand beside them for comparison: the sampling expert's
(`expert`, row "sampling_expert") and people's (`human`, row "H"). Logs below a learning stage's `expert/` folders, and
the sampling expert's outside its `evaluation/` folders, are demonstrations: they belong to no row, but the shortest
path of a task may be one of theirs.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.evaluations.forces import device_of, wall_forces
from pipeline.store.interruption import stop_if_interrupted
from pipeline.store.provenance import hash_value

if TYPE_CHECKING:
    from cathsim.metrics import EpisodeMetrics
    from pipeline.episodes import EpisodeInfo


LEARNING_STAGES = ("baselines", "enn", "imitation", "unseen")
COMPARED = {"expert": ("sampling_expert", "sampling_expert"), "human": ("human", "H")}  # folder -> operator, row
COUNTED = "counted.json"  # of the stage user_study: people's logs that count, relative to the run
MODES = DETERMINISTIC, STOCHASTIC = "deterministic", "stochastic"
DEMONSTRATION = "demonstration"  # mode of what belongs to no row
# Overrides of a sweep that choose which cells a job fills, and change none of them.
_CHOOSING = {"seed", "target", "modality", "phantom.name", "phantom.seed", "phantom.file",
             "stage.phantoms", "stage.targets", "stage.modalities", "stage.seeds", "task.catheter",
             "stage.task.catheter"}  # fmt: skip

Task = tuple[str, str, str, str, float, float, float]


@dataclass(frozen=True)
class Evaluation:
    """One logged episode."""

    log: str  # path of the log, relative to the run
    stage: str  # that recorded it, without its sweep job
    row: str  # what steered: a set of modalities, an algorithm with its observation, ...
    variant: str  # of the training, with whatever else a sweep changed; rows of different variants are never pooled
    mode: str  # "deterministic", "stochastic" or "demonstration"
    training_seed: int
    seed: int
    phantom: str  # its name; with six digits of its hash where other anatomies of the run share the name
    phantom_hash: str
    target: str
    test_set: str  # which anatomies it stands for; the phantom where the log names none
    entry: str  # access site of the wire
    start_jitter: float  # m, by which starts differ
    start_rotation: float  # rad, by which they are turned either way
    success_radius: float  # m
    max_steps: int  # after which the episode was truncated
    force_weight: float | None  # of the force in the policy's reward, 1/N; None where the log says nothing of it
    wire: str
    started_ns: int  # since the epoch
    contact_force: float | None  # mean magnitude of a single contact's force, N; None without contacts in the log
    device: str  # "wire", or the catheter over it
    # magnitude of what each feeder pushes with, wire and catheter: means over the steps, then largest, N; None of the
    # wire alone
    feeder_forces: list[list[float]] | None
    # mean (N) and mean square (N^2) over the steps of the quantities of `load_cell`; None where the log does not hold
    # them
    wall_forces: dict[str, list[float]] | None
    metrics: EpisodeMetrics  # from the arrays, with the thesis's reward

    @property
    def folder(self) -> str:
        """Name of the stage folder that holds the log, e.g. `enn@seed=1`."""
        return self.log.split("/", 1)[0]

    @property
    def task(self) -> Task:
        """What episodes share that have one shortest path: phantom, target, devices, and how they start and end."""
        start = self.start_jitter, self.start_rotation
        return self.phantom, self.target, self.entry, self.wire, *start, self.success_radius


class UnusableLogError(ValueError):
    """A log is intact, but no evaluation; the message says why."""


def stage_of(folder: str) -> str:
    """The stage of a folder's name: `enn` of `enn@seed=1`."""
    return folder.split("@", 1)[0]


def evaluation_folders(run_path: Path) -> list[Path]:
    """Lists the folders of a run that hold episodes of policies, of the sampling expert or of people, sorted."""
    known = {*LEARNING_STAGES, *COMPARED}
    return sorted(folder for folder in run_path.glob("*") if folder.is_dir() and stage_of(folder.name) in known)


def changed_settings(folder: str) -> str:
    """Names what a sweep job changed beyond choosing cells: `stage.decisions=5` of `enn@seed=1,stage.decisions=5`."""
    overrides = folder.partition("@")[2].split(",")
    return ", ".join(override for override in overrides if override and override.partition("=")[0] not in _CHOOSING)


def read_evaluation(path: Path, run_path: Path) -> Evaluation:
    """Reads one log, below the folder of its run, and computes its metrics."""
    from cathsim.metrics import EpisodeMetrics
    from cathsim.navigation import SUCCESS_REWARD
    from pipeline.episodes import EpisodeReader

    with EpisodeReader(path) as log:
        info, outcome = log.info, log.outcome
        arrays = log.load_arrays(pictures=False)
    if outcome.status != "finished" or outcome.missing_steps:
        raise UnusableLogError("its episode was broken off")
    if "extra/distance_m" not in arrays:
        raise UnusableLogError("it holds no distances to the target")
    distances = arrays["extra/distance_m"]
    success = bool(arrays["terminated"][-1])
    radius = float(info.configuration.get("success_radius", 0.0))
    if not (success or arrays["truncated"][-1]):
        raise UnusableLogError("its last step does not end the episode")
    if outcome.success is not None and outcome.success != success:
        raise UnusableLogError(f"its outcome says success={outcome.success}, its last step {success}")
    if success and radius and distances[-1] > radius:
        raise UnusableLogError(
            f"it claims success {1e3 * distances[-1]:.1f} mm from the target, the radius is {1e3 * radius:g} mm"
        )
    rewards = -distances[1:]
    if success:
        rewards[-1] = SUCCESS_REWARD
    contacts = np.linalg.norm(arrays["contact_forces"][1:].reshape(-1, 3), axis=1)
    contacts = contacts[np.isfinite(contacts)]  # the arrays are padded with NaN
    try:
        metrics = EpisodeMetrics.from_arrays(
            arrays["tip"],
            arrays["resultant_force"][1:],
            rewards,
            success,
            target=info.target,
            ending=outcome.metrics,
        )
    except ValueError as error:
        raise UnusableLogError(str(error)) from error
    relative = path.relative_to(run_path)
    forces = wall_forces(arrays, interval=info.control_dt, seed=info.seed)
    return Evaluation(
        log=relative.as_posix(),
        **_origin(info, relative),
        seed=info.seed,
        phantom=info.phantom,
        phantom_hash=info.phantom_hash,
        target=info.target,
        test_set=str(info.configuration.get("test_set", info.phantom)),
        entry=info.entry,
        start_jitter=float(info.configuration.get("start_jitter", 0.0)),
        start_rotation=float(info.configuration.get("start_rotation", 0.0)),
        success_radius=radius,
        max_steps=int(info.configuration.get("max_steps", 0)),
        wire=hash_value(_devices(info))[:12],
        started_ns=info.start_time_ns,
        contact_force=float(contacts.mean()) if len(contacts) else None,
        device=device_of(info.configuration),
        feeder_forces=_feeder_forces(arrays),
        wall_forces=forces.moments() if forces is not None else None,
        metrics=metrics,
    )


def _devices(info: EpisodeInfo) -> Any:
    """What tells one wire, catheter and torsion from others."""
    wire = info.configuration.get("wire")
    if not info.has_catheter:
        return wire
    return [wire, info.configuration["catheter"], info.configuration.get("torsion")]


def _feeder_forces(arrays: dict[str, Any]) -> list[list[float]] | None:
    if "devices/feeder_forces" not in arrays:
        return None
    pushed = np.abs(arrays["devices/feeder_forces"][1:])
    return [pushed.mean(axis=0).tolist(), pushed.max(axis=0).tolist()]


def _origin(info: EpisodeInfo, relative: Path) -> dict[str, Any]:
    """Stage, row, variant, mode, training seed and force weight of a log."""
    folder, known = relative.parts[0], info.configuration
    stage = stage_of(folder)
    if stage in COMPARED:
        operator, row = COMPARED[stage]
        if info.operator != operator:
            raise UnusableLogError(f"it is an episode of {info.operator!r}, expected {operator!r}")
        is_demonstration = stage == "expert" and "evaluation" not in relative.parts[1:-1]
        mode = DEMONSTRATION if is_demonstration else DETERMINISTIC
        variant = changed_settings(folder)
        return {"stage": stage, "row": row, "variant": variant, "mode": mode, "training_seed": 0, "force_weight": None}
    is_demonstration = "expert" in relative.parts[1:-1]
    missing = [key for key in ("row", "mode", "training_seed") if key not in known]
    if missing and not is_demonstration:
        raise UnusableLogError(f"its metadata lacks {', '.join(missing)}, so it is no evaluation")
    mode = DEMONSTRATION if is_demonstration else str(known["mode"])
    if mode not in (*MODES, DEMONSTRATION):
        raise UnusableLogError(f"its mode is {mode!r}, expected {' or '.join(MODES)}")
    weight = known.get("force_weight")
    return {
        "stage": str(known.get("stage", stage)),
        "row": str(known.get("row", "")).replace("/", "·"),  # a slash would group the table's rows
        "variant": ", ".join(filter(None, (str(known.get("variant", "")), changed_settings(folder)))),
        "mode": mode,
        "training_seed": int(known.get("training_seed", 0)),
        "force_weight": None if weight is None else float(weight),
    }


_LOGGER = logging.getLogger(__name__)


@dataclass
class EvaluationSet:
    """The evaluations of a run."""

    # one for each log that counts, in the order of their paths
    evaluations: list[Evaluation] = field(default_factory=list)
    left_out: dict[str, str] = field(default_factory=dict)  # log -> why it does not count


def read_logs(folders: Sequence[Path]) -> EvaluationSet:
    """Reads every log below stage folders of one run; one that cannot be used is left out with a warning.

    Returns:
        The evaluations. Of logs of the same episode of the same policy the latest counts.
    """
    from pipeline.episodes import EpisodeReadError

    evaluation_set = EvaluationSet()
    if not folders:
        return evaluation_set
    run_path = folders[0].parent
    paths = [path for folder in folders for path in sorted(folder.rglob("*.mcap"))]
    evaluations = []
    for path in paths:
        result = _read_one(path, run_path)
        stop_if_interrupted()
        if isinstance(result, Evaluation):
            evaluations.append(result)
            continue
        evaluation_set.left_out[path.relative_to(run_path).as_posix()] = str(result)
        words = str(result) if isinstance(result, EpisodeReadError) else f"{path}: {result}"
        _LOGGER.warning("left out: %s", words)
    evaluation_set.evaluations = _latest(_named_apart(evaluations), evaluation_set.left_out)
    return evaluation_set


def _read_one(path: Path, run_path: Path) -> Evaluation | ValueError:
    from pipeline.episodes import EpisodeReadError

    try:
        return read_evaluation(path, run_path)
    except (EpisodeReadError, UnusableLogError) as error:
        return error
    except (AttributeError, IndexError, KeyError, OverflowError, TypeError, ValueError) as error:
        # checksums are right, so another program wrote what no version of this one would
        return UnusableLogError(f"what it says cannot be used ({type(error).__name__}: {error})")


def _named_apart(evaluations: list[Evaluation]) -> list[Evaluation]:
    """Gives anatomies that share a name, as files of several patients may, names of their own."""
    of_name: dict[str, set[str]] = {}
    for one in evaluations:
        of_name.setdefault(one.phantom, set()).add(one.phantom_hash)
    named = []
    for one in evaluations:
        if len(of_name[one.phantom]) > 1:
            name = f"{one.phantom} {one.phantom_hash[:6]}"
            one = replace(one, phantom=name, test_set=name if one.test_set == one.phantom else one.test_set)
        named.append(one)
    return named


def _latest(evaluations: list[Evaluation], left_out: dict[str, str]) -> list[Evaluation]:
    """Leaves out earlier logs of the same episode, which would count it twice."""
    latest: dict[tuple[object, ...], Evaluation] = {}
    for one in evaluations:
        if one.mode == DEMONSTRATION or one.stage in COMPARED:
            key: tuple[object, ...] = (one.log,)
        else:
            key = (one.stage, one.row, one.variant, one.mode, one.training_seed, one.seed, one.task, one.test_set,
                   one.force_weight, one.wire, one.max_steps)  # fmt: skip
        other = latest.get(key)
        if other is not None:
            earlier, later = sorted((one, other), key=lambda evaluation: (evaluation.started_ns, evaluation.log))
            left_out[earlier.log] = f"the same episode was recorded again in {later.log}"
            one = later
        latest[key] = one
    return sorted(latest.values(), key=lambda evaluation: evaluation.log)
