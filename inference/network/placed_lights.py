# SPDX-License-Identifier: GPL-3.0-or-later
"""Lights as a volume's predictor is asked for them: of strength 1, with what shadows them, beside its working cube."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..environments.environment_light import Skies, image_in_frame, ordinate_radiance
from ..features.final_gather import shadowed_depth, unit_sun_depth
from ..grids.lamp_optical_depth import DIRECTIONS, RADII
from ..grids.sphere_depth import start_depths
from ..grids.working_cube import Cube
from ..marching.joined_lamps import PredictedLamp
from ..marching.lamp_in_media import softened
from ..numerics.alike import alike_vector
from ..occluders.occluders import NO_OCCLUDERS, Occluders
from ..occluders.shadow_map import ShadowMap
from ..runtime.cancellation import NEVER, CancelToken
from ..scene.description import Sun
from ..scene.environment import Environment
from ..source_terms.cell_sources import EnteringLight, LampBeam, SunBeam
from ..source_terms.lamp_beam import CubeCells, LampInCube, directions_to
from ..source_terms.nearby_light import NearbyMedium, nearby_light
from ..transport.discrete_ordinates import DiscreteOrdinates
from ..transport.scattered_fluence import FluenceLattice
from .conditions import Bounds
from .lamp_nearby import NearLamp, SoftStart, transport_share

# Sample points along an edge of a cell of the coarse transport for the visibility of the sun.
VISIBILITY_SAMPLES = 3
# Distance from a lamp within which its light that turned by small angles is not told apart, over that of the transport.
FORWARD_RADIUS = 0.25


@dataclass(frozen=True)
class PlacedSun:
    """A sun of irradiance 1; a `PredictedLight`."""

    sun: Sun
    cube: Cube
    occluders: Occluders = NO_OCCLUDERS
    any_thickness, albedos, near = False, (), None

    @property
    def key(self) -> Hashable:
        """As of PlacedLight."""
        direction = alike_vector(self.direction)
        if self.shadow_map is None and not self.sun.screen_key:
            return (direction,)
        return direction, self.sun.screen_key, self.cube.key

    @cached_property
    def direction(self) -> np.ndarray:
        """As of PlacedLight."""
        return self.cube.directions(self.sun.direction)

    @cached_property
    def shadow_map(self) -> ShadowMap | None:
        """As of PredictedLight."""
        world_map = self.occluders.shadow_map(self.sun)
        return world_map and world_map.transformed(self.cube.rotation * self.cube.edge, self.cube.centre)

    def source(self, cells: int) -> SunBeam:
        """As of PlacedLight."""
        if self.shadow_map is None:
            return SunBeam(self.direction)
        return SunBeam(self.direction, self.shadow_map.cell_visibility(cells, parts=VISIBILITY_SAMPLES))

    def scale(self, fluence: np.ndarray) -> float:
        """1, as its irradiance is."""
        return 1.0

    def irradiance(self, positions: np.ndarray) -> np.float32:
        """As of PredictedLight."""
        return np.float32(1.0)

    def towards(self, positions: np.ndarray) -> np.ndarray:
        """As of PredictedLight."""
        return self.direction

    def unit_depth(self, cells: CubeCells, cancel: CancelToken = NEVER) -> tuple[np.ndarray, float]:
        """As of PredictedLight."""
        depth = unit_sun_depth(cells.density, self.direction)
        if self.shadow_map is not None:
            depth = shadowed_depth(depth, self.shadow_map.cell_visibility(len(depth)), cells.sigma)
        return depth, 1.0


@dataclass(frozen=True)
class PlacedLamp:
    """A lamp of power 1; a `PredictedLight`.

    radius: by which its light is softened. apart: whether what rays gather of each lamp is told apart.
    """

    lamp: PredictedLamp
    cube: Cube
    radius: float
    albedos: Sequence[float] = ()
    any_thickness, shadow_map, apart = False, None, False

    @property
    def near(self) -> "PlacedLamps":
        """As of PredictedLight."""
        return PlacedLamps([self], [1.0], self.albedos)

    @property
    def key(self) -> Hashable:
        """As of PlacedLight."""
        return self.lamp.key, self.radius, self.cube.key

    @cached_property
    def beam(self) -> LampInCube:
        """What the coarse transport takes in."""
        lamp = self.lamp
        return LampInCube(lamp.coarse, self.cube, lamp.coarse_shadow_maps, lamp.key, lamp.centre, lamp.count)

    @property
    def direction(self) -> np.ndarray:
        """From the middle of the cube."""
        away = self.cube.directions(self.lamp.centre - self.cube.centre)
        length = np.linalg.norm(away)
        return away / length if length > 1e-9 else np.array([0.0, 0.0, 1.0])

    def source(self, cells: int) -> LampBeam:
        """As of PlacedLight."""
        return LampBeam([(self.beam, 1.0)])

    def scale(self, fluence: np.ndarray) -> float:
        """As of PredictedLight."""
        return max(float(fluence.max()), 1e-30)

    def irradiance(self, positions: np.ndarray) -> np.ndarray:
        """As of PredictedLight."""
        return softened(self.lamp.reference(positions), self.radius)

    def shares(self, positions: np.ndarray) -> np.ndarray:
        """Fractions float32 (N, n) of the light at world positions (N, 3) that each lamp gives, without attenuation."""
        return self.lamp.shares(positions)

    def towards(self, positions: np.ndarray) -> np.ndarray:
        """As of PredictedLight."""
        return directions_to(self.beam.place, positions)

    def unit_depth(self, cells: CubeCells, cancel: CancelToken = NEVER) -> tuple[np.ndarray, float]:
        """As of PredictedLight."""
        return self.beam.unit_depth(cells, cancel)

    def soft_start(self, sigma_hat: float, density: FluenceLattice) -> SoftStart | None:
        """Where the light of a soft falloff starts to be scattered, or None. density: of the coarse cells."""
        source = self.beam.emitters[0].source
        if not source.soft_falloff or source.radius == 0.0:
            return None
        radius = source.radius / self.cube.edge
        middle, away = self.cube.positions(source.centre[None])[0], DIRECTIONS[:, :, None] * (radius * RADII)
        around = float(density.values(middle + away.reshape(3, -1).T).mean())
        return SoftStart(radius, around, start_depths(around * radius * sigma_hat))


@dataclass(frozen=True)
class PlacedLamps:
    """Lamps of power 1, each times a factor, in one cube; a `PredictedLight`.

    Where they are near a volume or inside it, the coarse transport is their multiple scattering itself.
    """

    lamps: Sequence[PlacedLamp]
    powers: Sequence[float]
    albedos: Sequence[float] = ()
    any_thickness, shadow_map, apart = False, None, True

    @property
    def near(self) -> "PlacedLamps":
        """As of PredictedLight."""
        return self

    @property
    def cube(self) -> Cube:
        """As of PlacedLight."""
        return self.lamps[0].cube

    @property
    def key(self) -> Hashable:
        """As of PlacedLight."""
        return tuple(lamp.key for lamp in self.lamps), tuple(self.powers)

    @property
    def direction(self) -> np.ndarray:
        """As of PlacedLight, towards the first."""
        return self.lamps[0].direction

    def source(self, cells: int) -> LampBeam:
        """As of PlacedLight."""
        return LampBeam([(lamp.beam, power) for lamp, power in zip(self.lamps, self.powers)])

    def scale(self, fluence: np.ndarray) -> float:
        """As of PredictedLight."""
        return self.lamps[0].scale(fluence)

    def irradiance(self, positions: np.ndarray) -> np.ndarray:
        """As of PredictedLight."""
        return self._irradiances(positions).sum(axis=1)

    def shares(self, positions: np.ndarray) -> np.ndarray:
        """As of PlacedLamp."""
        given = self._irradiances(positions)
        return (given / np.maximum(given.sum(axis=1), 1e-300)[:, None]).astype(np.float32)

    def _irradiances(self, positions: np.ndarray) -> np.ndarray:
        return np.stack([power * lamp.irradiance(positions) for lamp, power in zip(self.lamps, self.powers)], axis=1)

    def towards(self, positions: np.ndarray) -> np.ndarray:
        """As of PredictedLight, to the first."""
        return self.lamps[0].towards(positions)

    def unit_depth(self, cells: CubeCells, cancel: CancelToken = NEVER) -> tuple[np.ndarray, float]:
        """As of PredictedLight, of the first."""
        return self.lamps[0].unit_depth(cells, cancel)

    def transport_share(self, extent: Bounds) -> float:
        """Share of the coarse transport alone in their multiple scattering in a box, 0 to 1."""
        return min(transport_share(lamp.beam.place, *extent) for lamp in self.lamps)

    def nearby(self, solver: DiscreteOrdinates, medium: NearbyMedium, cancel: CancelToken = NEVER) -> np.ndarray:
        """As `source_terms.nearby_light`. Raises Cancelled."""
        return nearby_light(
            solver, medium, [(lamp.beam, power) for lamp, power in zip(self.lamps, self.powers)], cancel
        )

    def seen(self, sigma_hat: float, density: FluenceLattice) -> list[NearLamp]:
        """The lamps as points see them. density: of the coarse cells."""
        return [
            NearLamp(lamp.lamp.emitters, power, lamp.beam.place, lamp.soft_start(sigma_hat, density))
            for lamp, power in zip(self.lamps, self.powers)
        ]

    @property
    def radius(self) -> float:
        """In the world, within which light that turned by small angles is not told apart."""
        return FORWARD_RADIUS * self.lamps[0].radius


@dataclass(frozen=True)
class PlacedSkies:
    """Light of environments together, of which surfaces have taken what they hide; a `PlacedLight`."""

    environments: Sequence[Environment]
    cube: Cube
    any_thickness, direction = True, np.array([0.0, 0.0, 1.0])

    @cached_property
    def skies(self) -> Skies:
        """What places see of it."""
        return Skies.of(self.environments, self.cube.rotation)

    @cached_property
    def ordinates(self) -> np.ndarray:
        """Mean radiance (26,) of its colours, which differ little in where they come from, compared to albedos."""
        return ordinate_radiance(image_in_frame(self.environments, self.cube.rotation)).mean(axis=1)

    @property
    def key(self) -> Hashable:
        """As of PlacedLight."""
        return self.ordinates.tobytes()

    def source(self, cells: int) -> EnteringLight:
        """As of PlacedLight."""
        return EnteringLight(self.ordinates)
