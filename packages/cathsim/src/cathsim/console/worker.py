"""The real-time loop: a thread that steps the simulation ten times a second and shows it thirty times a second.

A control step is computed when it begins and shown in three pictures until the next one begins, so the first picture
already shows what the controls do. The log has one record a control step, as every other episode.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, Protocol

from cathsim.anatomy import PHANTOMS, load_phantom
from cathsim.console.controls import ControlPanel, Controls
from cathsim.console.expert import ExpertScores
from cathsim.console.operator_setup import Choices, Chosen, Setup
from cathsim.console.procedure import ENDED, READY, RUNNING, Procedure, Sample, devices_between
from cathsim.console.questionnaire import CRITERIA, check_answers
from cathsim.console.recorder import Recorder
from cathsim.console.web.messages import Inbox, frame_message, read_request, surface_of
from cathsim.console.xray.monitor import CArm
from cathsim.console.xray.room import Views, XRayRoom
from cathsim.environment import NavigateEnv
from cathsim.simulation import CONTROL_STEP

PICTURES = 3  # a control step
FRAME = CONTROL_STEP / PICTURES  # s
REPLAY = "replay"
_SECONDS_TO_NEXT_START = 1.0
_BEHIND = 0.15  # s: a loop that is further behind than this does not hurry to catch up
_MM = 1e3

_LOGGER = logging.getLogger(__name__)


class Page(Protocol):
    """Takes what the operator is to see; called from the loop's thread, and must not wait."""

    def show(self, frame: bytes) -> None:
        """A new picture; it replaces one that has not been sent yet."""

    def say(self, message: dict[str, Any] | bytes) -> None:
        """A message that must arrive."""


