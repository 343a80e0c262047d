# SPDX-License-Identifier: GPL-3.0-or-later
"""Optical depth of the light of a sphere in the matter around it, less that from the points that stand for the sphere.

Columns of optical depth start at points. The light of a sphere starts on the visible side of its surface; with a soft
falloff, on a disk that faces the lit point. Far away, light that seems to come from a point starts as far before or
behind it as the surface lies; near the sphere, or within, the mean transmittance in a homogeneous medium is

    T(d) = 1 / |W| int_W exp(-s l(w)) dw,

over the directions W in which a point at a distance d from the centre sees the surface, with l(w) the distance to it
and s the extinction. `excess_depths` are -ln T less the depths from the points. Lengths here are in radii, s is an
optical depth per radius.

Where light in the forward peak of the phase function, a fraction a of what is scattered, counts as unscattered, too,
its extinction is s (1 - a), if each collision is counted. The light of a soft falloff is weaker near its middle than
that of a point, a fraction q(d) = 2 d^2 (1 - d / sqrt(d^2 + 1)) of it, and so are the collisions there: what arrives is

    T(d) + a / q(d) int_0^d s q(x) T(x) exp(-(1 - a) s (d - x)) dx.

Where the density varies, the second term is in proportion to the density on the first part of the ray.
"""

import numpy as np

from ..numerics.quadrature import legendre_nodes
from ..numerics.small_matmul import product
from ..scene.emitters import light_start

#: Number of nodes of a table, even in d / (1 + d); kernels hold it, too.
NODES = 64
#: Where the density varies, depths are in proportion to the mean density on the first radii of the ray, over the mean
#: around the sphere, up to a limit; measured. The kernel holds both.
FIRST_PART, EXCESS_MOST = 3.0, 1.5
# Nodes of quadratures, and the distance that stands for infinity.
QUADRATURE, FAR = 48, 1e4
# Nodes between two of these distances, for the integral over collisions.
BETWEEN, CLOSE_NODES = np.concatenate([[0.0], np.geomspace(1e-3, FAR, 192)]), 4
# Stands for no light in logarithms.
NOTHING = 1e-300


def excess_depths(thickness: float, soft_falloff: bool, apart: float, forward: float = 0.0) -> np.ndarray:
    """Optical depths float32 (NODES,) to be added to those from `light_start`, at distances even in d / (1 + d).

    thickness: optical depth of a radius, less the fraction `forward` that counts as unscattered. soft_falloff: as of
    PointLight. apart: distance in radii from the centre to the points that light seems to come from.
    """
    distance, (nodes, weights) = _distances()[:, None], _nodes(QUADRATURE)
    if soft_falloff and forward > 0.0:
        surface = _log_arriving(thickness / (1.0 - forward), forward)
    else:
        surface = _log_surface(thickness, distance, soft_falloff)
    along = apart * (2.0 * nodes - 1.0)
    away = np.sqrt(np.maximum(distance**2 + apart**2 - 2.0 * distance * along, 0.0))
    longer = (apart**2 - 2.0 * distance * along) / np.maximum(away + distance, 1e-30)
    longer = longer + along - light_start(along, apart, 1.0, soft_falloff)
    return (_log_mean(-thickness * longer, weights) - surface).astype(np.float32)


def start_depths(thickness: float) -> np.ndarray:
    """Optical depths float64 (NODES,) from the start to where light of a soft falloff begins to scatter, all at once.

    At distances even in d / (1 + d). thickness: optical depth of a radius. Light that begins there has scattered
    forward as much as the light of the falloff; exact where no light is lost.
    """
    return -_log_arriving(thickness, 1.0)


def _distances() -> np.ndarray:
    """Distances (NODES,), even in d / (1 + d)."""
    fraction = np.arange(NODES) / (NODES - 1.0)
    return np.minimum(fraction / np.maximum(1.0 - fraction, 1e-9), FAR)


def _nodes(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights (Q,) of a quadrature from 0 to 1."""
    nodes, weights = legendre_nodes(count)
    return 0.5 + 0.5 * nodes, 0.5 * weights


def _log_surface(thickness: float, distance: np.ndarray, soft_falloff: bool) -> np.ndarray:
    """ln (N,) of the mean transmittance to a surface at distances (N, 1), over that of the distance itself."""
    nodes, weights = _nodes(QUADRATURE)
    longer, solid_angles = _disk_ways(distance, nodes) if soft_falloff else _sphere_ways(distance, nodes)
    return _log_mean(-thickness * longer, solid_angles * weights)


def _falloff(distance: np.ndarray) -> np.ndarray:
    """q: the light of a soft falloff at distances (N,), over that of a point."""
    slant = np.sqrt(distance**2 + 1.0)
    return 2.0 * distance**2 / (slant * (slant + distance))


def _log_arriving(thickness: float, forward: float) -> np.ndarray:
    """ln (NODES,) of the unscattered and forward-scattered light of a soft falloff, over exp(-(1 - a) s d)."""
    distance = _distances()
    ends, (nodes, weights) = np.unique(np.concatenate([BETWEEN, distance])), _nodes(CLOSE_NODES)
    steps = np.diff(ends)
    distances = (ends[:-1, None] + steps[:, None] * nodes).ravel()
    turned = np.exp(_log_surface(thickness, distances[:, None], True) - forward * thickness * distances)
    collisions = product((thickness * _falloff(distances) * turned).reshape(-1, CLOSE_NODES), weights) * steps
    collided = np.concatenate([[0.0], np.cumsum(collisions)])[np.searchsorted(ends, distance)]
    straight = np.exp(_log_surface(thickness, distance[:, None], True) - forward * thickness * distance)
    more = np.divide(forward * collided, _falloff(distance), out=np.zeros(NODES), where=distance > 0.0)
    return np.log(np.maximum(straight + more, NOTHING))


def _disk_ways(distance: np.ndarray, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances to a disk of radius 1 that faces points, less that to its centre (N, 1), and solid angles, (N, Q)."""
    # 1 / cos(b) to the power of the nodes, so that they are dense where ways are short.
    log = 0.5 * np.log1p(1.0 / np.maximum(distance, 1e-6) ** 2)
    return distance * np.expm1(log * nodes), np.exp(-log * nodes)


def _sphere_ways(distance: np.ndarray, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same for the visible side of a sphere of radius 1, or its inside, as `_disk_ways`."""
    # Outside, nodes are cosines to the normal of the surface; within, to the direction from the centre.
    slant = np.sqrt(np.maximum(distance**2 - 1.0, 0.0) + nodes**2)
    outside = (nodes**2 - 1.0) / (slant + distance) - nodes
    cosine = 2.0 * nodes - 1.0
    within = np.sqrt(np.maximum(1.0 - distance**2 * (1.0 - cosine**2), 0.0)) - distance * cosine - distance
    beyond = distance > 1.0
    return np.where(beyond, outside, within), np.where(beyond, nodes / np.maximum(slant, 1e-30), 1.0)


def _log_mean(exponents: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Logarithm (N,) of the mean of exp(exponents), (N, Q), by weights (N, Q) or (Q,)."""
    most = exponents.max(axis=-1, keepdims=True)
    weights = np.broadcast_to(weights, exponents.shape)
    mean = (weights * np.exp(exponents - most)).sum(axis=-1) / weights.sum(axis=-1)
    return most[..., 0] + np.log(mean)
