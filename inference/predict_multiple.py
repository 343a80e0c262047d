# SPDX-License-Identifier: GPL-3.0-or-later
"""What networks predict at single points, without a picture."""

from collections.abc import Callable

import numpy as np

from .grids.bound_medium import BoundMedium
from .grids.grid import Grid
from .marching.lamp_in_media import LampInMedia, place_lamp
from .marching.marcher import ray_features_at
from .marching.ray_march import LampMarch
from .network.network import load_network
from .network.predictor import POINTS_PER_TASK, Bounds, VolumePredictor
from .network.prepared_predictors import LampLight, PreparedLampPredictor, PreparedPredictor
from .network.ray_points import RayPoints
from .plan.lights import LAMP_MODELS
from .plan.plan import distinct_albedos
from .plan.precision import in_range
from .scene.description import Medium, Sun, Volume
from .scene.errors import SceneError
from .scene.lamps import Lamp


def predict_multiple(
    volume: Volume,
    medium: Medium,
    light: Sun | Lamp,
    positions: np.ndarray,
    directions: np.ndarray,
    model: str = "mrpnn",
) -> np.ndarray:
    """Multiple-scattered in-scattered radiance at points, as the network predicts it.

    light: a Sun, PointLight, SpotLight or AreaLight. positions, directions: (N, 3) world positions and unit camera-ray
    directions. Returns float32 (N, 3), W/(m^2 sr) for the light's irradiance or power, without the factor of the local
    albedo. Raises SceneError as `render` does, and for a lamp and a network that knows suns alone.
    """
    positions = np.asarray(positions, np.float64).reshape(-1, 3)
    directions = np.asarray(directions, np.float64).reshape(-1, 3)
    result = np.zeros((len(positions), 3), np.float32)
    if not len(positions):
        return result
    if isinstance(light, Lamp) and model not in LAMP_MODELS:
        raise SceneError(f"{light.name}: the network {model} knows suns alone")
    network = load_network(model)
    volume, medium = in_range(volume, medium)
    predictor, grid = VolumePredictor(network, volume, medium.anisotropy), Grid(volume)
    bounds = predictor.bounds(positions)
    colour = light.irradiance if isinstance(light, Sun) else light.power
    for sigma_t in map(float, np.unique(medium.sigma_t[medium.sigma_t > 0.0])):
        members = [c for c in range(3) if medium.sigma_t[c] == sigma_t]
        if not distinct_albedos(medium, members):
            continue
        prepared: PreparedPredictor | PreparedLampPredictor
        if isinstance(light, Sun):
            albedos = predictor.albedos(medium, sigma_t, members, light)
            prepared, features_at = _prepare_sun(predictor, grid, medium, sigma_t, light, bounds)
        else:
            placed = place_lamp(light, [grid])
            albedos = predictor.albedos(medium, sigma_t, members, placed)
            asked = LampLight(placed, predictor.lamp_radius, albedos.values)
            prepared, features_at = _prepare_lamp(predictor, grid, medium, sigma_t, asked, bounds)
        for start in range(0, len(positions), POINTS_PER_TASK):
            span = slice(start, start + POINTS_PER_TASK)
            features = features_at(positions[span], directions[span])
            points = RayPoints(positions[span], directions[span], ray_features=features)
            radiance = prepared.predict(points, albedos.values)
            for c, row in albedos.by_channel(radiance, positions[span], directions[span]):
                result[span, c] = row * colour[c]
    return result


# Ray features at positions (N, 3) for directions (N, 3), if the network needs any.
FeaturesAt = Callable[[np.ndarray, np.ndarray], np.ndarray | None]


def _prepare_sun(
    predictor: VolumePredictor, grid: Grid, medium: Medium, sigma_t: float, sun: Sun, bounds: Bounds
) -> tuple[PreparedPredictor, FeaturesAt]:
    """What predicts the light of a sun, and the ray features that it needs."""
    prepared = predictor.prepare(sigma_t, sun, bounds)
    fluence = predictor.fluence(sigma_t, [sun]) if predictor.network.needs_ray_features else None
    bound = BoundMedium(grid, medium, sigma_t, grid.sun_depths([sun.direction]))

    def features_at(positions: np.ndarray, directions: np.ndarray) -> np.ndarray | None:
        if fluence is None:
            return None
        return ray_features_at(bound, positions, directions, fluence).of(slice(None), 0, 0)

    return prepared, features_at


def _prepare_lamp(
    predictor: VolumePredictor, grid: Grid, medium: Medium, sigma_t: float, light: LampLight, bounds: Bounds
) -> tuple[PreparedLampPredictor, FeaturesAt]:
    """As `_prepare_sun`, of a lamp of power 1."""
    placed, radius = light.lamp, light.radius
    assert isinstance(placed, LampInMedia)
    prepared = predictor.prepare_lamp(sigma_t, light, bounds)
    bound = BoundMedium(grid, medium, sigma_t, [])
    march = LampMarch([placed], [predictor.lamp_fluence(sigma_t, [light])], radius)

    def features_at(positions: np.ndarray, directions: np.ndarray) -> np.ndarray | None:
        return ray_features_at(bound, positions, directions, None, march).of(slice(None), 0, 0)

    return prepared, features_at
