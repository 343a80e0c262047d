# SPDX-License-Identifier: GPL-3.0-or-later
"""Many volumes that overlap, which camera rays see as one."""

import numpy as np
import pytest

from inference import Medium, Motion, RenderCache, Settings, Shutter, Sun, Volume, render
from inference.plan.joined_volumes import find_joins
from inference.plan.overlap import MANY, overlapping
from inference.plan.plan import sort_scene
from inference.scene.optimizations import ALL, OPTIMIZATIONS
from inference.scene.phase_function import PhaseFunction
from tests.support.volumes import SUN, camera, cloud

APART = ALL - {"joined_volumes"}


def puffs(count=2 * MANY, voxels=40, **medium):
    """Instances of one cloud, turned, shrunken and strewn so that all overlap."""
    random, density = np.random.default_rng(0), cloud(voxels=voxels).density
    found = []
    for number in range(count):
        angle, size = random.uniform(0.0, 6.0), random.uniform(0.5, 0.7)
        turn = [[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]]
        matrix = np.eye(4)
        matrix[:3, :3] = np.array(turn) * size / voxels
        matrix[:3, 3] = random.uniform(-0.25, 0.25, 3) - matrix[:3, :3] @ np.full(3, 0.5 * (voxels - 1))
        of = {"sigma_t": 6.0 * random.uniform(0.5, 1.5), "albedo": 0.95, "anisotropy": 0.5, **medium}
        found.append((Volume(density, matrix, f"puff {number}"), Medium(**of)))
    return found


def picture(volumes, optimizations=ALL, lights=(SUN,), cache=None, shift=0.0, **settings):
    seen = camera(resolution=(60, 40), fov=0.4)
    seen.world_matrix[0, 3] += shift
    switches = optimizations - {"shared_pixels"}
    return render(volumes, list(lights), seen, Settings(optimizations=switches, **settings), cache=cache)


def joins(volumes, lights=(SUN,), **settings):
    return find_joins(sort_scene(volumes, list(lights)), camera(), Settings(**settings))


def test_volumes_that_move_are_not_joined():
    volumes, moving = puffs(), camera()
    moving.shutter = Shutter()
    for volume, _ in volumes[1:]:
        volume.motion = Motion([np.eye(4), np.eye(4)], np.eye(4))
    scene = sort_scene(volumes, [SUN])
    assert find_joins(scene, camera(), Settings()) and not find_joins(scene, moving, Settings())


def change(image, other, shown):
    return np.sqrt(((image - other)[shown] ** 2).mean()) / other[shown].mean()


@pytest.mark.parametrize("colours", ["alike", pytest.param("different", marks=pytest.mark.slow)])
def test_joined_volumes_look_as_they_do_apart(colours):
    """Those with albedos of their own and emission, too."""
    volumes = puffs()
    if colours == "different":
        glow = np.repeat(volumes[0][0].density[..., None], 3, axis=3) * [1.0, 0.4, 0.1]
        volumes = [
            (Volume(v.density, v.world_from_index, v.name, 0.5 * glow, 2), Medium(m.sigma_t * [1, 2, 3], a, 0.5, 2.0))
            for n, (v, m) in enumerate(volumes)
            for a in [(0.9, 0.5, 0.1) if n % 2 else 0.8]
        ]
    one, each = picture(volumes), picture(volumes, APART)
    shown = each.alpha > 0.02
    assert 0.0 < change(one.rgb, each.rgb, shown) < OPTIMIZATIONS["joined_volumes"].budget
    assert change(one.alpha, each.alpha, shown) < OPTIMIZATIONS["joined_volumes"].budget
    assert one.rgb[shown].mean() == pytest.approx(each.rgb[shown].mean(), rel=5e-3)
    assert any("one volume" in planned for planned in one.report.planned)
    if colours == "different":
        # The square of noise.
        assert change(one.emission, each.emission, shown) < 2.0 * OPTIMIZATIONS["joined_volumes"].budget


@pytest.mark.slow
def test_volumes_that_differ_are_joined_with_their_kind_alone():
    draine = PhaseFunction(((1.0, "henyey_greenstein", (0.3,)),))
    kinds = [{}, {"anisotropy": 0.3, "phase": draine}, {"sigma_t": (1.0, 2.0, 3.0)}]
    volumes = [pair for medium in kinds for pair in puffs(MANY, **medium)]
    assert [join.members for join in joins(volumes)] == [list(range(n, n + MANY)) for n in (0, MANY, 2 * MANY)]
    few = puffs(MANY - 1) + puffs(2, holdout=True, albedo=0.0)
    assert joins(few) == []
    one = picture(volumes + few)
    assert len([planned for planned in one.report.planned if "one volume" in planned]) == 3


def test_volumes_that_are_told_apart_are_not_joined():
    """By lights, by coverage, by the switch; and where one grid would take too much memory."""
    volumes = puffs()
    some = Sun((0.0, 0.0, 1.0), receivers=frozenset({"puff 0"}))
    assert len(joins(volumes)) == 1
    assert joins(volumes, [SUN, some]) == []
    assert joins(volumes, outputs=frozenset({"coverage"})) == []
    assert joins(volumes, optimizations=APART) == []
    assert joins(volumes, memory_limit=1 << 20) == []


@pytest.mark.slow
def test_joined_volumes_stay_while_the_camera_moves():
    volumes, cache = puffs(), RenderCache()
    picture(volumes, cache=cache)
    moved, anew = picture(volumes, cache=cache, shift=0.05), picture(volumes, shift=0.05)
    np.testing.assert_array_equal(moved.rgb, anew.rgb)
    assert moved.report.cpu_seconds["shadows"] < 0.5 * anew.report.cpu_seconds["shadows"]
    brighter = [(volume, Medium(2.0 * medium.sigma_t, 0.95, 0.5)) for volume, medium in volumes]
    np.testing.assert_array_equal(picture(brighter, cache=cache).rgb, picture(brighter).rgb)


def test_a_cloud_of_many_parts_is_one_medium():
    """Across which two volumes would be too different in size."""
    fog, density = Medium(1.0), np.ones((8, 8, 8), np.float32)
    row = []
    for number in range(9):
        matrix = np.diag([1 / 8, 1 / 8, 1 / 8, 1.0])
        matrix[0, 3] = 0.7 * number
        row.append((Volume(density, matrix), fog))
    assert overlapping(row) == ([list(range(9))], [])
    assert len(overlapping(row[: MANY - 1])[0]) == 2
