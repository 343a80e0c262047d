# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of volumes whose velocities carry what they hold while the shutter is open."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from inference import Camera, Medium, Motion, SceneError, Settings, Shutter, Sun, Velocity, Volume, render
from inference.grids.bound_medium import Flow
from inference.scene.sparse_grid import SparseGrid

CELLS, EDGE = 32, 0.4


def placed(x=0.0):
    """A camera's transform, 2 units above the origin."""
    matrix = np.eye(4)
    matrix[:3, 3] = x, 0.0, 2.0
    return matrix


def centred(cells, edge=EDGE):
    """A cube of so many cells around the origin: index to world."""
    matrix = np.diag([edge / cells] * 3 + [1.0])
    matrix[:3, 3] = (0.5 - 0.5 * cells) * edge / cells
    return matrix


def lattice(cells, edge=EDGE):
    """Positions (3, cells, cells, cells) of its voxels."""
    axis = ((np.arange(cells) + 0.5) / cells - 0.5) * edge
    return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"))


def ball():
    x, y, z = lattice(CELLS)
    density = np.clip((0.07 - np.hypot(np.hypot(x + 0.05, y), z)) / 0.02, 0.0, 1.0) * (
        1.2 + np.sin(60.0 * x + 40.0 * y)
    )
    return Volume(density.astype(np.float32), centred(CELLS), name="ball"), Medium(20.0, (0.6, 0.6, 0.6))


def whirl(cells=16, edge=EDGE):
    """It turns about z, and spreads along x; in world units per frame."""
    x, y, z = lattice(cells, edge)
    return tuple(np.asarray(part, np.float32) for part in (-1.5 * y + 1.0 * x + 0.1, 1.5 * x, 0.3 * z - 0.05))


def velocity(components=None, times=(-0.5, 0.5), cells=16, edge=EDGE, turn=None):
    return Velocity(components or whirl(cells, edge), centred(cells, edge), np.eye(3) if turn is None else turn, times)


def carried(volume, flow, time):
    """A volume as it is seen at a time, on voxels of its own."""
    cells, edge = 3 * CELLS, 1.5 * EDGE
    points = lattice(cells, edge).reshape(3, -1)

    def at(grid, matrix, places):
        index = np.linalg.solve(matrix[:3, :3], places - matrix[:3, 3:])
        return map_coordinates(np.pad(grid, 1), index + 1.0, order=1, mode="constant")

    back = points
    for _ in range(2):
        values = np.stack([at(part, flow.world_from_index, back) for part in flow.components])
        back = points - time * flow.world_from_velocity @ values
    density = at(volume.density, volume.world_from_index, back).reshape((cells,) * 3)
    return Volume(density.astype(np.float32), centred(cells, edge), name="carried")


CAMERA = Camera(placed(), resolution=(64, 64), fov=0.25, shutter=Shutter())


def mean_picture(volume, medium, flow, lights, settings):
    """The mean of pictures at many times, and the sharp one."""
    times = flow.times[0] + (np.arange(32) + 0.5) / 32 * (flow.times[1] - flow.times[0])
    camera = replace(CAMERA, shutter=None)
    pictures = [render([(carried(volume, flow, time), medium)], lights, camera, settings) for time in times]
    return {name: np.mean([getattr(one, name) for one in pictures], axis=0) for name in ("alpha", "rgb")}


@pytest.mark.slow
@pytest.mark.parametrize("sparse", [False, True])
def test_a_picture_is_the_mean_of_pictures_of_what_velocities_carry(sparse):
    (volume, medium), flow = ball(), velocity()
    settings, lights = Settings(blur_rays=16, multiple=False), [Sun((0.3, 0.2, 1.0), 1.0)]
    expected = mean_picture(volume, medium, flow, lights, settings)
    if sparse:
        flow = replace(flow, components=tuple(SparseGrid.of_dense(part) for part in flow.components))
        volume = replace(volume, density=SparseGrid.of_dense(volume.density))
    found = render([(replace(volume, velocity=flow), medium)], lights, CAMERA, settings)
    sharp = render([(volume, medium)], lights, replace(CAMERA, shutter=None), settings)
    for name in expected:
        size = expected[name][expected[name] > 0.02 * expected[name].max()].mean()
        blurred, unblurred = (
            np.sqrt(((getattr(one, name) - expected[name]) ** 2).mean()) / size for one in (found, sharp)
        )
        print(name, blurred, unblurred)
        assert blurred < 0.05 and unblurred > 0.15


