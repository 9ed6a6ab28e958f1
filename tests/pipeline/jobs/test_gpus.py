"""GPUs are shared out among jobs by their memory; none is needed to test that."""

import dataclasses

import pytest

from pipeline.jobs.machine import Machine, check_device, find_gpus, gpus_of
from pipeline.jobs.pool import Job, chosen_engine, run_jobs
from pipeline.jobs.worker import Message, Report
from pipeline.settings.kinds import settings_that_matter
from pipeline.stages import available_stages, load_stage
from pipeline.stages.job_memory import CONTEXT_GB, network_gb, policy_gb
from pipeline.stages.learning.settings import BaselinesSettings
from pipeline.store.errors import ConfigurationError, StageError
from pipeline.store.run_folder import RunFolder
from tests.pipeline.jobs.toy_training import GB, SECONDS_BESIDE_OTHERS, gpu, overlap, where

SETTINGS = {name: load_stage(name).settings for name in available_stages()}


def test_jobs_share_gpus_by_their_memory(folder: RunFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pipeline.jobs.machine.find_gpus", lambda: [gpu("0", 13), gpu("GPU-7f", 7)])
    jobs = [Job(f"job{k}", where, SECONDS_BESIDE_OTHERS, gpu_gb=6.0) for k in range(4)] + [Job("vectors", where)]
    told = run_jobs(folder, jobs, workers=5, device="cuda")
    assert told["vectors"]["device"] == "cpu"
    assert told["vectors"]["visible"] == ""  # it cannot take memory of a GPU by mistake
    rest = [told[f"job{k}"] for k in range(4)]
    assert {one["device"] for one in rest} == {"cuda"}
    assert {one["visible"] for one in rest} == {"0", "GPU-7f"}
    for visible, most in (("0", 2), ("GPU-7f", 1)):
        there = [one for one in rest if one["visible"] == visible]
        assert max(sum(overlap(one, other) for other in there) for one in there) <= most


def test_without_a_gpu_jobs_run_on_the_processor_which_is_not_asked_for_gpus(
    folder: RunFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pipeline.jobs.machine.find_gpus", list)
    told = run_jobs(folder, [Job("a", where, gpu_gb=6.0)], workers=1, device="auto")
    assert (told["a"]["device"], told["a"]["visible"]) == ("cpu", "")
    monkeypatch.setattr("pipeline.jobs.machine.find_gpus", lambda: pytest.fail("nobody was to look for GPUs"))
    told = run_jobs(folder, [Job("b", where, gpu_gb=6.0)], workers=1)
    assert told["b"]["device"] == "cpu"


def test_a_job_that_fits_nowhere_is_named_before_anything_runs(
    folder: RunFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pipeline.jobs.machine.find_gpus", lambda: [gpu("0", 8)])
    jobs = [Job("small", where, gpu_gb=1.0), Job("large", where, gpu_gb=9.5)]
    with pytest.raises(StageError, match=r"large needs a GPU with about 9\.5 GB free, the most is 8\.0"):
        run_jobs(folder, jobs, workers=1, device="cuda")
    assert folder.result_of("small") is None


def test_a_job_has_the_gpu_with_most_free_memory() -> None:
    machine = Machine(9, 8.0, [gpu("a", 8), gpu("b", 10), gpu("c", 9)])
    taken = [machine.take(Job(key, where, gpu_gb=7.0)) for key in ("one", "two", "three", "four")]
    assert [found and [one.visible for one in found] for found in taken] == [["b"], ["c"], ["a"], None]
    machine.free("one")
    assert machine.take(Job("four", where, gpu_gb=7.0)) is not None


def test_what_a_job_really_uses_counts_where_it_is_more() -> None:
    machine = Machine(9, 8.0, [gpu("0", 10)])

    def fits(gpu_gb: float) -> bool:
        taken = machine.take(Job(f"{gpu_gb}", where, gpu_gb=gpu_gb)) is not None
        machine.free(f"{gpu_gb}")
        return taken

    assert machine.take(Job("first", where, gpu_gb=2.0))
    machine.measured("first", 1 * GB)
    assert fits(8.0)
    machine.measured("first", 7 * GB)
    assert fits(3.0)
    assert not fits(3.1)
    machine.free("first")
    machine.free("first")
    assert fits(10.0)


@pytest.mark.parametrize(
    ("count", "device", "message"),
    [
        (0, "cuda", r"stage\.device=cuda, but torch finds no GPU"),
        (2, "cuda:2", r"stage\.device=cuda:2, but torch finds 2 GPUs: the last is cuda:1"),
    ],
)
def test_a_gpu_that_there_is_not_is_refused(
    count: int, device: str, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pipeline.jobs.machine.find_gpus", lambda: [gpu(str(k), 8) for k in range(count)])
    with pytest.raises(ConfigurationError, match=message):
        check_device(device)
    for fine in ("cpu", "auto", *(f"cuda:{k}" for k in range(count))):
        check_device(fine)


def test_other_words_are_refused() -> None:
    for device in ("tpu", "cuda:", "cuda:-1", "CUDA", ""):
        with pytest.raises(ConfigurationError, match=r"stage\.device has no"):
            BaselinesSettings(phantoms=["type_1"], targets=["bca"], device=device)


def test_every_stage_with_networks_has_a_device_that_changes_no_results() -> None:
    learning = {"baselines", "enn", "imitation", "force", "unseen", "navigation", "rehearsal"}
    fields = {name: {field.name: field for field in dataclasses.fields(kind)} for name, kind in SETTINGS.items()}
    there = {name for name, known in fields.items() if "device" in known}
    assert there == learning | {"shape", "segmentation", "splineformer"}
    assert all(fields[name]["device"].metadata == {"affects_results": False} for name in there)
    made = BaselinesSettings(phantoms=["type_1"], targets=["bca"], device="cuda:3")
    assert "device" not in settings_that_matter(made)


def test_gpus_are_those_that_torch_sees_and_one_can_be_chosen() -> None:
    import torch

    assert len(find_gpus()) == (torch.cuda.device_count() if torch.cuda.is_available() else 0)
    found = [gpu("4", 8), gpu("5", 9)]
    assert gpus_of("cpu", found) == []
    assert gpus_of("auto", found) == gpus_of("cuda", found) == found
    assert gpus_of("cuda:1", found) == found[1:]
    told: list[Message] = []
    Report(told.append)(0.5)
    assert told[0].gpu_bytes == 0  # this process uses none


def test_estimates_grow_with_images_and_batches() -> None:
    assert CONTEXT_GB < policy_gb(80, 0) < policy_gb(80, 1) < policy_gb(80, 1, 256) < policy_gb(128, 3, 256)
    assert policy_gb(80, 0) < 1.5
    assert network_gb("unet", "smoke") < network_gb("unet", "desk") < network_gb("unet", "thesis")
    assert 10 < network_gb("transunet", "thesis") < 24
    assert network_gb("published", "smoke") < network_gb("published", "thesis") < network_gb("shape", "thesis")


def test_jobs_wait_for_the_processors_memory(folder: RunFolder) -> None:
    jobs = [Job(f"job{k}", where, SECONDS_BESIDE_OTHERS, memory_gb=6.0) for k in range(3)] + [Job("small", where)]
    with chosen_engine(None, lambda: 13 * GB):
        told = run_jobs(folder, jobs, workers=4)
    large = [told[f"job{k}"] for k in range(3)]
    assert max(sum(overlap(one, other) for other in large) for one in large) <= 2
    huge = pytest.raises(StageError, match=r"huge needs about 14\.0 GB of memory, 13\.0 GB are available")
    with chosen_engine(None, lambda: 13 * GB), huge:
        run_jobs(folder, [Job("huge", where, memory_gb=14.0)])


def test_every_training_of_the_thesis_fits_16_gb() -> None:
    from enn.networks.observation_spaces import modality_keys
    from enn.reinforcement.training.settings import THESIS_PPO, THESIS_SAC
    from pipeline.stages.job_memory import PROCESS_GB, training_gb
    from pipeline.stages.learning.task import LearningTask
    from pipeline.task import Task

    baselines = LearningTask("type_1", "bca", Task(wire="thesis", actions="tip_motors", image_size_px=128))
    enn = LearningTask("type_1", "bca", Task(wire="thesis"))
    cells = [
        (baselines, (name,), preset)
        for name in ("internal", "image", "sequential")
        for preset in (THESIS_SAC, THESIS_PPO)
    ]
    cells += [(enn, modality_keys(name), THESIS_SAC) for name in ("I", "V", "V+M", "I+V", "I+V+M")]
    told = [training_gb(task, keys, preset, encoded=False) for task, keys, preset in cells]
    assert 9 < max(told) < 12, "the joints' state, 2,352 numbers, is the largest"
    assert training_gb(baselines, ("sequential",), THESIS_SAC, encoded=False) < PROCESS_GB + 3, "49 GB uncompressed"
    assert training_gb(enn, ("image",), THESIS_SAC, encoded=True) == 1.0
