"""Errors a user can act on: each is shown as one sentence, without a traceback."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


class PipelineError(Exception):
    """Anything that stops a stage and that the user can mend."""


class ConfigurationError(PipelineError):
    """A setting that cannot be used."""


class StageError(PipelineError):
    """A stage that cannot run as things are: its input is missing, or its package is."""


class FolderBusyError(PipelineError):
    """Another process is working in the same run folder."""


@contextmanager
def stopping_the_stage(*kinds: type[Exception]) -> Iterator[None]:
    """Lets what a package refuses with a sentence for the user stop the stage with that sentence.

    Args:
        kinds: of errors whose message is such a sentence: a damaged checkpoint, and what to remove.
    """
    try:
        yield
    except kinds as error:
        raise StageError(str(error)) from error
