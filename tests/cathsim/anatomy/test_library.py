"""Named and random phantoms: targets, entries, messages, cache, lumens that a wire passes."""

import copy
import logging
import multiprocessing
import shutil
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from cathsim.anatomy import ArchParameters, library, load_phantom
from cathsim.anatomy.generator.scan_arch import sample_parameters
from cathsim.anatomy.library import NAMED, build_phantom
from cathsim.anatomy.phantom_cache import PhantomCache, default_cache_directory
from tests.cathsim.anatomy.lumen_report import check_lumen

COARSE = 2e-3


def _forget():
    library._load.cache_clear()


def test_entries_lie_inside_the_ends_and_point_in(phantom):
    for name, end in (("descending", 0), ("ascending", -1)):
        entry = phantom.entry(name)
        assert np.linalg.norm(entry.direction) == pytest.approx(1)
        assert np.linalg.norm(entry.position - phantom.tree.root.points[end]) == pytest.approx(2e-3, abs=1e-5)
        assert phantom.grid.sample(entry.position) == pytest.approx(2e-3, abs=1e-4)
        assert phantom.grid.sample(entry.position + 0.010 * entry.direction) > 0.009
        assert phantom.grid.sample(entry.position - 0.003 * entry.direction) < 0


def test_wrong_names_list_the_valid_ones(phantom, cache):
    with pytest.raises(ValueError, match="unknown target 'brain' in phantom 'type_1'; choose from bca, lcca, lsa"):
        phantom.geodesic_distance(np.zeros(3), "brain")
    for name, arguments, message in (
        ("type_9", {}, r"unknown phantom 'type_9'; choose from type_1, .*bovine, random"),
        ("random", {}, "'random' needs a seed"),
        ("random_x", {}, "unknown phantom 'random_x'"),
        ("type_1", {"seed": 3}, "'type_1' takes no seed, got 3"),
        ("type_1", {"unit": "mm", "names": ["bca"]}, "'type_1' takes no unit, names; only a phantom from a file does"),
        ("type_1", {"parameters": ArchParameters()}, "name of your own"),
        ("type_1", {"resolution": float("inf")}, "resolution must be a finite length"),
    ):
        with pytest.raises(ValueError, match=message):
            load_phantom(name, cache_dir=cache, **arguments)


def test_own_parameters_and_seeds_make_own_phantoms(tmp_path):
    own = load_phantom("mine", parameters=ArchParameters(trunk_length=0.036), resolution=COARSE, cache_dir=tmp_path)
    first = load_phantom("random", seed=4, resolution=COARSE, cache_dir=tmp_path)
    other = load_phantom("random", seed=5, resolution=COARSE, cache_dir=tmp_path)
    assert (own.name, first.name) == ("mine", "random_4")
    assert len({own.hash, first.hash, other.hash}) == 3


def test_one_object_for_many_environments(cache):
    phantom = load_phantom("type_1", cache_dir=cache)
    assert load_phantom("type_1", cache_dir=cache) is phantom
    assert copy.deepcopy({"phantom": phantom})["phantom"] is phantom
    with ThreadPoolExecutor(4) as pool:
        futures = [pool.submit(load_phantom, "bovine", resolution=COARSE, cache_dir=cache) for _ in range(4)]
    assert len({id(future.result()) for future in futures}) == 1


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """A phantom that was built, with a field of distances, and the folder of the cache that holds both."""
    folder = tmp_path_factory.mktemp("cache")
    phantom = load_phantom("type_3", resolution=COARSE, cache_dir=folder)
    phantom.geodesic_field("lcca")
    return phantom, folder


@pytest.fixture
def copied(built, tmp_path):
    """A copy of that cache, which a test may damage."""
    _forget()
    return shutil.copytree(built[1], tmp_path / "cache")


def read_again(folder):
    return load_phantom("type_3", resolution=COARSE, cache_dir=folder)


def test_what_the_cache_returns_is_what_was_built(built, copied):
    built, folder = built
    plain = copied / "plain"
    plain.touch()
    assert PhantomCache(folder).path(built.hash).stat().st_mode == plain.stat().st_mode  # other users may read it
    read = read_again(copied)
    assert read is not built
    assert read.hash == built.hash
    assert np.array_equal(read.grid.values, built.grid.values)
    assert np.array_equal(read.grid.origin, built.grid.origin)
    for a, b in zip(read.tree, built.tree, strict=True):
        assert (a.name, a.parent, a.parent_arc, a.open_end) == (b.name, b.parent, b.parent_arc, b.open_end)
        assert np.array_equal(a.points, b.points)
        assert np.array_equal(a.radius, b.radius)
    for name, target in built.targets.items():
        assert np.array_equal(read.targets[name].position, target.position)
    for name, entry in built.entries.items():
        assert np.array_equal(read.entries[name].direction, entry.direction)


