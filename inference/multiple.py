"""Predicted multiple scattering: one volume and the system that predicts in it."""

import numpy as np

from .cube import fit_cube
from .grid import Grid
from .march import light_at
from .network import load_network
from .phase import henyey_greenstein
from .plan import distinct_albedos, in_range
from .scene import Medium, Volume

# Points a network call.
POINTS_A_TASK = 2048
# Deep in a conservative half-space, a beam of irradiance 1 that meets it head-on makes this fluence:
# sqrt(3) H(1), with Chandrasekhar's H-function. No cloud holds more of one sun's light.
FLUENCE_MOST = 5.04


class MultipleField:
    """Everything that predicts multiple scattering in one volume, for one extinction and sun.

    system: what `load_network` gives. check: asked often while the field is made. Outside the range of optical density
    that it was made for, the prediction is that at the range's end: scaled down in proportion below it, where multiple
    scattering is linear in density, and held above it. Outside the ranges of anisotropy and albedo the nearest value is
    used.
    No prediction exceeds what the largest fluence that one sun can make, all of it arriving where the
    phase function is largest, would give.
    """

    def __init__(self, system, volume: Volume, medium: Medium, check=lambda: None):
        self.system, self.volume, self.medium = system, volume, medium
        self.cube = fit_cube(volume)
        self.anisotropy = float(np.clip(medium.anisotropy, *system.anisotropy_range))
        self.field = system.field(volume, self.cube, self.anisotropy, check)
        self.built, self.obstacles = None, None
        peak = max(henyey_greenstein(1.0, self.anisotropy), henyey_greenstein(-1.0, self.anisotropy))
        self.most = np.float32(FLUENCE_MOST * peak)

    def warnings(self, sigma_t: float):
        found = []
        if self.obstacles and not hasattr(self.field, "meet"):
            found.append(f"{self.volume.name}: the network {self.system.name} does not know of surfaces")
        if self.anisotropy != self.medium.anisotropy:
            found.append(
                f"{self.volume.name}: anisotropy {self.medium.anisotropy:g} is outside the network's range; "
                f"multiple scattering uses {self.anisotropy:g}"
            )
        for albedo, _ in distinct_albedos(self.medium, [0, 1, 2]):
            used = float(np.clip(albedo, *self.system.albedo_range))
            if used != albedo:
                found.append(
                    f"{self.volume.name}: albedo {albedo:g} is outside the network's range; "
                    f"multiple scattering uses {used:g}"
                )
        peak = self.peak_sigma_hat(sigma_t)
        if peak > self.system.sigma_hat_range[1]:
            found.append(
                f"{self.volume.name}: optical density {peak:.3g} is beyond the network's range of "
                f"{self.system.sigma_hat_range[1]:g}; multiple scattering is less accurate"
            )
        return found

    def peak_sigma_hat(self, sigma_t: float) -> float:
        return sigma_t * self.cube.edge * float(self.volume.density.max())

    def bounds(self, positions: np.ndarray):
        """Lowest and highest coordinates (3,) in the cube's frame of world positions (N, 3)."""
        points = self.cube.positions(positions)
        return points.min(axis=0), points.max(axis=0)

    def extent(self):
        """As `bounds`, of all points at which the density is above 0."""
        ends = zip(self.cube.low - 1.0, self.cube.high * 1.0)
        corners = np.array(np.meshgrid(*ends, indexing="ij")).reshape(3, -1)
        matrix = self.volume.world_from_index
        return self.bounds((matrix[:3, :3] @ corners + matrix[:3, 3:]).T)

    def meet(self, obstacles) -> None:
        """Know surfaces, `Obstacles` or None, for what is prepared from now on."""
        if self.obstacles.alike(obstacles) if self.obstacles else not obstacles:
            return
        self.obstacles, self.built = obstacles, None
        if not hasattr(self.field, "meet"):
            return
        known, triangles = {}, np.zeros((0, 3, 3))
        if obstacles:
            triangles = self.cube.positions(obstacles.triangles)
            for direction, sun_map in zip(obstacles.directions, obstacles.sun_maps or ()):
                known[tuple(self.cube.directions(direction))] = sun_map.seen_from(
                    self.cube.rotation * self.cube.edge, self.cube.centre)
        self.field.meet(known, triangles)

    def light(self, sigma_t: float, direction: np.ndarray, low, high, mapper=map):
        """Prepare for one sun and the points between `low` and `high`, from `bounds`.

        direction: (3,) in the world; mapper: `map`, or an executor's. Does nothing where the last call was the same.
        """
        asked = (sigma_t, *direction, *low, *high)
        if self.built == asked:
            return
        self.built = None
        self.used = self._used(sigma_t)
        self.scale = np.float32(min(1.0 / self.used, 1.0))
        sigma_hat = sigma_t * self.cube.edge * self.used
        self.field.light(sigma_hat, self.cube.directions(direction), low, high, mapper)
        self.built = asked

    def cells(self) -> int:
        """Of the lookup fields that are prepared; 0 for systems that have none."""
        lattices = getattr(self.field, "lattices", None)
        return 0 if lattices is None else lattices.values.size

    def diffused_light(self, sigma_t: float, directions, mapper=map):
        """What camera rays look up for systems that need light; directions: (3,) each, in the world, of all suns."""
        sigma_hat = sigma_t * self.cube.edge * self._used(sigma_t)
        return self.field.diffused_light(sigma_hat, [self.cube.directions(d) for d in directions], mapper)

    def _used(self, sigma_t: float) -> float:
        """The optical density that the system is asked for, over the true one."""
        peak = self.peak_sigma_hat(sigma_t)
        return float(np.clip(peak, *self.system.sigma_hat_range)) / peak

    def predict(self, positions, directions, albedos, jitter=None, light=None) -> np.ndarray:
        """float32 (A, N) at world positions (N, 3) for camera rays along directions (N, 3).

        jitter: (N, 3) in [-1/2, 1/2), by which the points' lookups are moved, in cells. light: float32 (N, COLUMNS)
        as RayLight gives it, for systems that need it.
        """
        x, omega = self.cube.positions(positions), self.cube.directions(directions)
        albedos = np.clip(albedos, *self.system.albedo_range)
        if light is not None and self.used != 1.0:
            # Where the optical density is outside the system's range, the light is that of the density used: depths
            # are in proportion to it, and so is what little a thin medium scatters.
            light = np.concatenate([light[:, :2] * self.used, light[:, 2:] * max(self.used, 1.0)], axis=1)
        return np.minimum(self.field.predict(x, omega, albedos, jitter, light), self.most) * self.scale


