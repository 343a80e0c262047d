# SPDX-License-Identifier: GPL-3.0-or-later
"""The march against the same in numpy, on identical rays: ordinary, extreme and random scenes."""

import ctypes
import dataclasses

import numpy as np
import pytest

from inference.marching.depth_samples import possible_counts
from inference.marching.marcher import Marcher
from inference.marching.ray_march import RaySegment
from inference.runtime.cancellation import Cancelled
from inference.scene.optimizations import ALL
from tests.reference.lamp_march import march_lamps
from tests.reference.march import emitted_radiance, march, sample_counts
from tests.support.kernels import VARIANTS, variant
from tests.support.marches import MarchScene, Recipe, random_scene

# Largest difference over the largest value of each quantity.
TOLERANCE = 1e-5
BIG = (150, 140, 135)
SCENES = {
    "ordinary": Recipe(),
    "thin": Recipe(thickness=1e-4),
    "thick": Recipe(thickness=200.0),
    "stiff": Recipe(thickness=3000.0),
    "sparse": Recipe(sparse=True, voxels=BIG),
    "stiff and sparse": Recipe(sparse=True, voxels=BIG, thickness=3000.0),
    "one voxel": Recipe(voxels=(1, 1, 1), kind="solid"),
    "a row of voxels": Recipe(voxels=(1, 1, 150), kind="solid", thickness=100.0),
    "sheared": Recipe(shear=0.4),
    "orthographic": Recipe(projection="orthographic"),
    "from inside": Recipe(projection="inside"),
    "three volumes": Recipe(volumes=3, suns=2),
    "three volumes in two groups": Recipe(volumes=3, suns=3, groups=[[0, 2], [1]]),
    "stiff volumes": Recipe(volumes=2, suns=2, thickness=1000.0),
    "shadows of surfaces": Recipe(shadows=True, suns=2),
    "emission": Recipe(emission=1, volumes=2),
    "sparse blackbody": Recipe(emission=4, sparse=True, voxels=BIG),
    "lonely voxels": Recipe(kind="voxels", thickness=50.0),
    "all magnitudes": Recipe(kind="magnitudes", thickness=5e5),
    "opaque solid": Recipe(kind="solid", thickness=5e5),
    "without optimizations": Recipe(optimizations=frozenset(), emission=1, thickness=30.0),
    "without ray features": Recipe(features=False, thickness=100.0),
    "many depth samples": Recipe(depth_samples=96),
    "rays of more detail": Recipe(depth_samples=5, detail=9, lamps=("point", "square")),
    "a point light": Recipe(lamps=("point",)),
    "a point light in dense smoke": Recipe(lamps=("point",), thickness=200.0),
    "a soft spot": Recipe(lamps=("soft spot",), sparse=True, voxels=BIG),
    "soft lamps": Recipe(lamps=("sphere", "disk", "square"), projection="inside"),
    "lamps with shadows": Recipe(lamps=("point", "square"), shadows=True),
    "far lamps": Recipe(lamps=("far point", "far square", "far sphere", "far soft spot"), voxels=(50, 60, 40)),
    "far lamps with shadows": Recipe(lamps=("far point", "far disk"), shadows=True, volumes=2),
    "lamps whose shadows are averaged": Recipe(lamps=("far square", "sphere", "disk", "soft spot"), means=True),
    "an albedo that varies": Recipe(albedo=1),
    "a colour that varies": Recipe(albedo=3, thickness=200.0, suns=2, shadows=True),
    "a colour that varies beside one that does not": Recipe(albedo=3, volumes=2, lamps=("point", "square")),
    "a sparse albedo that varies": Recipe(albedo=3, sparse=True, voxels=BIG, shear=0.2),
    "lamps and volumes in groups": Recipe(lamps=("point", "disk"), volumes=3, groups=[[0, 2], [1]], shear=0.2),
}


def compiled(scene: MarchScene) -> RaySegment:
    return Marcher(scene.media, scene.options, scene.channels, ctypes.c_int32(0), scene.lamps)(scene.rays)


def twin(scene: MarchScene) -> RaySegment:
    lamps = scene.lamps is not None
    emission = emitted_radiance(scene.media, scene.rays, scene.channels, scene.options.optimizations, lamps)
    segment = dataclasses.replace(march(scene.media, scene.rays, scene.options, lamps), emission=emission)
    if scene.lamps is None:
        return segment
    samples = segment.sample_ray, segment.sample_distance
    lamps = march_lamps(scene.media, scene.rays, scene.lamps, scene.options, samples)
    return dataclasses.replace(segment, lamps=lamps)


def quantities(segment: RaySegment) -> dict[str, np.ndarray]:
    """By name, arrays of what rays gathered."""
    found = {name: np.asarray(value) for name, value in vars(segment).items() if isinstance(value, np.ndarray)}
    # How far opaque rays are followed does not matter.
    found["optical_depth"] = np.exp(-found["optical_depth"])
    if segment.sample_features is not None:
        for column, values in enumerate(np.moveaxis(segment.sample_features.values, -1, 0)):
            found[f"feature {column}"] = values
    if segment.lamps is not None:
        found["lamps"] = segment.lamps.single
        if segment.lamps.features is not None:
            for column, values in enumerate(np.moveaxis(segment.lamps.features.values, -1, 0)):
                found[f"feature {column} of lamps"] = values
    return found


