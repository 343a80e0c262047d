# SPDX-License-Identifier: GPL-3.0-or-later
"""What the network for light from everywhere reads, and the radiances among which it weighs.

The network knows nothing of the light. From the medium around a point it predicts weights, which sum to 1 over
scattering orders and CANDIDATES radiances, each of which is L where light of radiance L comes from everywhere:

- the environment ahead of the camera ray, blurred by phase functions from narrow to even;
- the environment as it is open to the point: means over 50 directions, weighted with lobes around the ray and with
  the transmittance towards them, of extinction at several scales;
- the coarse transport, at the point and at probes around it;
- the same for media that absorb, over its solution for even light: light that scatters seldom. That solution itself
  tells how often light scatters.

The prediction is therefore linear in the light, even light at an albedo of 1 stays exactly even, and light of any
number of colours costs one evaluation.
"""

from collections.abc import Sequence

import numpy as np

from ..environments.environment_light import ALBEDOS, DIRECTION_WEIGHTS, DIRECTIONS
from ..numerics.small_matmul import product
from ..scene.phase_function import reduced_anisotropy

#: Scale of extinction at which the mean direction of what is open is taken.
OPEN_SCALE = 0.3
# Distances of the probes: ahead of the point and behind it on its ray, and towards what is open.
NEAR, FAR, OPEN = 1.0 / 32.0, 1.0 / 8.0, 1.0 / 16.0
PROBES = 6
# Mean cosines of the lobes around the ray, and scales of extinction, of the means over what is open.
LOBES, SCALES = (0.8, 0.5, 0.25, 0.0, -0.4), (1.0, 0.3, 0.09, 0.03)
# Largest mean cosine of lobes that tell how much of those blurs is visible.
SHARPEST = 0.8
# Blurs of the environment ahead: powers of G, then fixed mean cosines.
BLUR_POWERS, BLURS = (1, 2, 4), (0.0, -0.5)
# Weights of the flux along the ray in the light of the coarse transport: probe, factor.
TOWARDS = ((0, 2.0), (0, -2.0), (1, 2.0), (2, 2.0), (3, 2.0))
# Light in absorbing media: probe, and weight of the flux along the ray. Where there is less than LEAST of even light,
# the light without absorption takes its place.
SELDOM, LEAST = ((0, 0.0), (1, 0.0), (2, 0.0), (5, 0.0), (0, 1.0), (0, -1.0), (1, 1.0), (3, 1.0)), np.float32(1e-3)
#: Radiances that the network weighs.
CANDIDATES = len(BLUR_POWERS) + len(BLURS) + len(LOBES) * len(SCALES) + PROBES + 1 + len(TOWARDS)
CANDIDATES += len(ALBEDOS) * len(SELDOM)
# Logarithms of transmittance are bounded by this.
MIN_LOG = -12.0
ALONG_SCALES = (1.0, 0.3, 0.1)
#: Upper bound of the optical depths along the ray, and the range of optical thickness that the network was shown.
MAX_ALONG, SIGMA_HAT_RANGE = 8.0, (2.0, 1500.0)
# Points of the sparse stencil's low-frequency layers.
LAYERS = (2, 2, 4, 4, 4, 8, 8, 8)
POOLED_OFFSET = 3e-4
#: Columns of `inputs`.
COLUMNS = sum(LAYERS) + len(LAYERS) + 2 * len(LOBES) * len(SCALES) + 2 * (len(ALONG_SCALES) + 1) + 2 * len(SCALES) + 4
COLUMNS += len(ALBEDOS) * len(SELDOM)


def open_direction(depths: np.ndarray, sigma_hat: np.ndarray | float, scale: float = OPEN_SCALE) -> np.ndarray:
    """Vector float32 (N, 3), no longer than 1, towards where a point is open: the flux of even light over its fluence.

    depths: (N, 50), of `direction_depths` at the points. sigma_hat: (N,) or a number.
    """
    open_to = _open(depths, sigma_hat, scale)[0] * DIRECTION_WEIGHTS.astype(np.float32)
    return product(open_to / open_to.sum(axis=1, keepdims=True), DIRECTIONS.astype(np.float32))


