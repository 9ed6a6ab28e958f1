"""One procedure: an episode of the environment that starts when the operator first touches the controls."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cathsim.console.controls import Move
from cathsim.console.operator_setup import ForceLimit, ForceWatch
from cathsim.console.recorder import Recorder
from cathsim.console.xray.room import XRayStep
from cathsim.devices.pair import wire_and_catheter
from cathsim.environment import NavigateEnv
from cathsim.metrics import EpisodeMetrics
from cathsim.simulation import CONTROL_STEP

READY, RUNNING, ENDED = "ready", "running", "ended"

_CONTINUOUS = XRayStep()  # the beam stays on, and nothing is injected

_LOGGER = logging.getLogger(__name__)


@dataclass(frozen=True)
class TwoDevices:
    """What is shown of a wire in a catheter besides the rod that both are."""

    catheter_insertion: float  # m
    catheter_rotation: float  # of its hub, rad
    lead: float  # how far the wire's tip is ahead of the catheter's, m; negative: withdrawn into it
    feeder_forces: tuple[float, float]  # of the wire's feeder and of the catheter's, N; positive inserts


@dataclass(frozen=True)
class Sample:
    """The state after a control step, as it is shown."""

    # ends of the links from the tip to the proximal end, m, world frame: of the wire, or of the rod that wire and
    # catheter are. Shape (links + 1, 3).
    points: np.ndarray
    force: float  # largest resultant contact force of the step, N
    force_max: float  # largest so far, N
    warnings: int  # how often the force has risen to the limit so far
    insertion: float  # m
    rotation: float  # rad
    distance: float  # from the tip to the target, m
    devices: TwoDevices | None = None  # None: a bare wire


class Procedure:
    """Steps the environment, keeps what is needed to show the episode again, and hands every step to a recorder.

    Args:
        environment: with contact info; the procedure resets it.
        recorder: keeps the episode, or None.
        force_limit: of the warnings, or at which the procedure ends.

    Attributes:
        samples: one a control step, from the reset on.
        stopped: whether it ended at the force limit.
        trouble: why recording stopped, one sentence; "" while all is well.
    """

    def __init__(
        self,
        environment: NavigateEnv,
        recorder: Recorder | None,
        *,
        seed: int,
        force_limit: ForceLimit | None = None,
    ) -> None:
        self.environment, self._recorder = environment, recorder
        self._watch = ForceWatch(force_limit or ForceLimit())
        self.state = READY
        self.success = self.invalid = self.stopped = False
        self.trouble = ""
        self.path: Path | None = None
        self._tips: list[np.ndarray] = []
        self._forces: list[float] = []
        self._rewards: list[float] = []
        self._ending: Mapping[str, Any] = {}
        _, info = environment.reset(seed=seed)
        self.samples: list[Sample] = []
        self._tips.append(info["tip"])
        self._sample(info)
        limit = {"force_limit": self._watch.limit.force, "ends_at_force_limit": self._watch.limit.ends}
        begun = {**info, **_operation(XRayStep(on=False), warned=False), **limit}
        self._record(lambda keeper: keeper.start(environment, begun, seed=seed))

    def _sample(self, info: Mapping[str, Any]) -> None:
        self.samples.append(
            Sample(
                points=self.environment.simulation.wire_points(),
                force=info["force"],
                force_max=max([info["force"], *(sample.force_max for sample in self.samples[-1:])]),
                warnings=self._watch.warnings,
                insertion=info["insertion"],
                rotation=info["rotation"],
                distance=info["distance"],
                devices=_two_devices(info) if self.devices == 2 else None,
            )
        )

    @property
    def devices(self) -> int:
        """How many devices are steered: 1, the wire; or 2, the wire and the catheter."""
        return self.environment.feeders.devices

    def _record(self, act: Any) -> Any:
        """Lets the recorder act; one that fails is given up, and the procedure goes on without it."""
        if self._recorder is None:
            return None
        try:
            return act(self._recorder)
        except Exception as error:  # a recorder of another distribution may raise anything
            self.trouble = f"this episode is not recorded: {error}"
            _LOGGER.warning("%s", self.trouble)
            self._recorder = None
            return None

    @property
    def steps(self) -> int:
        """Control steps made."""
        return len(self.samples) - 1

    @property
    def time(self) -> float:
        """Simulated time since the start, s."""
        return self.steps * CONTROL_STEP

    @property
    def warnings(self) -> int:
        """How often the contact force has risen to the limit."""
        return self._watch.warnings

    def step(self, advance: float, rotate: float, catheter: Move = (0.0, 0.0), *, xray: XRayStep = _CONTINUOUS) -> None:
        """One control step of 0.1 s, by shares (-1 to 1) of the full speeds; the first one starts the procedure.

        Args:
            advance: translation of the wire.
            rotate: its rotation.
            catheter: translation and rotation of the catheter, where there is one.
            xray: what the X-ray side does in the step, for the recorder alone.

        Raises:
            RuntimeError: the procedure has ended.
        """
        if self.state == ENDED:
            raise RuntimeError("the procedure has ended: start another one")
        self.state = RUNNING
        action = np.array([advance, rotate, *(catheter if self.devices == 2 else ())], np.float32)
        _, reward, terminated, truncated, info = self.environment.step(action)
        warned = self._watch.see(info["force"])
        self.stopped = self._watch.ends and not (terminated or truncated)
        truncated = truncated or self.stopped
        self._tips.append(info["tip"])
        self._forces.append(info["force"])
        self._rewards.append(reward)
        self._ending = info
        self._sample(info)
        made = {**info, **_operation(xray, warned=warned)}
        self._record(
            lambda keeper: keeper.step(
                self.environment, action, reward, made, terminated=terminated, truncated=truncated
            )
        )
        if terminated or truncated:
            self.success, self.invalid = bool(info["success"]), bool(info["invalid"])
            self._end(None if self.invalid else self.metrics())

    def metrics(self) -> EpisodeMetrics:
        """Metrics of the steps so far.

        Raises:
            ValueError: there was no step.
        """
        return EpisodeMetrics.from_arrays(
            np.array(self._tips),
            np.array(self._forces),
            np.array(self._rewards),
            self.success,
            target=self.environment.task.target_name,
            ending=self._ending,
        )

    def break_off(self) -> None:
        """Ends the procedure where it stands, as an interrupted one; does nothing when it has ended."""
        if self.state != ENDED:
            self._end(None)

    def _end(self, metrics: EpisodeMetrics | None) -> None:
        self.state = ENDED
        self.path = self._record(lambda keeper: keeper.finish(metrics))

    def answer(self, answers: Mapping[str, Any]) -> Path | None:
        """Keeps a questionnaire of `check_answers` with the recorded episode; None when nothing was recorded."""
        if self.path is None:
            return None
        episode = self.path
        return self._record(lambda keeper: keeper.answer(episode, answers))


def _operation(xray: XRayStep, *, warned: bool) -> dict[str, Any]:
    """What a recorder learns of a step besides the environment's info."""
    return {"xray_on": xray.on, "injections": xray.injections, "force_warning": warned}


def _two_devices(info: Mapping[str, Any]) -> TwoDevices:
    wire, catheter = info["feeder_forces"].tolist()
    return TwoDevices(info["catheter_insertion"], info["catheter_rotation"], info["lead"], (wire, catheter))


def between(earlier: Sample, later: Sample, share: float) -> np.ndarray:
    """The wire (links + 1, 3) m between two samples (share 0 to 1): a control step is shown in several pictures."""
    if share >= 1.0:
        return later.points
    return earlier.points + share * (later.points - earlier.points)


def devices_between(
    earlier: Sample, later: Sample, share: float, links: Sequence[float]
) -> tuple[np.ndarray, np.ndarray | None]:
    """Wire (n, 3) and catheter (k, 3) m between two samples, each from its tip on; None: there is no catheter.

    Args:
        links: of the rod that both are, from the proximal end, m.
    """
    points = between(earlier, later, share)
    if earlier.devices is None or later.devices is None:
        return points, None
    lead = earlier.devices.lead + share * (later.devices.lead - earlier.devices.lead)
    return wire_and_catheter(points, links, lead)
