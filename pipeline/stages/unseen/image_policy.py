"""Image policies of the stage `unseen`: their perception, rounds of advised episodes, and tests.

A policy's folder, ``<row>/seed<k>/``, draws as::

    image_policy.pt  training.csv  training.json
    advised_episodes/                             until it is finished
    evaluation/<test set>/<target>/<mode>/<phantom>/NNN.mcap
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from enn.curves import Curves
from enn.imitation.advised_rounds import FinishedRound, forget_rounds, last_policy, teach
from pipeline.jobs.worker import Report
from pipeline.recording.trials import POLICY
from pipeline.seeds import unseen_episode_seeds
from pipeline.stages.unseen.settings import ONE_VIEW, UnseenSettings
from pipeline.stages.unseen.task import RESOLUTION, ROADMAP, XRAY, clutter_of, training_arch
from pipeline.stages.unseen.trials import PolicyJob, policy_folder, run_tests, taken_over
from pipeline.store.atomic_files import read_json, write_json, write_text
from pipeline.task import TASK

if TYPE_CHECKING:
    from cathsim.fluoroscopy import XRayScene
    from enn.imitation.advised_episodes import EpisodeStart
    from enn.imitation.images.lumen_segmentation import LumenSegmenter
    from enn.imitation.images.perception import ImagePerception
    from enn.imitation.images.wire_segmentation import WireSegmenter
    from enn.imitation.recurrent_policy import RecurrentPolicy
    from enn.imitation.sequence_cloning import AdvisedEpisode
    from enn.policy import Policy

IMAGE_POLICY, RECORD, CURVE = "image_policy.pt", "training.json", "training.csv"
CATHETER_MASK = "mask_catheter"  # its observation
PERCEPTION = 2  # rounds that take as long as fitting the networks of the perception
LUMEN_DEPTH = 1.5e-3  # m: a pixel shows the lumen where its ray passes through this much of it

Tell = Callable[[float, str], None]  # the share done, and a few words

_LOGGER = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class ImagePolicyJob(PolicyJob):
    """An image policy that learns from the advice of the roadmap policy; its row says what it sees."""

    settings: UnseenSettings
    start: Path | None = None  # file of a policy that is taken as it is; None: it is trained

    @property
    def xray(self) -> bool:
        """Whether it sees noisy X-ray images and a contrast run instead of images and the true mask."""
        return self.origin.row == XRAY

    @property
    def views(self) -> tuple[str, ...]:
        """Whose images it sees; the true mask is that of the frontal view."""
        return tuple(self.settings.views) if self.xray else ONE_VIEW

    @property
    def field(self) -> float | None:
        """Side of the field of its images, m; None: all of the anatomy."""
        return self.settings.field() if self.xray else None

    @property
    def projections(self) -> NDArray[np.float64] | None:
        """Of the views, where two of a fixed field show where things lie in space."""
        from cathsim.observations.framing import field_projections

        return None if self.field is None or len(self.views) != 2 else field_projections(self.views, self.field)

    def observations(self, *further: str) -> tuple[str, ...]:
        """What an environment is made with, beside what `seen` adds."""
        from enn.imitation.images.perception import IMAGE_KEYS

        return (*(("goal_image",) if self.xray else IMAGE_KEYS), *further)

    def seen(self, environment: Any, clutter: float = 0.0, background: XRayScene | None = None, **further: Any) -> Any:
        """The environment as the policy sees it: X-ray images with so much clutter, in water or an X-ray background."""
        from cathsim.observations.xray import XrayEnvironment

        if not self.xray:
            return environment
        return XrayEnvironment(
            environment, self.task.task.image_size_px, clutter=clutter_of(clutter), background=background,
            views=self.views, field=self.field, **further,
        )  # fmt: skip


def train_image_policy(job: ImagePolicyJob, report: Report) -> dict[str, Any]:
    """Trains the image policy round by round, or takes it over, and tests it: ``training_s`` and summaries."""
    from enn.imitation.images.policy import ImagePolicy

    record, file = job.own_folder / RECORD, job.own_folder / IMAGE_POLICY
    if job.start is not None:
        policy, perception = ImagePolicy.load(taken_over(job.start, file), report.device)
        spent = 0.0
    elif record.is_file():
        spent = float(read_json(record)["wall_s"])
        policy, perception = ImagePolicy.load(file, report.device)
    else:
        policy, perception, rounds = _train(job, report.part(0.0, 0.8, "training"), report.device)
        policy.save(file, **job.origin.configuration("training"), **{TASK: asdict(job.task.task)})
        spent = _write_record(job, rounds)
        forget_rounds(job.own_folder)
    seen = partial(job.seen, every=policy.settings.action_repeat)
    tested = run_tests(
        job,
        lambda mode: lambda seed: perception.controller(policy),
        job.observations(),
        report.part(0.8, 1.0, "tests"),
        seen,
    )
    return {"training_s": spent, "tests": tested}


def _train(
    job: ImagePolicyJob, report: Tell, device: str
) -> tuple[RecurrentPolicy, ImagePerception, list[FinishedRound]]:
    """Fits the perception, then plays and fits round by round, going on after the last finished one."""
    from cathsim.many_anatomies import SHELF
    from enn.imitation.advised_episodes import SIDE_BY_SIDE, play_advised
    from enn.imitation.images.perception import ImagePerception
    from enn.imitation.images.policy import ImagePolicy
    from enn.imitation.recurrent_policy import RecurrentPolicy, RecurrentPolicySettings
    from enn.imitation.sequence_cloning import SequenceCloningSettings
    from enn.policy import Policy

    began = time.monotonic()
    expert = Policy.load(policy_folder(job.folder, ROADMAP, job.seed) / POLICY, device)
    SHELF.capacity = max(SHELF.capacity, len(job.anatomies))  # all take turns
    last, rounds, count = last_policy(job.own_folder), job.settings.rounds, job.settings.advised_episodes
    seeing = PERCEPTION / (PERCEPTION + rounds)

    def perceive(share: float, text: str = "") -> None:
        report(seeing * share, text)

    def learn(share: float, text: str = "") -> None:
        report(seeing + (1.0 - seeing) * share, text)

    if last is not None:
        policy, perception = ImagePolicy.load(last, device)
    else:
        segmenter = _lumen_segmenter(job, perceive, device)
        devices = _device_segmenters(job, expert, perceive, device) if job.xray else {}
        perception = ImagePerception(
            segmenter, devices.get("mask"), device, subtracts=job.xray, cameras=job.views,
            catheter=devices.get(CATHETER_MASK), field=job.field, projections=job.projections,
        )  # fmt: skip
        hints = int(np.prod(expert.observation_space[expert.keys[0]].shape))  # type: ignore[index]
        actions = int(np.prod(expert.action_space.shape or ()))
        settings = RecurrentPolicySettings(
            features=perception.size, hints=hints, action_repeat=expert.action_repeat, actions=actions
        )
        policy = RecurrentPolicy(settings, job.seed, device, perception.content())
    observation = job.observations(*expert.keys)
    side_by_side = min(SIDE_BY_SIDE, count)
    envs = [
        job.seen(
            job.task.training_environment(job.anatomies, observation, observe_every=expert.action_repeat),
            job.settings.clutter * (place % 2), every=expert.action_repeat,
        )
        for place in range(side_by_side)
    ]  # fmt: skip

    def play(number: int, teacher_share: float, noise: float) -> list[AdvisedEpisode]:
        return play_advised(
            _starts(envs, perception, unseen_episode_seeds(job.seed, number, count)), expert, policy, perception,
            teacher_share=teacher_share, noise=noise, generator=np.random.default_rng((job.seed, number)),
            hint_key=expert.keys[0], side_by_side=side_by_side,
            tick=lambda done: learn((number + 0.5 * done / count) / rounds, f"round {number + 1}, episodes"),
        )  # fmt: skip

    fits = SequenceCloningSettings(epochs=job.settings.epochs)
    done = teach(job.own_folder, policy, [], play, fits, rounds=rounds, seed=job.seed, began=began, report=learn)
    for environment in envs:
        environment.close()
    return policy, perception, done


def _starts(envs: Sequence[Any], perception: ImagePerception, seeds: Sequence[int]) -> Iterator[EpisodeStart]:
    """Starts of episodes from seeds, each in the environment that became free first."""
    from enn.imitation.advised_episodes import EpisodeStart

    free = list(envs)
    for seed in seeds:
        environment = free.pop(0)
        yield EpisodeStart(environment, seed, perception.begin, partial(free.append, environment))


def _write_record(job: ImagePolicyJob, rounds: Sequence[FinishedRound]) -> float:
    """Writes the training log; returns the seconds that it took."""
    rows: list[dict[str, Any]] = []
    decisions = 0
    for number, one in enumerate(rounds):
        decisions += sum(len(episode.features) for episode in one.new)
        success = round(float(np.mean([episode.success for episode in one.new])), 4)
        row = {"round": number, "decisions": decisions, "wall_s": round(one.wall_s, 2), "success": success}
        rows.append({**row, "loss": round(one.loss, 5)})
    lines = [",".join(rows[0]), *(",".join(str(value) for value in row.values()) for row in rows)]
    write_text(job.own_folder / CURVE, "\n".join(lines) + "\n")
    spent = float(rows[-1]["wall_s"])
    write_json(job.own_folder / RECORD, {"wall_s": spent, "rounds": rows, "anatomies": len(job.anatomies)})
    return spent


def _lumen_segmenter(job: ImagePolicyJob, report: Tell, device: str) -> LumenSegmenter:
    """Trains the network that finds the lumen, on images of the training anatomies without a wire: those that are
    subtracted in contrast runs, or without noise.
    """
    from cathsim.fluoroscopy import background_image
    from cathsim.fluoroscopy.attenuation import lumen_path_length
    from cathsim.many_anatomies import SHELF
    from cathsim.observations.framing import framed
    from cathsim.observations.xray import contrast_run
    from enn.imitation.images.lumen_segmentation import fit_segmenter
    from enn.imitation.images.perception import subtracted

    task, epochs = job.task.task, job.settings.segmenter_epochs
    size_px, draw, generator = task.image_size_px, clutter_of(job.settings.clutter), np.random.default_rng(job.seed)
    images, lumens = [], []
    for number, seed in enumerate(job.anatomies):
        report(0.1 * number / len(job.anatomies), "images")
        phantom = SHELF.take(training_arch(seed, job.task.arches), RESOLUTION)
        for view in job.views:
            projector = framed(phantom, view, size_px, job.field)
            if job.xray:
                clutter = None if draw is None or number % 2 else draw(generator, size_px)
                run = contrast_run(phantom, size_px, task.guidewire().radius, clutter, view, job.field)
                images.append(subtracted(run.plain[0], run.contrast[0]))
            else:
                images.append(background_image(phantom.grid, projector, key=phantom.hash))
            lumens.append(lumen_path_length(phantom.grid, projector) > LUMEN_DEPTH)

    def tell(epoch: int, loss: float) -> None:
        curves.add(epoch, "lumen_segmenter", loss=loss)
        report(0.1 + 0.4 * epoch / epochs, "lumen segmenter")

    with Curves(job.own_folder) as curves:
        network, overlap = fit_segmenter(
            np.stack(images), np.stack(lumens).astype(np.float32), epochs=epochs, seed=job.seed, device=device,
            progress=tell,
        )  # fmt: skip
    _LOGGER.info("the lumen segmenter's overlap with its training lumens is %.3f", overlap)
    return network


def _device_segmenters(job: ImagePolicyJob, expert: Policy, report: Tell, device: str) -> dict[str, WireSegmenter]:
    """Trains the network that finds the devices, and one that finds a catheter alone, on an episode in each training
    anatomy; by the names of their masks.
    """
    from enn.imitation.images.wire_segmentation import BETWEEN, fit_wire_segmenter, wire_frames

    environment = job.task.training_environment(job.anatomies, job.observations(*expert.keys))
    count, targets = len(job.anatomies), len(job.task.targets)
    cases = [environment.case_of(place, place % targets) for place in range(count)]
    epochs = job.settings.wire_epochs
    names = ("mask",) if job.task.task.catheter is None else ("mask", CATHETER_MASK)
    images, plains, *masks = wire_frames(
        job.seen(environment, job.settings.clutter, with_mask=True, every=BETWEEN), expert, cases,
        np.random.default_rng((job.seed, count)),
        lambda done: report(0.5 + 0.2 * done / count, "X-ray images of wires"),
        ("image", "plain", *names),
    )  # fmt: skip
    environment.close()
    segmenters: dict[str, WireSegmenter] = {}

    def tell(epoch: int, loss: float) -> None:
        curves.add(epoch, f"segmenter_of_{names[len(segmenters)]}", loss=loss)
        report(0.7 + 0.3 * (len(segmenters) + epoch / epochs) / len(names), "wire segmenter")

    for name, mask in zip(names, masks, strict=True):
        with Curves(job.own_folder) as curves:
            segmenters[name], score = fit_wire_segmenter(
                images, plains, mask, epochs=epochs, seed=job.seed, device=device, progress=tell
            )
        _LOGGER.info("the Dice score of the segmenter of %s on its training images is %.3f", name, score)
    return segmenters