def _open(depths: np.ndarray, sigma_hat: np.ndarray | float, scale: float) -> tuple[np.ndarray, np.ndarray]:
    """Transmittances float32 (N, 50) over the largest of each point, and the logarithm (N, 1) of that."""
    scaled = np.reshape(np.float32(scale) * np.asarray(sigma_hat, np.float32), (-1, 1)) * depths
    least = scaled.min(axis=1, keepdims=True)
    return np.exp(least - scaled), -least


def probe_positions(
    positions: np.ndarray, omega: np.ndarray, depths: np.ndarray, sigma_hat: np.ndarray | float
) -> np.ndarray:
    """Where the coarse transport is read, (N, PROBES, 3): the point itself, ahead, behind, and towards what is open."""
    towards = open_direction(depths, sigma_hat)
    offsets = [0.0 * omega, NEAR * omega, -NEAR * omega, FAR * omega, -FAR * omega, OPEN * towards]
    return positions[:, None] + np.stack(offsets, axis=1)


def lobe_weights(omega: np.ndarray, anisotropies: Sequence[float] = LOBES) -> np.ndarray:
    """Weights float32 (V, L, 50) of DIRECTIONS, summing to 1, in L lobes around camera rays (V, 3)."""
    cosine = product(omega, DIRECTIONS.T).astype(np.float32)[:, None]
    g, weights = np.asarray(anisotropies, np.float32)[:, None], DIRECTION_WEIGHTS.astype(np.float32)
    wide = np.float32(1.0) + g * g - np.float32(2.0) * g * cosine
    lobes = weights / (wide * np.sqrt(wide))
    return lobes / lobes.sum(axis=2, keepdims=True)


class OpenMeans:
    """Means of the environment over what is open to points.

    depths: float32 (N, 50). lobes: (N, LOBES, 50) of their rays. sigma_hat: (N,) or a number.
    """

    def __init__(self, depths: np.ndarray, lobes: np.ndarray, sigma_hat: np.ndarray | float):
        self._lobes, self._open, self._totals, logs, self.directions = lobes, [], [], [], []
        for scale in SCALES:
            open_to, largest = _open(depths, sigma_hat, scale)
            total = np.einsum("nlk,nk->nl", lobes, open_to)
            self._open.append(open_to)
            self._totals.append(total)
            logs.append(np.log(total) + largest)
            even = open_to * DIRECTION_WEIGHTS.astype(np.float32)
            self.directions.append(product(even / even.sum(axis=1, keepdims=True), DIRECTIONS.astype(np.float32)))
        #: Logarithms float32 (N, SCALES * LOBES) of the transmittance of each lobe, at each scale.
        self.logs = np.maximum(np.concatenate(logs, axis=1), np.float32(MIN_LOG))

    def radiance(self, directions: np.ndarray, visible: np.ndarray | float = 1.0) -> np.ndarray:
        """Means float32 (N, SCALES * LOBES, C) of the radiance (50, C) from DIRECTIONS.

        visible: share (N, 50) of it that reaches the points.
        """
        light = directions.astype(np.float32)
        means = [
            product(self._lobes * (open_to * visible)[:, None], light) / total[..., None]
            for open_to, total in zip(self._open, self._totals)
        ]
        return np.concatenate(means, axis=1)


def visible_ahead(lobes: np.ndarray, directions: np.ndarray, visible: np.ndarray) -> np.ndarray:
    """Share (N, L) of the radiance (50, C) from DIRECTIONS, in lobes (N, L, 50), of which (N, 50) is visible."""
    light = lobes * directions.mean(axis=1, dtype=np.float32)
    return (light * visible[:, None]).sum(axis=2) / np.maximum(light.sum(axis=2), np.float32(1e-30))


