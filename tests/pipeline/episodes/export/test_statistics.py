"""Statistics of features: against numpy, of pictures, and of several episodes together."""

from __future__ import annotations

import numpy as np

from pipeline.episodes.export.statistics import GreyStatistics, of_rows, together


def test_rows_against_numpy() -> None:
    values = np.random.default_rng(0).normal(size=(50, 3))
    found = of_rows(values)
    np.testing.assert_allclose(found["mean"], values.mean(axis=0))
    np.testing.assert_allclose(found["q90"], np.quantile(values, 0.9, axis=0))
    assert found["count"].tolist() == [50]
    assert of_rows(values[:, 0])["min"].shape == (1,)


def test_a_part_without_numbers_gives_zeros() -> None:
    values = np.stack([np.full(4, np.nan), [1.0, np.nan, 3.0, 2.0]], axis=1)
    found = of_rows(values)
    assert found["mean"].tolist() == [0.0, 2.0]
    assert found["max"].tolist() == [0.0, 3.0]


def test_pictures_against_numpy() -> None:
    pictures = np.random.default_rng(1).integers(0, 256, (5, 20, 30), np.uint8)
    greys = GreyStatistics()
    for picture in pictures:
        greys.add(picture)
    found, shares = greys.values(), pictures / 255.0
    assert found["mean"].shape == (3, 1, 1)
    np.testing.assert_allclose(found["mean"][0], shares.mean())
    np.testing.assert_allclose(found["std"][0], shares.std())
    np.testing.assert_allclose(found["q50"][0], np.quantile(shares, 0.5), atol=1 / 255)
    assert found["count"].tolist() == [5]


def test_together_is_the_statistics_of_all() -> None:
    values = np.random.default_rng(2).normal(size=(60, 2))
    found, whole = together([of_rows(values[:10]), of_rows(values[10:])]), of_rows(values)
    for name in ("min", "max", "mean", "std", "count"):
        np.testing.assert_allclose(found[name], whole[name])
