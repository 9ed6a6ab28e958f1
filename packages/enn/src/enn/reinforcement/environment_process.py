"""The process that steps the environments of a training: it imports neither torch nor stable-baselines3, 3 CPU-s."""

from __future__ import annotations

import pickle
import signal
import time
from multiprocessing.connection import Connection
from typing import Any

from enn.reinforcement.resources import trim_heap
from enn.reinforcement.sampling import Sampling

_TRIM_EVERY = 200  # requests between two returns of free memory to the system


def serve(number: int) -> None:
    """Steps environments for another process until it closes the connection.

    Args:
        number: of the connection's open file.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # whoever asks is told to stop, and closes the connection
    connection, steps = Connection(number), 0
    envs: Sampling | None = None
    try:
        while True:
            request = connection.recv()
            error = result = None
            try:
                if envs is None:
                    envs = Sampling(request[0].fn, **request[1])
                else:
                    name, arguments, named = request
                    result = getattr(envs, name)(*arguments, **named)
                    steps += 1
            except Exception as raised:
                error = raised
            connection.send_bytes(_packed(error, result))
            if steps == _TRIM_EVERY:
                trim_heap()
                steps = 0
    except (EOFError, OSError):
        pass  # the other one has closed it, or has ended
    finally:
        if envs is not None:
            envs.close()


def _packed(error: Exception | None, result: Any) -> bytes:
    try:
        return pickle.dumps((error, result, time.process_time()))
    except Exception as failure:
        return pickle.dumps((RuntimeError(f"{type(error or failure).__name__}: {error or failure}"), None, 0.0))