def inputs(
    density: np.ndarray,
    along: np.ndarray,
    opened: OpenMeans,
    seldom: np.ndarray,
    omega: np.ndarray,
    sigma_hat: np.ndarray | float,
    anisotropy: np.ndarray | float,
) -> np.ndarray:
    """What the network reads, float32 (N, COLUMNS).

    density: (N, 40), feature mu at the low-frequency points of the sparse stencil. along: (N, 2), optical depth ahead
    of the points and behind them on their rays. seldom: (N, K), what is left of even light,
    of `seldom_scattered`. omega: (N, 3). sigma_hat, anisotropy: (N,) or numbers.
    """
    count, columns, start = len(density), [], 0
    along = np.minimum(along, np.float32(MAX_ALONG))
    for points in LAYERS:
        columns.append(np.log(density[:, start : start + points].mean(axis=1, keepdims=True) + POOLED_OFFSET))
        start += points
    for scale in ALONG_SCALES:
        columns.append(np.exp(-scale * along))
    columns.append(np.log1p(along))
    for direction in opened.directions:
        columns.append((direction * omega).sum(axis=1, keepdims=True))
        columns.append(np.sqrt((direction**2).sum(axis=1, keepdims=True)))
    g = np.asarray(anisotropy, np.float32)
    thickness = np.log(np.clip(np.asarray(sigma_hat, np.float32), *SIGMA_HAT_RANGE))
    numbers = [g, g * np.abs(g), np.log(1.0 - np.abs(g)), thickness]
    columns += [np.broadcast_to(np.reshape(number, (-1, 1)), (count, 1)) for number in numbers]
    columns.append(np.log(np.maximum(seldom, LEAST)))
    return np.concatenate([density, opened.logs, np.exp(opened.logs), *columns], axis=1, dtype=np.float32)


def seldom_scattered(light: np.ndarray, absorbed: np.ndarray, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Radiances float32 (N, K, C) of light that scatters seldom, and what is left of even light of radiance 1, (N, K).

    K is ALBEDOS times SELDOM. light: (N, PROBES, 4, C), as for `candidates`. absorbed: (N, PROBES, ALBEDOS, 4, C + 1),
    the same in absorbing media, the last channel of even light. omega: (N, 3).
    """
    along = np.einsum("npakc,nk->npac", absorbed[:, :, :, 1:], omega)
    fluences, evens = [], []
    for a in range(len(ALBEDOS)):
        for probe, factor in SELDOM:
            seldom = absorbed[:, probe, a, 0] - np.float32(factor) * along[:, probe, a]
            even = seldom[:, -1:]
            # Of light that hardly anything is left of, only the coarse transport's error is.
            scale = np.maximum(even, 0.0) / (np.abs(even) + LEAST)
            fluences.append((scale * seldom[:, :-1] + LEAST * light[:, probe, 0]) / (scale * even + LEAST))
            evens.append(even)
    return np.stack(fluences, axis=1), np.concatenate(evens, axis=1)


def candidates(
    ahead: np.ndarray,
    opened: np.ndarray,
    light: np.ndarray,
    seldom: np.ndarray,
    omega: np.ndarray,
    anisotropy: np.ndarray | float,
) -> np.ndarray:
    """The radiances that the network weighs, float32 (N, CANDIDATES, C).

    ahead: (N, BLUR_POWERS + BLURS, C), the environment ahead, blurred. opened: of `OpenMeans.radiance`. light: (N,
    PROBES, 4, C), fluence and flux over 4 pi of the coarse transport at the probes. seldom: (N, K, C), of
    `seldom_scattered`. omega: (N, 3).
    """
    fluence = light[:, :, 0]
    along = np.einsum("npkc,nk->npc", light[:, :, 1:], omega)
    forward = np.reshape(3.0 * reduced_anisotropy(np.asarray(anisotropy, np.float32)), (-1, 1))
    towards = [fluence[:, 0] - forward * along[:, 0]]
    towards += [fluence[:, probe] - np.float32(factor) * along[:, probe] for probe, factor in TOWARDS]
    return np.concatenate([ahead, opened, fluence, np.stack(towards, axis=1), seldom], axis=1, dtype=np.float32)


def blurs(anisotropy: float) -> list[float]:
    """Mean cosines of the phase functions that blur the environment ahead, in a medium of mean cosine G."""
    return [float(np.copysign(abs(anisotropy) ** power, anisotropy)) for power in BLUR_POWERS] + list(BLURS)
