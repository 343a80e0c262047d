# SPDX-License-Identifier: GPL-3.0-or-later
"""What few volumes of many hold at samples, against a column for each volume."""

import numpy as np
import pytest

from inference.marching.depth_samples import DepthSamples
from inference.marching.held_volumes import held_volumes, in_columns
from inference.marching.ray_features import RayFeatures

VOLUMES, RAYS, COUNT = 9, 20, 3


def dense_samples(random, overlapping):
    """Fractions (M, V) of volumes, each of which is a group; at most so many hold a sample."""
    fraction = random.uniform(0.1, 1.0, (RAYS * COUNT, VOLUMES)).astype(np.float32)
    keys = random.random(fraction.shape)
    fraction[keys.argsort(axis=1).argsort(axis=1) >= random.integers(0, overlapping + 1, (RAYS * COUNT, 1))] = 0.0
    return fraction


def depth_samples(pixel, fraction, features, volumes):
    """Samples, COUNT on a ray through each pixel; fraction: (M, V), of these volumes."""
    held, columns = held_volumes(fraction > 0.0, volumes)
    rays, number = len(pixel), np.arange(len(pixel) * COUNT)
    return DepthSamples(
        pixel=pixel,
        origins=np.zeros((rays, 3)),
        directions=np.stack([pixel, pixel, pixel], axis=1).astype(float),
        offsets=np.zeros(rays),
        ray=(number // COUNT).astype(np.int32),
        distance=np.repeat(pixel, COUNT) + 0.1 * (number % COUNT),
        weight=np.full(len(number), 0.25),
        held=held,
        fraction=in_columns(fraction, columns),
        held_groups=held,
        features=RayFeatures(in_columns(features, columns)),
        volumes=frozenset(volumes),
    )


@pytest.mark.parametrize("overlapping", [0, 1, 3])
def test_few_columns_tell_what_many_do(overlapping):
    random = np.random.default_rng(overlapping)
    fraction, features = dense_samples(random, overlapping), random.random((RAYS * COUNT, VOLUMES, 1, 2))
    samples = depth_samples(np.arange(RAYS), fraction, features, range(VOLUMES))
    assert samples.fraction.shape[1] == max(overlapping, 1)
    every = np.arange(RAYS * COUNT)
    factors = random.random((VOLUMES, 2)).astype(np.float32)
    for members in ([4], [1, 5, 8], range(VOLUMES)):
        np.testing.assert_allclose(samples.share(members), fraction[:, members].sum(axis=1), rtol=1e-6)
        scattered = samples.scattered(every, members, factors[members], [0, 1])
        np.testing.assert_allclose(scattered, 0.25 * fraction[:, members] @ factors[members], rtol=1e-6)
        told = np.zeros(fraction.shape)
        for turn in samples.turns(members):
            some = np.flatnonzero(turn >= 0)
            own = np.array(members)[turn[some]]
            assert not told[some, own].any()
            told[some, own] = samples.scattered_by(some, own, np.ones((len(some), 1), np.float32), [0])[:, 0] / 0.25
            column = samples.column_of_group(some, own)
            np.testing.assert_array_equal(samples.features.of(some, column, 0), features[some, own, 0])
        np.testing.assert_allclose(told[:, members], fraction[:, members], rtol=1e-6)


def test_parts_of_an_image_join_in_the_order_of_its_pixels():
    """Each part knows the volumes that it shows."""
    random = np.random.default_rng(7)
    fraction, features = dense_samples(random, 2), random.random((RAYS * COUNT, VOLUMES, 1, 2))
    of_part = np.arange(RAYS) % 2
    expected = np.zeros_like(fraction)
    parts = []
    for number, volumes in enumerate((range(5), range(3, VOLUMES))):
        pixel = np.flatnonzero(of_part == number)
        some = np.flatnonzero(np.repeat(of_part == number, COUNT))
        expected[np.ix_(some, volumes)] = fraction[np.ix_(some, volumes)]
        parts.append(depth_samples(pixel, expected[np.ix_(some, volumes)], features[some][:, volumes], volumes))
    samples = DepthSamples.joined(parts)
    np.testing.assert_array_equal(samples.pixel, np.arange(RAYS))
    np.testing.assert_array_equal(samples.ray, np.repeat(np.arange(RAYS), COUNT))
    np.testing.assert_array_equal(samples.directions[:, 0], np.arange(RAYS))
    np.testing.assert_allclose(samples.distance, np.repeat(np.arange(RAYS), COUNT) + 0.1 * (np.arange(60) % COUNT))
    for volume in range(VOLUMES):
        np.testing.assert_array_equal(samples.share([volume]), expected[:, volume])
        some = np.flatnonzero(expected[:, volume])
        column = samples.column_of_group(some, volume)
        np.testing.assert_array_equal(samples.features.of(some, column, 0), features[some, volume, 0])