@pytest.mark.parametrize("damage", ["flip", "header", "text"])
def test_a_damaged_cache_file_is_rebuilt_with_a_warning(built, copied, caplog, damage):
    path = PhantomCache(copied).path(built[0].hash)
    content = bytearray(path.read_bytes())
    array = content.index(b"distance.npy")
    content[content.index(b"}", array) if damage == "header" else array + 4000] ^= 0x10
    path.write_bytes(b"not a phantom" if damage == "text" else content)
    with caplog.at_level(logging.WARNING):
        again = read_again(copied)
    assert "is damaged" in caplog.text
    assert np.array_equal(again.grid.values, built[0].grid.values)
    _forget()
    caplog.clear()
    read_again(copied)
    assert caplog.text == ""


def test_a_field_is_read_as_it_was_computed_and_computed_again_where_it_is_damaged(built, copied, caplog, monkeypatch):
    expected = built[0].geodesic_field("lcca").values
    with monkeypatch.context() as patch:
        patch.delattr("cathsim.anatomy.phantom.geodesic_field")  # nothing is computed a second time
        assert np.array_equal(read_again(copied).geodesic_field("lcca").values, expected)
    (path,) = set(copied.rglob("*.npz")) - {PhantomCache(copied).path(built[0].hash)}
    content = bytearray(path.read_bytes())
    content[content.index(b"geodesic.npy") + 4000] ^= 0x10
    path.write_bytes(content)
    _forget()
    with caplog.at_level(logging.WARNING):
        field = read_again(copied).geodesic_field("lcca")
    assert "computed again" in caplog.text
    assert np.array_equal(field.values, expected)


def test_without_a_writable_cache_it_still_works(tmp_path, caplog):
    blocker = tmp_path / "file"
    blocker.write_text("in the way")
    with caplog.at_level(logging.WARNING):
        phantom = load_phantom("type_1", resolution=COARSE, cache_dir=blocker / "cache")
    assert "is not cached" in caplog.text
    assert phantom.grid.sample(phantom.entry().position) > 0


def _build(directory, barrier, queue):
    barrier.wait()
    phantom = load_phantom("type_2", resolution=COARSE, cache_dir=directory)
    queue.put(float(np.abs(phantom.grid.values).sum(dtype=np.float64)))


def test_two_processes_building_one_phantom_do_not_harm_each_other(tmp_path):
    context = multiprocessing.get_context("fork")
    barrier, queue = context.Barrier(2), context.Queue()
    workers = [context.Process(target=_build, args=(tmp_path, barrier, queue)) for _ in range(2)]
    for worker in workers:
        worker.start()
    sums = [queue.get(timeout=30) for _ in workers]
    for worker in workers:
        worker.join(timeout=30)
        assert worker.exitcode == 0
    assert sums[0] == sums[1]
    assert [p.suffix for p in (tmp_path / "phantoms").iterdir()] == [".npz"], "no temporary file is left"
    phantom = load_phantom("type_2", resolution=COARSE, cache_dir=tmp_path)
    assert float(np.abs(phantom.grid.values).sum(dtype=np.float64)) == sums[0]


def test_the_cache_directory_follows_the_environment(monkeypatch, tmp_path):
    monkeypatch.setenv("CATHSIM_CACHE", str(tmp_path / "own"))
    assert default_cache_directory() == tmp_path / "own"
    monkeypatch.delenv("CATHSIM_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert default_cache_directory() == tmp_path / "cathsim"


def test_the_name_of_a_random_arch_holds_its_seed(cache):
    arch = load_phantom("random_wide_7", resolution=2.5e-3, cache_dir=cache)
    assert arch is load_phantom("random_wide", seed=7, resolution=2.5e-3, cache_dir=cache)
    assert arch.name == "random_wide_7"


@pytest.mark.parametrize("name", NAMED)
def test_every_named_phantom_is_valid_with_targets_10_mm_before_the_open_ends(name):
    built = build_phantom(name, NAMED[name], resolution=1.5e-3)
    assert check_lumen(built) == []
    assert set(built.targets) >= {"bca", "lcca", "lsa", "rcca", "rsa"}
    ends = {target.name for target in built.targets.values() if target.at_end}
    assert ends == {"rcca_end", "rsa_end", "lcca_end", "lsa_end"}
    for end in ends:
        target, branch = built.target(end), built.tree[end.removesuffix("_end")]
        assert branch.open_end
        assert target.branch == branch.name
        assert np.linalg.norm(target.position - branch.points[-1]) == pytest.approx(0.010, rel=0.02)
        assert built.grid.sample(target.position) > 0.002
        assert built.way_length(end) > built.way_length(branch.name)


def test_random_phantoms_are_valid():
    for seed in range(2):
        parameters = sample_parameters(np.random.default_rng(1000 + seed))
        assert check_lumen(build_phantom("random", parameters, resolution=1.5e-3)) == [], seed
