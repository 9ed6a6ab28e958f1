"""Fixtures for the pipeline's tests: what the processes of jobs start with."""

from collections.abc import Iterator
from multiprocessing import forkserver

import pytest
from hydra._internal.hydra import Hydra
from hydra.core.config_store import ConfigStore

from pipeline.jobs.worker import PHANTOM

# What jobs need beside the pipeline, of all stages; importing it takes a job longer than most tests do.
OF_ANY_JOB = (
    *PHANTOM, "cathsim.rehearsal.environment", "cathsim.statics", "enn.imitation.distillation",
    "enn.imitation.recurrent_policy", "enn.reinforcement.rehearsal", "enn.reinforcement.training.training",
    "guide3d.learning.evaluation", "guide3d.train", "pipeline.recording.record", "pipeline.stages.imitation",
    "pipeline.stages.learning.training", "pipeline.stages.navigation.jobs", "pipeline.stages.rehearsal.training",
    "pipeline.stages.splineformer", "pipeline.stages.unseen.image_policy", "splineformer.learning.training",
    "torch._dynamo",
)  # fmt: skip


@pytest.fixture(scope="session", autouse=True)
def one_store_of_schemas() -> Iterator[None]:
    """Hydra copies every schema of every stage whenever it composes, changes none, and composes only for its mode."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ConfigStore, "__deepcopy__", lambda store, _: store, raising=False)
        patch.setattr(Hydra, "get_mode", lambda *_, **words: None)  # which no configuration of ours sets
        yield


@pytest.fixture(scope="session", autouse=True)
def one_fork_server_for_all_jobs() -> Iterator[None]:
    """A process keeps the server that forks its first job for those of all tests: it imports what any of them needs."""
    preload = forkserver.set_forkserver_preload
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(forkserver, "set_forkserver_preload", lambda modules: preload([*modules, *OF_ANY_JOB]))
        yield