class RealTimeLoop(threading.Thread):
    """Runs procedures for one operator.

    Args:
        recorder: keeps the episodes, or None.
        note: what the page says about recording.
        compared: the page is told the sampling expert's score for each procedure's task.

    Raises:
        ValueError: the phantom, target, wire, catheter or accuracy is unknown.
    """

    def __init__(
        self,
        setup: Setup,
        page: Page,
        recorder: Recorder | None = None,
        *,
        note: str = "",
        compared: bool = False,
    ) -> None:
        super().__init__(name="console", daemon=True)
        self._setup, self._page, self._recorder, self._note = setup, page, recorder, note
        self._choices = Choices(setup, PHANTOMS)
        self.panel = ControlPanel()
        self._inbox = Inbox()
        self._stopped = threading.Event()
        self._seed = setup.seed
        self._frame = 0
        self._room = XRayRoom()
        self._views = Views(self._room, self._inbox.put, self._send_views)
        self._expert = ExpertScores(self._compare, self._follow) if compared else None
        self._shown: tuple[Procedure, float] | None = None  # the replayed one and its time, s
        self._finished: Procedure | None = None
        self._sequence = 0
        phantom = load_phantom(setup.phantom)
        environment = setup.environment(phantom, setup.target, setup.catheter)
        self._catheter = self._choices.first_catheter
        self._surface = surface_of(phantom)
        self._open(environment)

    # -- requests, from other threads ---------------------------------------------------------------------------------

    def request(self, message: str | Mapping[str, Any]) -> None:
        """Takes a request of the page, as `read_request` does.

        Raises:
            ValueError: its values are impossible.
        """
        request = read_request(message)
        kind = request["type"]
        if kind == "controls":
            catheter = request.get("catheter", (0.0, 0.0))
            if any(catheter) and self._catheter is None:
                raise ValueError("there is no catheter to steer: choose one first")
            self.panel.set(Controls(request["advance"], request["rotate"], request["sequence"], *catheter))
            self._inbox.put("touch")  # the first one starts the clock at once
        elif kind == "release":
            self.panel.release()
        elif kind == "choose":
            choice = self._choices.read(request, self._setup, self._catheter)
            self._inbox.put(kind, lambda: self._choose(choice))
        elif kind == "view":
            view = CArm(request["primary_deg"], request["secondary_deg"], request["zoom"])
            self._inbox.put(f"view {request['camera']}", lambda: self._views.turn(request["camera"], view))
        elif kind == "pedal":
            self._room.beam = request["on"]
        elif kind == "roadmap":
            self._room.roadmap = request["on"]
        elif kind == "inject":
            self._inbox.put(kind, self._room.inject)
        elif kind == "answers":
            answers = check_answers(request["answers"])
            self._inbox.put(kind, lambda: self._answer(answers))
        elif kind == "restart":
            self._inbox.put(kind, self._restart)
        else:
            self._inbox.put(kind, self._replay)

    def operator_came(self) -> None:
        """A page has opened: everything is sent to it."""
        self._inbox.put("came", self._introduce)

    def operator_left(self) -> None:
        """The page is gone: the controls are released, and what was going on is broken off."""
        self.panel.release()
        self._inbox.put("left", self._restart_if_running)

    def stop(self) -> None:
        """Ends the loop; an episode that is going on is kept as an interrupted one."""
        self._stopped.set()
        self._inbox.put("stop")
        if self.is_alive():
            self.join(timeout=10.0)
        self._views.close()
        if self._expert is not None:
            self._expert.close()

    # -- the loop's own thread ----------------------------------------------------------------------------------------

    def run(self) -> None:
        """Shows a picture every 33 ms until it is stopped."""
        due = time.monotonic()
        while not self._stopped.is_set():
            try:
                started = self._serve(due)
                now = time.monotonic()
                due = now if started or now - due > _BEHIND else due
                self._next_picture()
            except Exception:  # one that ended the thread would leave a page that never moves again
                _LOGGER.exception("a picture failed")
                self._start_again()
            due += FRAME
        self._procedure.break_off()

    def _start_again(self) -> None:
        """After a failure; where that fails, too, it is tried again a second later."""
        try:
            self._say(type="notice", kind="error", text="the simulation failed: it starts again")
            self._restart()
        except Exception:
            _LOGGER.exception("a new start failed")
            self._stopped.wait(_SECONDS_TO_NEXT_START)

    def _serve(self, due: float) -> bool:
        """Waits until a time, serving requests; returns early, and true, when the operator starts a procedure."""
        while not self._stopped.is_set():
            item = self._inbox.get(due - time.monotonic())
            if item is None:
                return False
            kind, work = item
            if work is None:
                if self._procedure.state == READY and self._shown is None and self.panel.touched:
                    return True
                continue
            try:
                work()
            except ValueError as error:
                self._say(type="notice", kind="error", text=str(error))
            except Exception as error:  # what a wish runs into must not end the loop
                _LOGGER.exception("the request '%s' failed", kind)
                self._say(type="notice", kind="error", text=f"'{kind}' failed ({type(error).__name__}: {error})")
        return False

    def _open(self, environment: NavigateEnv) -> None:
        self._environment = environment
        self._views.open(environment.simulation)
        self._begin()

    def _begin(self) -> None:
        self._procedure = Procedure(
            self._environment, self._recorder, seed=self._seed, force_limit=self._setup.force_limit
        )
        self._seed += 1
        self._frame, self._shown = 0, None
        self._views.restart()
        self._room.restart()

    def _send_views(self) -> None:
        self._say(type="views", views=self._views.marks(self._environment.task))

    def _expert_task(self) -> dict[str, Any]:
        environment = self._environment
        catheter = self._catheter.source if self._catheter else None
        return self._setup.task(environment.phantom.name, environment.task.target_name, catheter)

    def _compare(self, task: dict[str, Any], score: dict[str, Any] | None) -> None:
        """Tells the page the expert's score of the procedure that is shown; called from another thread.

        Args:
            score: None where none could be computed.
        """
        if task == self._expert_task():
            self._say(type="expert", score=score)

    def _follow(self, task: dict[str, Any], progress: dict[str, Any]) -> None:
        """Tells the page how far the expert is; called from another thread."""
        if task == self._expert_task():
            self._say(type="expert_progress", **progress)

    def _say(self, **message: Any) -> None:
        self._page.say(message)

    def _introduce(self) -> None:
        self._page.say(self._surface)
        self._send_task()

    def _send_task(self) -> None:
        environment, task = self._environment, self._environment.task
        low, high = environment.phantom.bounds
        self._say(
            type="task",
            phantom=environment.phantom.name,
            target=task.target_name,
            targets=list(environment.phantom.targets),
            **self._choices.to_page(self._setup, self._catheter),
            devices=environment.feeders.devices,
            replayable=self._finished is not None,
            goal=task.goal(environment.phantom).tolist(),
            success_radius=task.success_radius,
            control_step=CONTROL_STEP,
            views=self._views.marks(task),
            beam=self._room.beam,
            roadmap=self._room.roadmap,
            size=self._views.size,
            bounds=[low.tolist(), high.tolist()],
            recording=self._note if self._recorder else "",
            criteria=[asdict(criterion) for criterion in CRITERIA],
        )

    def _choose(self, choice: Chosen) -> None:
        setup, phantom, target, catheter = choice
        self._say(type="loading", phantom=phantom)
        try:
            loaded = load_phantom(phantom)
            if target not in loaded.targets:
                target = next(iter(loaded.targets))
            environment = setup.environment(loaded, target, catheter.source if catheter else None)
        except ValueError:
            self._send_task()  # the page shows again what there is
            raise
        another = loaded is not self._environment.phantom
        self._setup, self._catheter, self._finished = setup, catheter, None
        self.panel.release()
        self._procedure.break_off()
        self._open(environment)
        if another:
            self._surface = surface_of(loaded)
            self._page.say(self._surface)
        self._send_task()

    def _restart(self) -> None:
        self.panel.release()
        self._procedure.break_off()
        self._begin()
        self._say(type="restarted")

    def _restart_if_running(self) -> None:
        if self._procedure.state == RUNNING:
            self._restart()

    def _replay(self) -> None:
        if self._finished is None or self._procedure.state == RUNNING:
            raise ValueError("finish a procedure first, then it can be replayed")
        self._shown = (self._finished, 0.0)

    def _answer(self, answers: dict[str, Any]) -> None:
        finished = self._finished
        if finished is None:
            raise ValueError("the questionnaire belongs to a finished procedure")
        path = finished.answer(answers)
        if path is None:
            raise ValueError(finished.trouble or "answers are not kept: this console records nothing")
        self._say(type="saved", path=str(path))

    # -- pictures -----------------------------------------------------------------------------------------------------

    def _next_picture(self) -> None:
        if self._shown is not None:
            self._show_replay(*self._shown)
            return
        procedure = self._procedure
        starts = self._frame % PICTURES == 0
        if starts and procedure.state != ENDED and (procedure.state == RUNNING or self.panel.touched):
            controls = self.panel.take()
            self._sequence = controls.sequence
            if procedure.state == READY and self._expert is not None:
                self._expert.ask(self._expert_task())
            procedure.step(*controls.wire, controls.catheter, xray=self._room.step())
        samples = procedure.samples
        if procedure.state == READY:
            self._room.wait()
            self._show(READY, samples[0], samples[0], 1.0, 0)
            return
        self._show(procedure.state, samples[-2], samples[-1], (self._frame % PICTURES + 1) / PICTURES, procedure.steps)
        if procedure.state == ENDED and self._frame % PICTURES == 0:
            self._send_end()
            self._frame = PICTURES - 1  # from here on the last state stands still
        elif procedure.state == RUNNING:
            self._frame += 1

    def _show_replay(self, procedure: Procedure, at: float) -> None:
        index = min(int(at / CONTROL_STEP + 1e-9), procedure.steps - 1)
        share = at / CONTROL_STEP - index
        samples = procedure.samples
        self._show(REPLAY, samples[index], samples[index + 1], share, index + 1)
        done = at >= procedure.time
        self._shown = None if done else (procedure, min(at + FRAME, procedure.time))
        if done:
            self._say(type="replayed")

    def _show(self, state: str, earlier: Sample, later: Sample, share: float, step: int) -> None:
        wire, catheter = devices_between(earlier, later, share, self._environment.simulation.wire.links)
        room = self._room
        room.advance(FRAME)
        held = not (room.beam or state == REPLAY)
        pictures = self._views.pictures((id(earlier), id(later), share), wire, catheter, held=held)
        header: dict[str, Any] = {
            "state": state,
            "step": step,
            "time_s": max(step - 1 + share, 0.0) * CONTROL_STEP,
            "force_n": later.force,
            "force_max_n": later.force_max,
            "force_warnings": later.warnings,
            "insertion_mm": later.insertion * _MM,
            "rotation_rad": later.rotation,
            "distance_mm": later.distance * _MM,
            "sequence": self._sequence,
            "beam": room.beam,
            "dose_s": room.dose,
            "contrast": room.contrast,
            "roadmap": room.roadmap,
            "injections": room.injections,
        }
        if later.devices is not None:
            header |= {
                "catheter_insertion_mm": later.devices.catheter_insertion * _MM,
                "catheter_rotation_rad": later.devices.catheter_rotation,
                "lead_mm": later.devices.lead * _MM,
                "feeder_forces_n": later.devices.feeder_forces,
            }
        self._page.show(frame_message(header, wire, *pictures, catheter=catheter))

    def _send_end(self) -> None:
        procedure = self._finished = self._procedure
        metrics = None if procedure.invalid else asdict(procedure.metrics())
        self._say(
            type="ended",
            success=procedure.success,
            invalid=procedure.invalid,
            stopped=procedure.stopped,
            force_warnings=procedure.warnings,
            time_s=procedure.time,
            metrics=metrics,
            recorded=str(procedure.path) if procedure.path else "",
            trouble=procedure.trouble,
            dose_s=self._room.dose,
            injections=self._room.injections,
            expert=self._expert.score(self._expert_task()) if self._expert else None,
            compared=self._expert is not None,
        )
