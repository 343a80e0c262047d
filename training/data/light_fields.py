# SPDX-License-Identifier: GPL-3.0-or-later
"""The coarse transport of lights of every kind, solved for the albedo as it is, on cells that features are read from.

Everything is in the frame of the volume's cube, [-1/2, 1/2]^3. The transport is that of
`inference.transport.discrete_ordinates`, in which the forward peak of the phase function counts as unscattered.
"""

from dataclasses import dataclass

import numpy as np

from inference import Volume
from inference.environments.environment_light import ordinate_radiance
from inference.features.mip_lattices import density_pyramid
from inference.grids.grid import Grid
from inference.grids.working_cube import Cube, mean_density
from inference.marching.lamp_in_media import COARSE as LAMP_EMITTERS
from inference.marching.lamp_in_media import lamp_key
from inference.runtime.cancellation import NEVER
from inference.source_terms.cell_sources import LampBeam, SunBeam
from inference.source_terms.lamp_beam import LampInCube
from inference.transport.discrete_ordinates import DiscreteOrdinates
from inference.transport.radiance_sweep import sweep_radiance
from training.data.light_scene import LightScene
from training.tracer.light_paths import AlbedoField, LitMedium

#: Levels of the density pyramid: of the transport's cells, and of those that rays read.
COARSE, FINE = 2, 1
#: Directions along an edge of a cube's face, for light that is emitted.
FACE = 6
#: Sweeps of the light of environments and emission, which end where a smaller fraction of it changes.
SWEEPS, CONVERGED = 8, 2e-3
#: Least albedo that the transport is solved for.
LEAST_ALBEDO = 1e-3


@dataclass(frozen=True)
class Cells:
    """What a scene's transport and features read.

    volume, cube: the density as a volume, and its working cube. density: float32 (128, 128, 128). coarse: float32
    (64, 64, 64). emission: float32 (64, 64, 64, E), radiance per cube edge. masks: of each medium's albedo,
    (64, 64, 64), or None.
    """

    volume: Volume
    cube: Cube
    density: np.ndarray
    coarse: np.ndarray
    emission: np.ndarray
    masks: list[np.ndarray | None]

    @classmethod
    def of(cls, scene: LightScene) -> "Cells":
        """The cells of a scene, by means of its fields over them."""
        count = len(scene.density)
        world = np.diag([1.0 / count] * 3 + [1.0])
        world[:3, 3] = 0.5 / count - 0.5
        cube = Cube(np.eye(3), np.zeros(3), 1.0, np.zeros(3, int), np.full(3, count))

        def pyramid(values: np.ndarray) -> list[np.ndarray]:
            return density_pyramid(mean_density(Volume(np.ascontiguousarray(values, np.float32), world), cube))

        levels = pyramid(scene.density)
        coarse, masks = levels[COARSE], []
        for medium in scene.media:
            mask = medium.albedo.mask
            if mask is not None:
                weighted = pyramid(mask * scene.density)[COARSE]
                mask = np.clip(weighted / np.maximum(coarse, 1e-12), 0.0, 1.0) * (coarse > 0.0)
            masks.append(mask)
        emission = [pyramid(field)[COARSE] for field in np.moveaxis(scene.lights.emission, 3, 0)]
        return cls(Volume(scene.density, world), cube, levels[FINE], coarse, np.stack(emission, axis=3), masks)


class _Ordinates(DiscreteOrdinates):
    """Also tells light that has scattered from light that has not."""

    def entering(self, radiance: np.ndarray) -> np.ndarray:
        """Fluence and flux, float32 (4, x, y, z), of an environment's unscattered light; radiance: (26,)."""
        fields = self._fields()
        follow = self.sweeps.followers(fields.source, fields.swept, entering=np.asarray(radiance, np.float32))
        self._sweep(fields, follow, NEVER)
        return fields.swept

    def emitted(self, emission: np.ndarray) -> np.ndarray:
        """Fluence and flux, float32 (4, x, y, z), of unscattered emitted light; emission: (x, y, z), per cube edge."""
        # On cells twice as large: many directions matter more.
        extinction, given = (self.means(np.ascontiguousarray(values)) for values in (self.extinction, emission))
        terms = extinction.astype(np.float64), given.astype(np.float64)
        fluence, flux = sweep_radiance(*terms, 1.0 / len(given), FACE)
        return np.stack([self._finer(values.astype(np.float32)) for values in (fluence, *flux)])

    def scattered(self, first: np.ndarray) -> np.ndarray:
        """Fluence and flux, float32 (4, x, y, z), of the light that has scattered; first: of that which has not."""
        fields, again = self._fields(), np.zeros((5, *first.shape[1:]), np.float32)
        follow = self.sweeps.followers(fields.source, fields.swept)
        for number in range(SWEEPS):
            np.add(first, again[:4], out=fields.field[:4])
            self._bound(fields.field)
            self._sweep(fields, follow, NEVER)
            change = self._newly_scattered(fields.swept, again)
            again[:4] = fields.swept
            most = CONVERGED * (self.extinction * (again[0] + first[0])).sum()
            if number == SWEEPS - 1 or np.abs(change).sum() <= most:
                break
            self._correct(again, change, NEVER)
        return again[:4]


class Transport:
    """Solves the light of one scene in its media."""

    def __init__(self, scene: LightScene, cells: Cells) -> None:
        self.lights, self.cells = scene.lights, cells
        self._grid, self._lamps = Grid(cells.volume), {}

    def solve(self, medium: LitMedium, mask: np.ndarray | None, light: int, channel: int) -> np.ndarray:
        """Of a light, by its number in `Lights`, for one channel of a medium's albedo: float32 (8, 64, 64, 64).

        Fluence and flux of the light that has scattered, and of the unscattered light of environments and emission,
        which is 0 of suns and lamps. mask: of `Cells`.
        """
        lights, albedo = self.lights, np.maximum(albedo_of(medium.albedo, channel, mask), LEAST_ALBEDO)
        solver = _Ordinates(
            self.cells.coarse, medium.sigma, medium.anisotropy, albedo=float(albedo) if mask is None else albedo
        )
        out = np.zeros((8, *self.cells.coarse.shape), np.float32)
        if light < len(lights.suns):
            out[:4] = solver.solve(SunBeam(lights.suns[light]))
            return out
        light -= len(lights.suns)
        if light < len(lights.lamps):
            out[:4] = solver.solve(LampBeam([(self._lamp(light), 1.0)]))
            return out
        light -= len(lights.lamps)
        if light < len(lights.environments):
            image = lights.environments[light].astype(np.float64)
            out[4:] = solver.entering(ordinate_radiance(image[..., None])[:, 0])
        else:
            out[4:] = solver.emitted(self.cells.emission[..., light - len(lights.environments)])
        out[:4] = solver.scattered(out[4:])
        np.maximum(out[0], 0.0, out=out[0])
        return out

    def _lamp(self, number: int) -> LampInCube:
        if number not in self._lamps:
            lamp, corners = self.lights.lamps[number], self._grid.corners()
            emitters = lamp.emitters(corners.min(axis=0), corners.max(axis=0), LAMP_EMITTERS)
            self._lamps[number] = LampInCube(emitters, self.cells.cube, None, lamp_key(lamp, [self._grid]), lamp.centre)
        return self._lamps[number]


def albedo_of(albedo: AlbedoField, channel: int, mask: np.ndarray | None) -> np.ndarray | float:
    """Albedo of a channel on the cells of a mask, or everywhere."""
    low, high = float(albedo.low[channel]), float(albedo.high[channel])
    return low if mask is None else (low + mask * (high - low)).astype(np.float32)
