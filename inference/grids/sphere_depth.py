# SPDX-License-Identifier: GPL-3.0-or-later
"""Optical depth of the light of a sphere in the matter around it, beyond that from the places that stand for it.

Columns of optical depth start at points. The light of a sphere starts at that side of its surface which is seen, that
of a soft falloff on a disk that faces what it lights. Far away, light that seems to come from a point starts as far
before or behind it as the surface lies; near, or within, its mean transmittance in a homogeneous medium is

    T(d) = 1 / |W| int_W exp(-s l(w)) dw,

over the directions W in which a place at a distance d from the centre sees the surface, with l(w) the way to it and s
the extinction. `excess_depths` are -ln T less what the points give. Lengths here are in radii, s is an optical depth
per radius.

Where light in the forward peak of the phase function, a fraction a of what is scattered, counts as unscattered, too,
its extinction is s (1 - a), if each collision is counted. The light of a soft falloff is weaker near its middle than
that of a point, a fraction q(d) = 2 d^2 (1 - d / sqrt(d^2 + 1)) of it, and so are the collisions there: what arrives is

    T(d) + a / q(d) int_0^d s q(x) T(x) exp(-(1 - a) s (d - x)) dx.

Where the density varies, what this adds is in proportion to the density on the first part of the way.
"""

import numpy as np

from ..numerics.quadrature import legendre_nodes
from ..scene.emitters import light_start

#: Number of nodes of a table, even in d / (1 + d); kernels hold it, too.
NODES = 64
#: Where the density varies, depths are in proportion to the mean on so many radii of the way, over that around the
#: sphere, up to a limit; measured. The kernel holds both.
FIRST_PART, EXCESS_MOST = 3.0, 1.5
# Nodes of quadratures, and the distance that stands for infinity.
QUADRATURE, FAR = 48, 1e4
# Nodes between two of these distances, for the integral over collisions.
BETWEEN, CLOSE_NODES = np.concatenate([[0.0], np.geomspace(1e-3, FAR, 192)]), 4
# Light that is none.
NOTHING = 1e-300


def excess_depths(thickness: float, soft_falloff: bool, apart: float, forward: float = 0.0) -> np.ndarray:
    """Optical depths float32 (NODES,) to be added to those from `light_start`, at distances even in d / (1 + d).

    thickness: optical depth of a radius, less the fraction `forward` that counts as unscattered. soft_falloff: as of
    PointLight. apart: distance from the centre, in radii, of the points that light seems to come from; 0 for one in the
    centre.
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
    """Optical depths float64 (NODES,) behind which the light of a soft falloff starts to be scattered, as if at once.

    At distances even in d / (1 + d). thickness: optical depth of a radius. They are those for which all light that has
    been scattered forward at a distance is what light that starts behind them has been, exactly where no light is lost.
    """
    return -_log_arriving(thickness, 1.0)


def _distances() -> np.ndarray:
    """Distances (NODES,), even in d / (1 + d)."""
    share = np.arange(NODES) / (NODES - 1.0)
    return np.minimum(share / np.maximum(1.0 - share, 1e-9), FAR)


def _nodes(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights (Q,) of a quadrature from 0 to 1."""
    nodes, weights = legendre_nodes(count)
    return 0.5 + 0.5 * nodes, 0.5 * weights


def _log_surface(thickness: float, distance: np.ndarray, soft_falloff: bool) -> np.ndarray:
    """ln (N,) of the mean transmittance to a surface at distances (N, 1), over that of the distance itself."""
    nodes, weights = _nodes(QUADRATURE)
    longer, seen = _disk_ways(distance, nodes) if soft_falloff else _sphere_ways(distance, nodes)
    return _log_mean(-thickness * longer, seen * weights)


def _falloff(distance: np.ndarray) -> np.ndarray:
    """q: the light of a soft falloff at distances (N,), over that of a point."""
    slant = np.sqrt(distance**2 + 1.0)
    return 2.0 * distance**2 / (slant * (slant + distance))


def _log_arriving(thickness: float, forward: float) -> np.ndarray:
    """ln (NODES,) of what arrives from a soft falloff without a turn, over exp(-(1 - a) s d)."""
    distance = _distances()
    ends, (nodes, weights) = np.unique(np.concatenate([BETWEEN, distance])), _nodes(CLOSE_NODES)
    steps = np.diff(ends)
    places = (ends[:-1, None] + steps[:, None] * nodes).ravel()
    turned = np.exp(_log_surface(thickness, places[:, None], True) - forward * thickness * places)
    collisions = (thickness * _falloff(places) * turned).reshape(-1, CLOSE_NODES) @ weights * steps
    collided = np.concatenate([[0.0], np.cumsum(collisions)])[np.searchsorted(ends, distance)]
    straight = np.exp(_log_surface(thickness, distance[:, None], True) - forward * thickness * distance)
    more = np.divide(forward * collided, _falloff(distance), out=np.zeros(NODES), where=distance > 0.0)
    return np.log(np.maximum(straight + more, NOTHING))


def _disk_ways(distance: np.ndarray, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Ways to a disk of radius 1 that faces points, less the distance (N, 1), and shares of its solid angle, (N, Q)."""
    # 1 / cos(b) to the power of the nodes, so that they are dense where ways are short.
    log = 0.5 * np.log1p(1.0 / np.maximum(distance, 1e-6) ** 2)
    return distance * np.expm1(log * nodes), np.exp(-log * nodes)


def _sphere_ways(distance: np.ndarray, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Ways to the visible side of a sphere of radius 1, or from within, as `_disk_ways`."""
    # Outside, nodes are cosines to the normal of the surface; within, to the direction from the centre.
    slant = np.sqrt(np.maximum(distance**2 - 1.0, 0.0) + nodes**2)
    outside = (nodes**2 - 1.0) / (slant + distance) - nodes
    cosine = 2.0 * nodes - 1.0
    within = np.sqrt(np.maximum(1.0 - distance**2 * (1.0 - cosine**2), 0.0)) - distance * cosine - distance
    beyond = distance > 1.0
    return np.where(beyond, outside, within), np.where(beyond, nodes / np.maximum(slant, 1e-30), 1.0)


def _log_mean(exponents: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Logarithm (N,) of the mean of exp(exponents), (N, Q), with some weights."""
    most = exponents.max(axis=-1, keepdims=True)
    weights = np.broadcast_to(weights, exponents.shape)
    mean = (weights * np.exp(exponents - most)).sum(axis=-1) / weights.sum(axis=-1)
    return most[..., 0] + np.log(mean)