@pytest.mark.slow
def test_a_uniform_velocity_moves_a_volume_as_a_whole():
    """Light, too, is what it was at the frame: multiple scattering and depth as well."""
    volume, medium = ball()
    lights, settings = [Sun((0.3, 0.2, 1.0), 1.0)], Settings(blur_rays=4)
    ends = [np.eye(4), np.eye(4)]
    ends[0][:3, 3], ends[1][:3, 3] = (-0.03, -0.01, 0.0), (0.03, 0.01, 0.0)
    shape = (12, 12, 12)
    # In a space of its own, turned about z.
    turn = np.array([[0.0, -2.0, 0.0], [2.0, 0.0, 0.0], [0.0, 0.0, 2.0]])
    parts = tuple(np.full(shape, value, np.float32) for value in np.linalg.solve(turn, [0.06, 0.02, 0.0]))
    flow = velocity(parts, cells=12, edge=0.8, turn=turn)
    a, b = (
        render([(replace(volume, **how), medium)], lights, CAMERA, settings)
        for how in ({"velocity": flow}, {"motion": Motion(np.array(ends), np.eye(4))})
    )
    assert b.multiple.max() > 0.01
    for name in ("alpha", "single", "multiple", "depth"):
        one, other = getattr(a, name), getattr(b, name)
        seen = np.isfinite(one) & np.isfinite(other)
        assert seen.mean() > 0.05 and (np.isfinite(one) == np.isfinite(other)).mean() > 0.99
        assert np.abs(one[seen] - other[seen]).max() < 0.02 * np.abs(other[seen]).max()


def test_times_since_the_frame_move_the_picture():
    volume, medium = ball()
    shape = (12, 12, 12)
    parts = (np.ones(shape, np.float32), *np.zeros((2, *shape), np.float32))
    middles = []
    for times in ((0.0, 0.04), (0.02, 0.06)):
        moving = replace(volume, velocity=velocity(parts, times, cells=12, edge=0.8))
        alpha = render([(moving, medium)], [], CAMERA).alpha
        middles.append((alpha * np.arange(64)).sum() / alpha.sum())
    pixel = 2.0 * 2.0 * np.tan(0.125) / 64
    assert middles[1] - middles[0] == pytest.approx(0.02 / pixel, rel=0.1)


def test_without_a_shutter_velocities_change_nothing():
    volume, medium = ball()
    camera, lights = replace(CAMERA, shutter=None), [Sun((0.3, 0.2, 1.0), 1.0)]
    a, b = (render([(one, medium)], lights, camera) for one in (volume, replace(volume, velocity=velocity())))
    assert np.array_equal(a.rgb, b.rgb)


@pytest.mark.parametrize("size", [1e-9, 1e6, 1e30])
@pytest.mark.parametrize("kind", ["everywhere", "single voxels", "apart"])
def test_extreme_velocities_leave_sound_pictures(size, kind):
    volume, medium = ball()
    random, voxel = np.random.default_rng(4), EDGE / CELLS
    parts = random.normal(0.0, size * voxel, (3, 16, 16, 16))
    if kind == "single voxels":
        parts *= random.random((16, 16, 16)) < 0.01
    parts = tuple(np.clip(part, -3e38, 3e38).astype(np.float32) for part in parts)
    flow = velocity(parts, (-1e3, 1e3) if size > 1e9 else (-0.5, 0.5))
    if kind == "apart":
        matrix = flow.world_from_index.copy()
        matrix[:3, 3] += 1e3
        flow = replace(flow, world_from_index=matrix)
    emission = np.repeat(volume.density[..., None], 3, axis=3)
    scene = [
        (replace(volume, velocity=flow, emission=emission), replace(medium, sigma_t=2000.0, albedo=np.full(3, 0.9)))
    ]
    found = render(scene, [Sun((0.3, 0.2, 1.0), 1.0)], replace(CAMERA, resolution=(24, 24)))
    for image in (found.rgb, found.alpha, found.multiple, found.uncertainty):
        assert np.isfinite(image).all() and image.min() >= 0.0
    assert 0.0 < found.alpha.max() <= 1.0 + 1e-6


def test_what_is_no_velocity_is_refused():
    flow = velocity()
    spoiled = whirl()
    spoiled[1][3, 4, 5] = np.nan
    for values in (
        {"components": flow.components[:2]},
        {"components": spoiled},
        {"world_from_velocity": np.full((3, 3), np.nan)},
        {"world_from_index": np.zeros((4, 4))},
        {"times": (0.0, np.inf)},
    ):
        with pytest.raises(SceneError, match="velocity"):
            replace(flow, **values)


def test_what_piles_up_where_a_flow_ends_hardly_moves():
    """Beyond the last voxels there is no velocity. Where it is the same around, what is seen moves with it."""
    flow = velocity((np.full((16, 16, 16), 0.3, np.float32), *np.zeros((2, 16, 16, 16), np.float32)))
    flow, eyes = Flow(flow, Flow.grids_of(flow), np.array([-0.5, 0.0, 0.5])), np.arange(3)
    within = flow.apparent(np.zeros((3, 3)), eyes)
    np.testing.assert_allclose(within, [[0.3, 0.0, 0.0]] * 3, rtol=1e-6)
    # Just beyond the last voxels.
    places, eyes = np.array([[0.5 + place / 16, 0.0, 0.0] for place in (0.3, 0.35, 0.4)]) * EDGE, np.full(3, 2)
    velocities = flow.velocities(places, eyes)
    assert np.all(velocities[:, 0] > 0.1) and np.all(flow.apparent(places, eyes)[:, 0] < 0.5 * velocities[:, 0])
