"""Errors a user can act on: each is shown as one sentence, without a traceback."""

from __future__ import annotations


class PipelineError(Exception):
    """Anything that stops a stage and that the user can mend."""


class ConfigurationError(PipelineError):
    """A setting that cannot be used."""


class StageError(PipelineError):
    """A stage that cannot run as things are: its input is missing, or its package is."""


class FolderBusyError(PipelineError):
    """Another process is working in the same run folder."""
