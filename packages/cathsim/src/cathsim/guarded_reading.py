"""Guards for files from outside: regular files only, references within their own folder, readers in a child process.

It needs the standard library alone, and is the same file in every package that reads files; a test compares them.
"""

from __future__ import annotations

import contextlib
import faulthandler
import functools
import gc
import logging
import os
import pickle
import select
import signal
import stat
import struct
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path, PureWindowsPath
from typing import Any, BinaryIO, TypeVar

MEMORY = 4 << 30  # bytes that a reader may take
SECONDS = 60.0  # that a reader may take
_BLOCK = 1 << 20  # bytes read from a child at once
_NUMBER, _ALIGNED = 8, 64  # bytes of a size, and between the beginnings of arrays
_REFUSALS = (ValueError, FileNotFoundError, ImportError, MemoryError)  # that reach the caller as they are
_FORKS = sys.platform.startswith("linux")  # elsewhere a fork without exec is missing or unsafe
_BOOT = "import pickle, sys; sys.path[:] = pickle.load(sys.stdin.buffer); pickle.load(sys.stdin.buffer)()"

Result = TypeVar("Result")


class UnreadableFileError(ValueError):
    """A file that is not read; the message is one sentence that names it."""


def open_regular(path: Path, most_bytes: int | None = None) -> BinaryIO:
    """Opens a regular file for reading, without waiting for whatever else may stand there.

    Args:
        path: of a file, or of a link to one.
        most_bytes: a larger file is refused.

    Raises:
        UnreadableFileError: there is no such file, or it is no regular file, too large or not readable by this user.
    """
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    try:
        regular = stat.S_ISREG(os.stat(path).st_mode)  # before it is opened: opening a device may already act on it
        descriptor = os.open(path, flags) if regular else -1
    except FileNotFoundError as error:
        raise UnreadableFileError(f"there is no file {path}; check the path.") from error
    except (OSError, ValueError) as error:  # ValueError: a name that no file can have
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise UnreadableFileError(f"{Path(path).name} cannot be opened ({reason}); make it readable.") from error
    if not regular or not stat.S_ISREG(os.fstat(descriptor).st_mode):
        if regular:
            os.close(descriptor)
        raise UnreadableFileError(f"{Path(path).name} is no regular file; give a file that holds the data itself.")
    size = os.fstat(descriptor).st_size
    if most_bytes is not None and size > most_bytes:
        os.close(descriptor)
        raise UnreadableFileError(
            f"{Path(path).name} has {size / 1e9:.3g} GB, at most {most_bytes / 1e9:.3g} GB are read; make it smaller."
        )
    return os.fdopen(descriptor, "rb")


def check_regular(path: Path, most_bytes: int | None = None) -> int:
    """The size in bytes of a regular file; for readers that open a path themselves.

    Raises:
        UnreadableFileError: as `open_regular` does.
    """
    with open_regular(path, most_bytes) as file:
        return os.fstat(file.fileno()).st_size


def referenced_file(owner: Path, name: str, most_bytes: int | None = None) -> Path:
    """The regular file that another file refers to by a name within its own folder.

    Args:
        owner: the file that holds the reference.
        name: the reference as it stands in the file.
        most_bytes: a larger file is refused.

    Raises:
        UnreadableFileError: the name is absolute, has "..", or leads out of the folder by a link; or there is no
            regular file of at most so many bytes.
    """
    windows = PureWindowsPath(name)  # takes both separators
    folder = owner.parent.resolve()
    try:
        path = folder.joinpath(*windows.parts).resolve()
    except (OSError, ValueError, RuntimeError):  # no name of a file, or links in a circle
        path = folder
    if windows.anchor or ".." in windows.parts or path == folder or not path.is_relative_to(folder):
        raise UnreadableFileError(
            f"{owner.name} refers to {name[:80]!r}, which is no file of its own folder; put the file beside it and "
            "refer to it by its name alone."
        )
    check_regular(path, most_bytes)
    return path


def call_in_child(
    function: Callable[..., Result], *arguments: Any, subject: str, seconds: float = SECONDS, memory: int = MEMORY
) -> Result:
    """Calls a reader in a child process: a crash, a hang or a bomb in it becomes an error.

    On Linux the process is forked, which takes some milliseconds: what the reader imports is to be imported before the
    call. Elsewhere a new interpreter is started, which imports it again; memory is not limited where the system has no
    limit of address space (Windows, macOS). What the reader prints or logs is dropped.

    Args:
        function: at the top level of a module.
        arguments: of the function; like its result they are pickled.
        subject: what is read, as the subject of the error's sentence, such as a file's name.
        seconds: that the call may take.
        memory: bytes that the child may take beyond what this process has.

    Returns:
        What the function returned.

    Raises:
        UnreadableFileError: the function crashed, took more time or memory, or raised another error than the next.
        ValueError, FileNotFoundError, ImportError: the function raised it; unchanged.
    """
    answer = functools.partial(_answer, function, arguments, seconds, memory)
    try:
        content, status = _forked(answer, seconds) if _FORKS else _started(answer, seconds)
    except TimeoutError:
        raise UnreadableFileError(f"{subject} takes more than {seconds:g} s to read; make it smaller.") from None
    too_much = f"{subject} takes more than {memory / (1 << 30):.3g} GB of memory to read; make it smaller."
    try:
        succeeded, result = _unpacked(content)
    except MemoryError:
        raise UnreadableFileError(too_much) from None
    except Exception:  # cut off
        if status == -getattr(signal, "SIGKILL", 9):  # by the system, which has run out of memory
            raise UnreadableFileError(too_much) from None
        raise UnreadableFileError(
            f"{subject} cannot be read: its reader crashed ({_in_words(status)}); export it again."
        ) from None
    if succeeded:
        return result
    if isinstance(result, MemoryError):
        raise UnreadableFileError(too_much) from None
    if isinstance(result, str):
        raise UnreadableFileError(f"{subject} cannot be read ({result}); export it again.") from None
    raise result


