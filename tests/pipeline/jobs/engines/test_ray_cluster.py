"""Jobs on a Ray cluster: two nodes of one CPU each on this machine, and what is refused."""

import builtins
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from pipeline.jobs.engines.ray_cluster import RayExecutor
from pipeline.jobs.engines.settings import RaySettings
from pipeline.jobs.pool import Job, chosen_engine, run_jobs
from pipeline.store.errors import StageError
from pipeline.store.run_folder import Identity, RunFolder
from tests.pipeline.jobs.toy_training import Toy, square, train

pytestmark = pytest.mark.slow

NO_RAY = "Ray is not installed: make ray"


@pytest.fixture
def two_nodes(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Any]:
    """A cluster of two nodes, stopped at the end."""
    pytest.importorskip("ray", reason=NO_RAY)
    from ray.cluster_utils import Cluster

    monkeypatch.setenv("HOME", str(tmp_path))  # Ray keeps a token of its own there
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    try:
        cluster.second = cluster.add_node(num_cpus=1)
        monkeypatch.setenv("RAY_ADDRESS", cluster.address)
        yield cluster
    finally:
        sys.modules["ray"].shutdown()
        cluster.shutdown()


def test_a_node_that_dies_has_its_jobs_done_by_the_other(two_nodes: Any, tmp_path: Path, caplog) -> None:
    folder = RunFolder(tmp_path / "stage", Identity("c", {}, 1))
    toys = {name: Toy(folder.path / name, steps=40, seconds_a_step=0.1) for name in "ab"}
    jobs = [Job(name, train, toy) for name, toy in toys.items()]
    killed: list[str] = []

    class WatchedFolder(RunFolder):
        """Kills the second node once both jobs have begun."""

        def result_of(self, key: str) -> Any:
            if not killed and all((toy.folder / "checkpoint.json").exists() for toy in toys.values()):
                killed.append(key)
                two_nodes.remove_node(two_nodes.second, allow_graceful=False)
            return super().result_of(key)

    with folder.locked(), chosen_engine(RaySettings(retries=2, memory_gb=0.1)):
        folder.prepare()
        watched = WatchedFolder(folder.path, folder.identity)
        # the last job waits for both, so that the folder is asked again and again
        results = run_jobs(watched, [*jobs, Job("c", square, 7, after=("a", "b"))], label="toys")
        assert killed
        assert {results["a"]["count"], results["b"]["count"]} == {40}
        assert results["c"] == 49
        assert max(results["a"]["began"], results["b"]["began"]) >= 1  # one went on from its checkpoint
        assert "it is done again, time 2 of 3" in caplog.text
        with pytest.raises(StageError, match="no machine of the cluster has so much"):
            run_jobs(folder, [Job("wide", square, 2, memory_gb=1e6)])


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("127.0.0.1:1", "there is no Ray cluster at 127.0.0.1:1: start one with `ray start --head`"),
        ("nonsense", "'nonsense' is no address of a Ray cluster, HOST:PORT such as"),
    ],
)
def test_an_address_without_a_cluster_is_one_sentence(address: str, words: str) -> None:
    pytest.importorskip("ray", reason=NO_RAY)
    with pytest.raises(StageError, match=words.replace("(", r"\(")):
        RayExecutor(RaySettings(address=address))


def test_no_ray_at_all_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    imported = builtins.__import__

    def without_ray(name: str, *arguments: Any, **more: Any) -> Any:
        if name == "ray":
            raise ModuleNotFoundError("No module named 'ray'", name="ray")
        return imported(name, *arguments, **more)

    monkeypatch.setattr(builtins, "__import__", without_ray)
    monkeypatch.delitem(sys.modules, "ray", raising=False)
    with pytest.raises(StageError, match="engine=ray needs Ray, which is not installed: run `make ray`"):
        RayExecutor(RaySettings())
