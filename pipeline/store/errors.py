"""Errors a user can act on, the operating system's among them: each is one sentence without a traceback."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from contextlib import contextmanager


class PipelineError(Exception):
    """Anything that stops a stage and that the user can mend.

    Whatever refuses a setting or a file raises one of these; docstrings name them only where callers catch them.
    """


class ConfigurationError(PipelineError):
    """A setting that cannot be used."""


class StageError(PipelineError):
    """A stage that cannot run as things are: its input is missing, or its package is."""


@contextmanager
def stopping_the_stage(*kinds: type[Exception]) -> Iterator[None]:
    """Lets errors of a package, whose message is a sentence for the user, stop the stage with that sentence."""
    try:
        yield
    except kinds as error:
        raise StageError(str(error)) from error


# No space, quota used up, file larger than the process may write: for the user all three mean "no room".
_NO_ROOM = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
_LONGEST_PATH = 200  # characters of a path that are shown
_PERMISSION = "change its permissions, or choose another folder by runs_dir=PATH"
_WRONG_KIND = "a file lies where a folder is needed, or a folder where a file is: move it away"
_ADVICE = {
    **dict.fromkeys((errno.EACCES, errno.EPERM, errno.EROFS), _PERMISSION),
    **dict.fromkeys((errno.ENOTDIR, errno.EISDIR, errno.EEXIST), _WRONG_KIND),
    errno.ENOENT: "it is missing: check the path, or run the stage that writes it again",
    errno.ENAMETOOLONG: "choose a shorter name or runs_dir",
    errno.ELOOP: "its symbolic links lead in a circle: mend them",
    errno.EMFILE: "raise the limit of open files (ulimit -n), or run fewer jobs beside each other",
    errno.ENFILE: "close other programs, or run fewer jobs beside each other",
}


def system_error(error: BaseException | None) -> OSError | None:
    """The exception itself or the first of its causes that is the operating system's; None without one."""
    while error is not None and not (isinstance(error, OSError) and type(error).__module__ != "hydra.errors"):
        error = error.__cause__  # Hydra has OSErrors of its own, for what it misses
    return error


def is_no_room(error: BaseException | None) -> bool:
    """Whether an error, or what caused it, is a full disk, a used-up quota or a file size limit."""
    while error is not None:
        if isinstance(error, OSError) and error.errno in _NO_ROOM:
            return True
        error = error.__cause__ or error.__context__
    return False


def system_sentence(error: OSError) -> str:
    """Words what the system refused, the path cut to a readable length; what a library says of itself stays."""
    place = str(error.filename or "")
    place = f" {place[:_LONGEST_PATH]}{'…' if len(place) > _LONGEST_PATH else ''}" if place else ""
    if is_no_room(error):
        where = f" while writing{place}" if place else ""
        return f"no room left{where}: free some space and run the same command again; finished items are kept"
    if error.errno is None:
        return str(error).strip().partition("\n")[0]
    advice = _ADVICE.get(error.errno, "mend that and run the same command again")
    return f"the system refused{place} ({(error.strerror or 'unknown reason').lower()}): {advice}"
