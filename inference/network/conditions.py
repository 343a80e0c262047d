# SPDX-License-Identifier: GPL-3.0-or-later
"""The conditions under which the multiple scattering of a volume is predicted, and the points that it is asked at."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Generic, Protocol, TypeVar

import numpy as np

from ..grids.working_cube import Cube
from ..numerics.alike import alike
from ..occluders.shadow_map import ShadowMap
from ..runtime.cancellation import NEVER, CancelToken
from ..source_terms.lamp_beam import CubeCells
from ..transport.discrete_ordinates import CellSource

if TYPE_CHECKING:
    from .placed_lights import PlacedLamps

# Lowest and highest coordinates (3,).
Bounds = tuple[np.ndarray, np.ndarray]


class PlacedLight(Protocol):
    """A light of strength 1 beside a volume's working cube, in whose frame all is given. Immutable."""

    @property
    def key(self) -> Hashable:
        """Equal for lights that are alike."""

    @property
    def cube(self) -> Cube:
        """The working cube."""

    @property
    def any_thickness(self) -> bool:
        """Whether it is predicted in any optical thickness, not only in the range of the network for suns."""

    @property
    def direction(self) -> np.ndarray:
        """Unit vector (3,) towards it, which gives the stencil a frame."""

    def source(self, cells: int) -> CellSource:
        """What lights the coarse transport on so many cells along an edge."""


class PredictedLight(PlacedLight, Protocol):
    """A light that comes to each point from about one direction, which the network for suns predicts."""

    @property
    def albedos(self) -> Sequence[float]:
        """Distinct ones of the medium, for which the coarse transport is solved where it alone is the light."""

    @property
    def shadow_map(self) -> ShadowMap | None:
        """Of surfaces, for parallel light; or None."""

    def scale(self, fluence: np.ndarray) -> float:
        """What its scattered light is held over: the brightest cell's fluence is that of a sun of irradiance 1."""

    def irradiance(self, positions: np.ndarray) -> np.ndarray | np.float32:
        """Irradiance (N,) at world positions (N, 3), without what lies in between."""

    def towards(self, positions: np.ndarray) -> np.ndarray:
        """Unit vectors (N, 3) to the light from positions (N, 3), or one (3,) that serves all of them."""

    def unit_depth(self, cells: CubeCells, cancel: CancelToken = NEVER) -> tuple[np.ndarray, float]:
        """As of LampInCube. Raises Cancelled."""

    @property
    def near(self) -> "PlacedLamps | None":
        """The same, if it may be near a volume or inside it."""


AnyLight = TypeVar("AnyLight", bound=PlacedLight, covariant=True)


@dataclass(frozen=True)
class Conditions(Generic[AnyLight]):
    """One optical thickness and one light, in the frame of a volume's working cube.

    sigma_hat: extinction per unit density times the cube's edge. triangles: (T, 3, 3) of black surfaces, in the cube's
    frame, or None. occluders: `Occluders.key` of those that triangles and the light's shadows stand for. albedo: for
    which the coarse transport alone is the light, None where networks predict it.
    """

    sigma_hat: float
    light: AnyLight
    triangles: np.ndarray | None = None
    occluders: bytes = b""
    albedo: float | None = None

    @property
    def key(self) -> Hashable:
        """Equal for conditions with equal light in the coarse transport, in any instance of a volume."""
        return alike(self.sigma_hat), self.light.key, self.surfaces_key, self.albedo

    @property
    def surfaces_key(self) -> tuple[bytes, ...]:
        """Equal for conditions with equal surfaces, in any instance of a volume."""
        return (self.occluders,) if self.triangles is None else (self.occluders, self.light.cube.key)


#: Of a light that the network for suns predicts.
LitConditions = Conditions[PredictedLight]


@dataclass(frozen=True)
class RayPoints:
    """N points along camera rays.

    positions: (N, 3). directions: (N, 3), unit vectors along the rays. jitter: (N, 3) in [-1/2, 1/2), offset of each
    point's lookups in cells, or None. ray_features: float32 (N, COLUMNS) of `RayFeatures`, None for networks that need
    none. irradiance: (N,), or the same everywhere, of a light of strength 1, over which the ray features are given.
    lamp_depths: float32 (K, N), optical depths towards each of the lamps near a volume, or None.
    """

    positions: np.ndarray
    directions: np.ndarray
    jitter: np.ndarray | None = None
    ray_features: np.ndarray | None = None
    irradiance: np.ndarray | np.float32 = np.float32(1.0)
    lamp_depths: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.positions)

    def in_cube(self, cube: Cube) -> "RayPoints":
        """The same points in the cube's frame, of points of the world."""
        return replace(self, positions=cube.positions(self.positions), directions=cube.directions(self.directions))

    def thickened(self, factor: float) -> "RayPoints":
        """The same points with the ray features of so many times the optical thickness.

        Depths are proportional to it, and so is the little light that a thin medium scatters.
        """
        ray = self.ray_features
        if ray is None or factor == 1.0:
            return self
        return replace(self, ray_features=np.concatenate([ray[:, :2] * factor, ray[:, 2:] * max(factor, 1.0)], axis=1))
