# SPDX-License-Identifier: GPL-3.0-or-later
"""Light of an environment in the working cube: how it enters, and what attenuates it on the way.

An environment enters the coarse transport from its 26 directions, the ordinates, and what of it is open to a point is
known in 50. Each of them stands for the part of the sphere around it; the parts overlap smoothly, so that even light
stays even and no energy is lost.
"""

import functools
import weakref
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..grids.halving import doubled, halve
from ..grids.working_cube import Cube
from ..numerics.alike import alike_vector
from ..numerics.small_matmul import product
from ..runtime.cancellation import NEVER, CancelToken
from ..scene.environment import DirectionWeight, Environment, PlaceLattice, pixel_directions, pixel_solid_angles
from ..source_terms.cell_sources import EnteringLight
from ..transport.discrete_ordinates import DiscreteOrdinates
from ..transport.ordinates import ORDINATE_WEIGHTS, ORDINATES
from .blurred_environment import blurred

#: Rows of the images that are read here; larger ones are reduced before.
ROWS = 64
# Sharpness of the parts of the sphere, as of exp(k (cos - 1)), times their number; and the rounds that balance them.
SHARPNESS, ROUNDS = 12.0 / 26.0, 30
#: Albedos below 1 for which the transport is solved too: light that has scattered seldom.
ALBEDOS = (0.98, 0.8)
# Light, over its mean, that directions have at least which tell how much of it surfaces hide.
LEAST_LIGHT = 1e-3
# Cells along an edge of the faces of a cube through which light of skies enters that surfaces hide.
FACE = 32
# Images with fewer rows than this are divided before they are turned, and such with more reduced.
TURNED_ROWS = 192
# Skies in use, by the frame and the environments that they keep alive.
_skies: "weakref.WeakValueDictionary[tuple, Skies]" = weakref.WeakValueDictionary()


@dataclass(frozen=True)
class Skies:
    """Light from everywhere, of which places see different shares.

    image: float64 (ROWS, 2 ROWS, S C), radiance of S skies of C channels. rotation: (3, 3), of their frame. weights: of
    the S skies. environments: whose sum they are.
    """

    image: np.ndarray
    rotation: np.ndarray
    weights: tuple[PlaceLattice | DirectionWeight | None, ...]
    environments: tuple[Environment, ...] = ()
    _blurred: dict[tuple[float, ...], np.ndarray] = field(default_factory=dict, repr=False, compare=False)
    _light_parts: dict[tuple[int, int], np.ndarray] = field(default_factory=dict, repr=False, compare=False)

    @classmethod
    def of(cls, environments: Sequence[Environment], rotation: np.ndarray) -> "Skies":
        """The sum of environments, in a frame as of `image_in_frame`; the same object for instances turned alike, and
        for all where it is the same from everywhere."""
        if all(environment.even for environment in environments):
            # It is the same in every frame.
            rotation = np.eye(3)
        key = alike_vector(rotation.ravel()), *map(id, environments)
        known = _skies.get(key)
        if known is not None:
            return known
        weights = tuple(dict.fromkeys(environment.weight for environment in environments)) or (None,)
        images = [image_in_frame([e for e in environments if e.weight == weight], rotation) for weight in weights]
        channels = max(image.shape[2] for image in images)
        images = [np.broadcast_to(image, (*image.shape[:2], channels)) for image in images]
        made = _skies[key] = cls(np.concatenate(images, axis=2), rotation, weights, tuple(environments))
        return made

    @property
    def channels(self) -> int:
        """C: 1 if all light is grey, else 3."""
        return self.image.shape[2] // len(self.weights)

    @functools.cached_property
    def radiance(self) -> np.ndarray:
        """As of `direction_radiance`, float32."""
        return direction_radiance(self.image).astype(np.float32)

    def blurred(self, anisotropies: Sequence[float]) -> np.ndarray:
        """As of `blurred_environment`."""
        key = tuple(anisotropies)
        if key not in self._blurred:
            self._blurred[key] = blurred(self.image, anisotropies)
        return self._blurred[key]

    @functools.cached_property
    def even(self) -> bool:
        """Whether the same light comes from everywhere to every place."""
        return self.weights == (None,) and all(environment.even for environment in self.environments)

    @property
    def vary(self) -> bool:
        """Whether places see different shares."""
        return any(weight is not None for weight in self.weights)

    def shares(self, positions: np.ndarray) -> np.ndarray:
        """Those of the skies, float32 (N, S), at world positions (N, 3)."""
        shares = np.ones((len(positions), len(self.weights)), np.float32)
        for share, weight in zip(shares.T, self.weights):
            if isinstance(weight, PlaceLattice):
                share[:] = weight(positions)
        return shares

    def visible(self, positions: np.ndarray) -> dict[int, np.ndarray]:
        """Share float32 (N, 50) of each hidden sky's light from DIRECTIONS that reaches world positions (N, 3)."""
        return {number: self._visible(number, positions, len(DIRECTIONS)) for number in self.hidden}

    @functools.cached_property
    def hidden(self) -> list[int]:
        """Numbers of the skies that surfaces hide in places."""
        return [
            number
            for number, weight in enumerate(self.weights)
            if weight is not None and not isinstance(weight, PlaceLattice)
        ]

    def _visible(self, sky: int, positions: np.ndarray, number: int) -> np.ndarray:
        """Share float32 (N, D) of a sky's light that reaches positions (N, 3), as for `visible` of D directions."""
        weight = self.weights[sky]
        assert weight is not None and not isinstance(weight, PlaceLattice)
        key = sky, number
        if key not in self._light_parts:
            directions = product(weight.directions, self.rotation)
            shares = np.full(len(directions), 1.0 / len(directions))
            # The light of each pixel counts for the nearest of the directions.
            nearest = product(pixel_directions(ROWS).reshape(-1, 3), directions.T).argmax(axis=1)
            light = self.image[..., sky * self.channels : (sky + 1) * self.channels].mean(axis=2)
            light = np.bincount(nearest, (light * pixel_solid_angles(ROWS)).ravel(), len(directions))
            parts = _balanced(*_sphere(number), directions, shares) * (light + LEAST_LIGHT * light.mean() + 1e-30)
            self._light_parts[key] = (parts / parts.sum(axis=1, keepdims=True)).T.astype(np.float32)
        return product(weight.towards(positions), self._light_parts[key])

    def entering(self, radiance: np.ndarray, cube: Cube) -> list[EnteringLight]:
        """The light of S C channels that enters a cube; radiance: (26, S C), of `ordinate_radiance`."""
        each, shell = np.reshape(radiance, (len(ORDINATES), len(self.weights), -1)), np.ones((FACE,) * 3, bool)
        shell[1:-1, 1:-1, 1:-1] = False
        positions, entering = cube.world((np.argwhere(shell) + 0.5) / FACE - 0.5), []
        for number in range(len(self.weights)):
            visible = None
            if number in self.hidden:
                visible = np.ones((len(ORDINATES), *shell.shape), np.float32)
                visible[:, shell] = self._visible(number, positions, len(ORDINATES)).T
            entering += [EnteringLight(channel, visible) for channel in each[:, number].T / (4.0 * np.pi)]
        return entering