def _in_words(status: int) -> str:
    try:
        return signal.Signals(-status).name
    except ValueError:
        return f"status {status}"


def _forked(answer: Callable[[int], None], seconds: float) -> tuple[bytearray, int]:
    """What a forked child writes, and its exit status, negative for a signal."""
    reading, writing = os.pipe()
    with contextlib.suppress(OSError, AttributeError, ImportError):
        import fcntl

        fcntl.fcntl(writing, fcntl.F_SETPIPE_SZ, _BLOCK)  # films pass in half the time
    with warnings.catch_warnings():
        # The child runs one reader and ends without clean-up: threads of this process do not matter to it.
        warnings.simplefilter("ignore")
        child = os.fork()
    if child == 0:
        failed = 1
        try:
            answer(writing)
            failed = 0
        finally:
            os._exit(failed)
    status = 0
    try:
        os.close(writing)
        content, end = bytearray(), time.monotonic() + seconds
        waiting = select.poll()
        waiting.register(reading, select.POLLIN)
        while waiting.poll(max(1e3 * (end - time.monotonic()), 0)):
            block = os.read(reading, _BLOCK)
            if not block:
                break
            content += block
        else:
            raise TimeoutError
    except BaseException:
        os.kill(child, signal.SIGKILL)
        raise
    finally:
        os.close(reading)
        with contextlib.suppress(ChildProcessError):  # where this process ignores its children's end
            status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    return content, status


def _started(answer: Callable[[int], None], seconds: float) -> tuple[bytearray, int]:
    """What a new interpreter writes, and its exit status."""
    request = pickle.dumps(sys.path) + pickle.dumps(functools.partial(answer, 1))
    try:
        done = subprocess.run(
            [sys.executable, "-I", "-c", _BOOT], input=request, capture_output=True, timeout=seconds, check=False
        )
    except subprocess.TimeoutExpired:
        raise TimeoutError from None
    return bytearray(done.stdout), done.returncode


def _answer(function: Callable, arguments: tuple, seconds: float, memory: int, descriptor: int) -> None:
    """Runs in the child: sets the limits, calls the function, and writes its result or error, pickled."""
    writing = os.dup(descriptor)
    _set_limits(seconds, memory)
    silent = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(silent, stream)
    sys.stdout = sys.stderr = os.fdopen(silent, "w", encoding="utf-8")
    logging.disable()
    with os.fdopen(writing, "wb") as pipe:
        try:
            parts = list(_packed((True, function(*arguments))))  # a result may fit where its pickle does not
        except BaseException as error:
            parts = list(_packed((False, _error_or_words(error))))
        for part in parts:
            pipe.write(part)


def _packed(answer: Any) -> Iterator[Any]:
    """An answer's pickle behind its arrays, which are written as they are in memory, and the sizes of all these."""
    arrays: list[pickle.PickleBuffer] = []
    pickled = pickle.dumps(answer, protocol=5, buffer_callback=arrays.append)
    parts = [*(array.raw() for array in arrays), memoryview(pickled)]
    for part in parts:
        yield part
        yield bytes(-part.nbytes % _ALIGNED)
    yield struct.pack(f"<{len(parts) + 1}Q", *(part.nbytes for part in parts), len(parts))


def _unpacked(content: bytearray) -> Any:
    """The answer of `_packed`; its arrays stay where they are in the content."""
    view, at, parts = memoryview(content), 0, []
    count = struct.unpack("<Q", view[-_NUMBER:])[0]
    for size in struct.unpack(f"<{count}Q", view[-_NUMBER * (count + 1) : -_NUMBER]):
        parts.append(view[at : at + size])
        at += size + -size % _ALIGNED
    return pickle.loads(parts[-1], buffers=parts[:-1])


def _error_or_words(error: BaseException) -> Exception | str:
    """A refusal itself; in words what a library raised, which callers do not expect."""
    with contextlib.suppress(Exception):
        if isinstance(error, _REFUSALS) and type(pickle.loads(pickle.dumps(error))) is type(error):
            return error
    return f"{type(error).__name__}: {error}".removesuffix(": ")


def _set_limits(seconds: float, memory: int) -> None:
    """Limits this process, ends it by itself where its parent is gone, and lets it leave what is the parent's."""
    gc.freeze()  # what the parent has left over is not cleaned up here
    faulthandler.disable()
    if sys.platform == "win32":
        return
    import resource

    signal.set_wakeup_fd(-1)
    for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGALRM):
        signal.signal(number, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends this process
    signal.alarm(int(seconds) + 2)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with contextlib.suppress(OSError, ValueError):
        Path("/proc/self/oom_score_adj").write_text(
            "1000", encoding="utf-8"
        )  # this process goes first where memory runs out
        pages = int(Path("/proc/self/statm").read_text(encoding="utf-8").split()[0])
        present = [limit for limit in resource.getrlimit(resource.RLIMIT_AS) if limit != resource.RLIM_INFINITY]
        most = min([pages * resource.getpagesize() + memory, *present])
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
