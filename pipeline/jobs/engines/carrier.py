"""The process beside a job on another machine: it starts the job, passes on what it reports, and ends it in time.

``python -m pipeline.jobs.engines.carrier FD``: the order comes over the connection FD, and the end of that connection
means that whoever started the carrier is gone. The job's own process is a fork of this small one, and does what it does
on one machine: see `pipeline.jobs.worker`.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import sys
import time
import traceback
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

from pipeline.jobs.engines.interface import ENDED, LOST, STARTED
from pipeline.jobs.engines.local import how_it_ended
from pipeline.jobs.engines.sending import Order
from pipeline.jobs.engines.shared_files import ENDED_FILE, Lease, MessageWriter
from pipeline.jobs.gpus import VISIBLE
from pipeline.jobs.worker import Message, work

_SECONDS_BETWEEN_LOOKS = 1.0
_SECONDS_BETWEEN_PROGRESS = 2.0
_STOPPED = (signal.SIGINT, signal.SIGTERM, signal.SIGUSR2)  # of people and of batch systems


class Carrier:
    """One job under way on this machine."""

    def __init__(self, order: Order, starter: Connection | None) -> None:
        """Args:
        starter: its end means that the one who started this process is gone; None: nobody watches.
        """
        self._order, self._starter = order, starter
        self._lease = Lease(order.attempt, order.token, order.lease_s)
        self._writer = MessageWriter(order.attempt)
        self._stopped_from_outside = self._stop_sent = False
        self._progress: Message | None = None
        self._looked = self._progressed = float("-inf")

    def carry(self) -> None:
        """Runs the job to its end."""
        self._write(Message(STARTED))  # before the look: a new driver waits for every attempt that has started
        lost = self._lease.lost()
        if lost is None:
            for number in _STOPPED:  # the job's process does as they say, and this one waits for it
                signal.signal(number, self._note_stop)
            lost = self._run()
        if lost is not None:
            self._write(Message(LOST, lost))
        (self._order.attempt / ENDED_FILE).touch()

    def _run(self) -> str | None:
        """Starts the job and listens; why it was lost, None: it has ended by itself."""
        context = multiprocessing.get_context("fork")
        ours, theirs = context.Pipe()
        gpus = tuple(filter(None, os.environ.get(VISIBLE, "0").split(","))) if self._order.gpu else ()
        process = context.Process(target=_work, args=(theirs, ours, self._starter, self._order.notes, gpus))
        process.start()
        theirs.close()
        with contextlib.suppress(OSError):  # it has ended already
            ours.send_bytes(self._order.job)
        watched = [ours, *([self._starter] if self._starter is not None else [])]
        answered = ended = False
        try:
            while not ended:
                ready = wait(watched, _SECONDS_BETWEEN_LOOKS)
                if self._starter is not None and self._starter in ready:
                    return "what started it is gone"
                if (lost := self._look(ours)) is not None:
                    return lost
                try:
                    while ours in ready and ours.poll():
                        message: Message = ours.recv()
                        answered = answered or message.kind in ("done", "failed")
                        self._pass_on(message)
                except (EOFError, OSError):
                    ended = True
        finally:
            if not ended:
                process.kill()
            process.join()
        if self._stopped_from_outside and not answered and not self._lease.asked_to_stop():
            return "it was stopped on its machine"
        self._write(Message(ENDED, how_it_ended(process.exitcode)))
        return None

    def _look(self, job: Connection) -> str | None:
        """Now and then: passes on progress and a wish to stop; why the job must end at once, None: it need not."""
        now = time.monotonic()
        if self._progress is not None and now - self._progressed >= _SECONDS_BETWEEN_PROGRESS:
            self._progressed = now
            self._write(self._progress)
            self._progress = None
        if now - self._looked < _SECONDS_BETWEEN_LOOKS:
            return None
        self._looked = now
        if not self._stop_sent and self._lease.asked_to_stop():
            self._stop_sent = True
            with contextlib.suppress(OSError):
                job.send("stop")
        return self._lease.lost()

    def _pass_on(self, message: Message) -> None:
        if message.kind == "progress":
            self._progress = message  # the latest, at the next look
        else:
            self._write(message)

    def _write(self, message: Message) -> None:
        self._writer.write(message)

    def _note_stop(self, number: int, frame: Any) -> None:
        self._stopped_from_outside = True


def _work(
    connection: Connection, others: Connection, starter: Connection | None, notes: tuple[Path, Path],
    gpus: tuple[str, ...],
) -> None:  # fmt: skip
    """The job's process: takes the job over the connection and does it.

    Args:
        others: end of the carrier, which must not stay open here, or its end would not end the connection.
        starter: the same holds for it.
    """
    others.close()
    if starter is not None:
        starter.close()
    try:
        run, given = connection.recv()
    except (EOFError, OSError):
        return
    except Exception as error:  # a module that this machine cannot import
        connection.send(Message("failed", f"{type(error).__name__}: {error}", traceback=traceback.format_exc()))
        return
    work(run, given, connection, notes, gpus)


def main(descriptor: int) -> None:
    """Takes the order and carries it out."""
    starter = Connection(descriptor)
    Carrier(starter.recv(), starter).carry()


if __name__ == "__main__":
    main(int(sys.argv[1]))