def predict_multiple(volume, medium, sun, positions, directions, model="mrpnn") -> np.ndarray:
    """Multiple-scattered in-scattered radiance at points, as the network sees it.

    positions, directions: (N, 3) world positions and unit camera-ray directions.
    Returns float32 (N, 3), W/(m^2 sr) for the sun's irradiance; the pixel's albedo factor is not included.
    Raises SceneError as `render` does.
    """
    positions = np.asarray(positions, np.float64).reshape(-1, 3)
    directions = np.asarray(directions, np.float64).reshape(-1, 3)
    result = np.zeros((len(positions), 3), np.float32)
    if not len(positions):
        return result
    system = load_network(model)
    volume, medium = in_range(volume, medium)
    field = MultipleField(system, volume, medium)
    grid = Grid(volume)
    grid.add_sun(sun.direction)
    for sigma_t in np.unique(medium.sigma_t[medium.sigma_t > 0.0]):
        members = [c for c in range(3) if medium.sigma_t[c] == sigma_t]
        albedos = distinct_albedos(medium, members)
        if not albedos:
            continue
        field.light(float(sigma_t), sun.direction, *field.bounds(positions))
        grid.set_extinction(float(sigma_t))
        diffused = field.diffused_light(float(sigma_t), [sun.direction]) if system.needs_light else None
        for i in range(0, len(positions), POINTS_A_TASK):
            span = slice(i, i + POINTS_A_TASK)
            light = None
            if system.needs_light:
                seen = light_at(grid, float(sigma_t), positions[span], directions[span], diffused)
                light = seen.of(slice(None), 0, 0)
            radiance = field.predict(positions[span], directions[span], [a for a, _ in albedos], light=light)
            for (_, channels), row in zip(albedos, radiance):
                for c in channels:
                    result[span, c] = row * sun.irradiance[c]
    return result