def image_in_frame(environments: Sequence[Environment], rotation: np.ndarray) -> np.ndarray:
    """Sum of environments in a frame that `rotation` (3, 3) turns into the world: float64 (ROWS, 2 ROWS, C).

    C is 1 for grey light, else 3. A pixel is the mean of the light that falls in it; linear in the environments.
    """
    total = np.zeros((ROWS, 2 * ROWS, 3))
    for environment in environments:
        total += _turned(environment, rotation)
    grey = np.ptp(total, axis=2).max(initial=0.0) <= 1e-6 * total.max(initial=0.0)
    return total[..., :1] if grey else total


def _turned(environment: Environment, rotation: np.ndarray) -> np.ndarray:
    """An environment in another frame, (ROWS, 2 ROWS, 3)."""
    image, rows = environment.radiance.astype(np.float64), len(environment.radiance)
    weights = np.broadcast_to(pixel_solid_angles(rows), (rows, 2 * rows))
    block = rows // TURNED_ROWS
    if block > 1:
        # Blocks of pixels; the last ones may be smaller.
        starts, columns = np.arange(0, rows, block), np.arange(0, 2 * rows, block)

        def blocks(values: np.ndarray) -> np.ndarray:
            return np.add.reduceat(np.add.reduceat(values, starts, axis=0), columns, axis=1)

        directions = blocks(pixel_directions(rows) * weights[..., None])
        directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
        image, weights = blocks(image * weights[..., None]), blocks(weights)
        image = image / weights[..., None]
    else:
        block = -(-TURNED_ROWS // rows)
        image = image.repeat(block, axis=0).repeat(block, axis=1)
        directions = pixel_directions(rows * block)
        weights = np.broadcast_to(pixel_solid_angles(rows * block), directions.shape[:2])
    assert environment.world_from_environment is not None
    towards = product(directions.reshape(-1, 3), environment.world_from_environment.T @ rotation)
    row = ((0.5 - np.arcsin(np.clip(towards[:, 2], -1.0, 1.0)) / np.pi) * ROWS).astype(int)
    column = np.floor(np.arctan2(towards[:, 1], towards[:, 0]) * (ROWS / np.pi)).astype(int) % (2 * ROWS)
    pixel = np.clip(row, 0, ROWS - 1) * (2 * ROWS) + column
    weights, count = weights.ravel(), 2 * ROWS * ROWS
    area = np.bincount(pixel, weights, count)
    sums = [np.bincount(pixel, weights * channel, count) for channel in image.reshape(-1, 3).T]
    turned = np.stack(sums, axis=-1) / np.maximum(area, 1e-30)[:, None]
    # Pixels that none falls in take the value of their neighbour.
    for empty in np.flatnonzero(area == 0.0):
        turned[empty] = turned[empty - 1] if empty else turned[np.flatnonzero(area)[0]]
    return turned.reshape(ROWS, 2 * ROWS, 3)


def _directions() -> tuple[np.ndarray, np.ndarray]:
    """Lebedev's quadrature of 50 points (Lebedev and Laikov 1999): unit vectors (50, 3) and weights (50,)."""
    rises = np.array(list(np.ndindex(7, 7, 7))) - 3
    sizes = np.sort(np.abs(rises), axis=1)
    directions, weights = [], []
    for kind, weight in (
        ((0, 0, 1), 4.0 / 315.0),
        ((0, 1, 1), 64.0 / 2835.0),
        ((1, 1, 1), 27.0 / 1280.0),
        ((1, 1, 3), 14641.0 / 725760.0),
    ):
        points = rises[(sizes == kind).all(axis=1)]
        directions.append(points / np.linalg.norm(points, axis=1, keepdims=True))
        weights.append(np.full(len(points), weight))
    return np.concatenate(directions), np.concatenate(weights)


#: Directions (50, 3) in which it is known what is open to a point, and their shares (50,) of the sphere.
DIRECTIONS, DIRECTION_WEIGHTS = _directions()


@functools.lru_cache(maxsize=4)
def _parts(rows: int, number: int) -> np.ndarray:
    """float64 (number, pixels): weights of an image's pixels in the radiance of each of 26 ordinates or 50 directions.

    Sums are 1 for each of them, and for each pixel, weighted as they are, its share of the sphere.
    """
    solid_angle = np.broadcast_to(pixel_solid_angles(rows), (rows, 2 * rows)).ravel() / (4.0 * np.pi)
    return _balanced(*_sphere(number), pixel_directions(rows).reshape(-1, 3), solid_angle)


def _sphere(number: int) -> tuple[np.ndarray, np.ndarray]:
    """The 26 ordinates or 50 directions, and their shares of the sphere."""
    return (ORDINATES, ORDINATE_WEIGHTS) if number == len(ORDINATES) else (DIRECTIONS, DIRECTION_WEIGHTS)


def _balanced(towards: np.ndarray, weights: np.ndarray, directions: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """Weights (D, P) of P directions, of shares (P,) of the sphere, in the light around D ones, of shares (D,).

    Sums are 1 for each of the D, and for each of the P, weighted with those, its share.
    """
    parts = np.exp(SHARPNESS * len(towards) * (product(towards, directions.T) - 1.0)) * shares
    for _ in range(ROUNDS):
        parts *= shares / (weights[:, None] * parts).sum(axis=0)
        parts /= parts.sum(axis=1, keepdims=True)
    return parts


def ordinate_radiance(image: np.ndarray) -> np.ndarray:
    """Radiance float64 (26, C) that arrives from the ordinates, of an image (H, 2H, C) in the cube's frame."""
    return _radiance(image, len(ORDINATES))


def direction_radiance(image: np.ndarray) -> np.ndarray:
    """Radiance float64 (50, C) that arrives from DIRECTIONS, of an image (H, 2H, C) in the cube's frame."""
    return _radiance(image, len(DIRECTIONS))


def _radiance(image: np.ndarray, number: int) -> np.ndarray:
    rows = len(image)
    return product(_parts(rows, number), image.reshape(2 * rows * rows, -1).astype(np.float64))


def solve_environment(
    coarse: np.ndarray,
    sigma_hat: float,
    anisotropy: float,
    entering: Sequence[EnteringLight],
    triangles: np.ndarray | None = None,
    cancel: CancelToken = NEVER,
) -> tuple[np.ndarray, np.ndarray]:
    """Lattices of the fluence and flux over 4 pi of an environment's light, as `environment_lattice`.

    First of its C channels, those that are not visible everywhere solved on larger cells. Then, on cells twice as
    large, of a medium of each of ALBEDOS, with the C channels and even light of radiance 1: (34, 34, 34, 4 ALBEDOS
    (C + 1)). coarse: a level of the density pyramid, float32 (x, y, z). sigma_hat: extinction per unit density times
    the cube's edge. entering: radiance over 4 pi of each channel; none for light that is even itself.
    triangles: (T, 3, 3), in the cube's frame, of surfaces that end the light of channels which are not visible
    everywhere, or None. Raises Cancelled.
    """

    def solve(density: np.ndarray, albedo: float, channels: Sequence[EnteringLight]) -> list[np.ndarray]:
        """Fluence and flux (4, n, n, n) of each channel."""
        solvers: dict[bool, DiscreteOrdinates] = {}
        solved = []
        for channel in channels:
            hidden = channel.visible is not None
            if hidden not in solvers:
                ends = triangles if hidden else None
                solvers[hidden] = DiscreteOrdinates(density, sigma_hat, anisotropy, ends, albedo)
            boundaries, light = solvers[hidden].boundaries, solvers[hidden].solve(channel, cancel)
            if boundaries is not None and boundaries.inside.any():
                light = np.stack([boundaries.extrapolate_inside(values) for values in light]).astype(np.float32)
            solved.append(light)
        return solved

    even = EnteringLight(np.full(len(ORDINATES), 1.0 / (4.0 * np.pi)))
    coarser = np.empty([n // 2 for n in coarse.shape], np.float32)
    halve(np.ascontiguousarray(coarse), coarser)
    hidden = [channel for channel in entering if channel.visible is not None]
    shaded = (np.stack([doubled(values) for values in light]) for light in solve(coarser, 1.0, hidden))
    even_light = iter(solve(coarse, 1.0, [channel for channel in entering if channel.visible is None]))
    light = [next(even_light if channel.visible is None else shaded) for channel in entering]
    absorbed = [values for albedo in ALBEDOS for values in solve(coarser, albedo, [*entering, even])]
    stacked = np.stack(light, axis=1) if light else np.empty((4, 0, *coarse.shape), np.float32)
    return environment_lattice(stacked), environment_lattice(np.stack(absorbed, axis=1))


def reaching(
    lattices: tuple[np.ndarray, np.ndarray], shares: Callable[[np.ndarray], np.ndarray], count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Lattices of C channels of the light of several skies that reach places differently.

    lattices: of `solve_environment`, of each sky's C channels. shares: gives those (N, count) of the skies at positions
    (N, 3) in the cube's frame.
    """
    light, absorbed = lattices
    own = np.einsum("nksc,ns->nkc", light.reshape(light[..., 0].size, 4, count, -1), shares(_places(len(light))))
    # The last channel is of even light, which no surface hides.
    parts = absorbed.reshape(absorbed[..., 0].size, 4 * len(ALBEDOS), -1)
    seldom = parts[..., :-1].reshape(*parts.shape[:2], count, -1)
    seldom = np.einsum("nksc,ns->nkc", seldom, shares(_places(len(absorbed))))
    seldom = np.concatenate([seldom, parts[..., -1:]], axis=2)
    return own.reshape(*light.shape[:3], -1), seldom.reshape(*absorbed.shape[:3], -1)


def _places(size: int) -> np.ndarray:
    """Positions (size^3, 3), in the cube's frame, of the cells of a lattice, the outermost cells repeated once."""
    n = size - 2
    along = (np.arange(size) - 0.5).clip(0.5, n - 0.5) / n - 0.5
    return np.stack(np.meshgrid(along, along, along, indexing="ij"), axis=-1).reshape(-1, 3)


def environment_lattice(light: np.ndarray) -> np.ndarray:
    """Fluence and flux float32 (n + 2, n + 2, n + 2, 4 C) of C channels, the outermost cells repeated once.

    light: float32 (4, C, n, n, n), of `DiscreteOrdinates.environment`.
    """
    n = light.shape[-1]
    cells = np.moveaxis(light, (0, 1), (3, 4)).reshape(n, n, n, light.shape[0] * light.shape[1])
    return np.pad(cells, [(1, 1)] * 3 + [(0, 0)], mode="edge")


def read_lattice(lattice: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Trilinear values float32 (N, k) of a lattice (n + 2, n + 2, n + 2, k) at positions (N, 3) in the cube's frame."""
    if not lattice.shape[-1]:
        return np.empty((len(positions), 0), np.float32)
    size = len(lattice)
    index = np.clip((positions + 0.5) * (size - 2) + 0.5, 0.0, size - 1 - 1e-3).astype(np.float32)
    cell = index.astype(np.int32)
    fx, fy, fz = (index - cell).T[:, :, None]
    base = (cell[:, 0] * np.intp(size) + cell[:, 1]) * size + cell[:, 2]
    flat = lattice.reshape(-1, lattice.shape[-1])

    def along_z(offset: int) -> np.ndarray:
        low = flat.take(base + offset, axis=0).astype(np.float32, copy=False)
        high = flat.take(base + (offset + 1), axis=0).astype(np.float32, copy=False)
        high -= low
        high *= fz
        low += high
        return low

    def along_y(offset: int) -> np.ndarray:
        low, high = along_z(offset), along_z(offset + size)
        high -= low
        high *= fy
        low += high
        return low

    low, high = along_y(0), along_y(size * size)
    high -= low
    high *= fx
    low += high
    return low