def assert_equal(one: RaySegment, other: RaySegment, tolerance: float) -> None:
    one, other = quantities(one), quantities(other)
    assert one.keys() == other.keys()
    for name, expected in one.items():
        assert expected.shape == other[name].shape, name
        difference = np.abs(expected.astype(float) - other[name]).max(initial=0.0)
        assert difference <= tolerance * np.abs(expected).max(initial=0.0), name


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
@pytest.mark.parametrize("name", SCENES)
def test_march_equals_its_twin(name, seed):
    scene = random_scene(seed, SCENES[name], 24)
    assert len(scene.rays.near) > 3
    expected = twin(scene)
    assert expected.alpha.max() > 0.0
    assert_equal(expected, compiled(scene), TOLERANCE)


def random_recipe(random: np.random.Generator) -> Recipe:
    volumes = int(random.integers(1, 4))
    return Recipe(
        volumes=volumes,
        suns=int(random.integers(1, 4)),
        voxels=tuple(random.integers(1, 40, 3).tolist()),
        thickness=float(10.0 ** random.uniform(-3.0, 4.0)),
        sparse=random.random() < 0.3,
        shear=float(random.choice([0.0, 0.3])),
        shadows=random.random() < 0.3,
        groups=[[0, 1], [2]] if volumes == 3 and random.random() < 0.5 else None,
        features=random.random() < 0.7,
        emission=int(random.choice([0, 1, 4])),
        projection=str(random.choice(["perspective", "orthographic", "inside"])),
        depth_samples=int(random.integers(1, 20)),
        optimizations=ALL - {"faint_rays"} - set(random.choice(sorted(ALL), 3).tolist()),
        kind=str(random.choice(["lumps", "solid", "voxels", "magnitudes"])),
    )


@pytest.mark.parametrize("seed", [*range(10), *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(10, 40))])
def test_march_equals_its_twin_in_random_scenes(seed):
    scene = random_scene(seed, random_recipe(np.random.default_rng(1000 + seed)), 16)
    # A ray whose last lit step is a matter of rounding is cut elsewhere; see the share of them.
    expected, found = quantities(twin(scene)), quantities(compiled(scene))
    for name in ("alpha", "single", "depth", "optical_depth", "emission"):
        if name in expected:
            scale = max(np.abs(expected[name]).max(initial=0.0), 1e-30)
            off = np.abs(expected[name] - found[name]).reshape(len(expected["alpha"]), -1).max(axis=1) / scale
            assert np.count_nonzero(off > TOLERANCE) <= 1, name
            assert off.max() < 0.05, name


def test_depth_samples_of_faint_rays_are_as_many():
    scene = random_scene(3, dataclasses.replace(SCENES["ordinary"], optimizations=ALL, depth_samples=40), 200)
    expected, found = twin(scene), compiled(scene)
    counts = [np.bincount(segment.sample_ray, minlength=200) for segment in (expected, found)]
    assert len(np.unique(counts[0])) > 5
    assert np.mean(counts[0] != counts[1]) <= 0.01


@pytest.mark.parametrize("most", [1, 2, 15, 16, 17, 40, 48, 100])
def test_possible_counts_are_all_there_are(most):
    counts = np.unique(sample_counts(np.linspace(0.0, 1.0, 200001), most))
    assert set(counts[counts > 0]) <= set(possible_counts(most)) and max(possible_counts(most)) == most


@pytest.mark.parametrize("name", ["ordinary", "stiff", "sparse", "three volumes in two groups", "emission"])
def test_variants_for_different_processors_agree(name):
    scene = random_scene(7, SCENES[name], 24)
    segments = []
    for number in VARIANTS:
        with variant(number):
            segments.append(compiled(scene))
    for segment in segments[1:]:
        assert_equal(segments[0], segment, 1e-6)


def test_a_ray_does_not_depend_on_those_marched_with_it():
    scene = random_scene(1, SCENES["thick"], 24)
    together = compiled(scene)
    alone = compiled(dataclasses.replace(scene, rays=scene.rays.take(slice(5, 6))))
    assert together.alpha[5] == alone.alpha[0]
    np.testing.assert_array_equal(together.single[5], alone.single[0])
    np.testing.assert_array_equal(
        together.sample_features.values[together.sample_ray == 5], alone.sample_features.values
    )


def test_a_march_that_is_to_stop_is_cancelled():
    scene = random_scene(1, SCENES["ordinary"], 24)
    marcher = Marcher(scene.media, scene.options, scene.channels, ctypes.c_int32(1))
    with pytest.raises(Cancelled):
        marcher(scene.rays)


@pytest.mark.parametrize("seed", range(3))
def test_volumes_far_from_a_ray_change_nothing(seed):
    scene = random_scene(seed, Recipe(volumes=12, suns=2, voxels=(20, 24, 16), emission=1))
    everything = dataclasses.replace(scene, options=dataclasses.replace(scene.options, suns=None))
    for name, expected in quantities(compiled(everything)).items():
        np.testing.assert_array_equal(quantities(compiled(scene))[name], expected, err_msg=name)


def test_rays_take_the_memory_of_the_volumes_that_they_meet():
    scene = random_scene(1, Recipe(volumes=24, voxels=(8, 8, 8)), rays=4)
    held = []
    for suns in (scene.options.suns, None):
        options = dataclasses.replace(scene.options, suns=suns)
        marcher = Marcher(scene.media, options, scene.channels, ctypes.c_int32(0))
        marcher(scene.rays)
        held.append(len(marcher._local.scratch))
    assert held[0] < 0.6 * held[1]
