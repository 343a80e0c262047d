# SPDX-License-Identifier: GPL-3.0-or-later
"""The Noise and Gradient Textures in NumPy.

The noise is Perlin's improved gradient noise (SIGGRAPH 2002) with lattice gradients chosen by Bob Jenkins' lookup3
hash, as in OSL and Cycles, and has the same values.
"""

import numpy as np

# Normalises gradient noise to [-1, 1]: OSL's constant for three dimensions.
NOISE_RANGE = 0.982
MAX_DETAIL = 15.0


def noise(points, detail: float, roughness: float, lacunarity: float, distortion: float, normalize: bool):
    """Fractal sum (n, 1) of gradient noise at points (n, 3), in [0, 1] if normalised.

    detail: octaves beyond the first; a fraction fades in the last.
    """
    points = np.asarray(points, np.float64)
    if distortion != 0.0:
        points = points + distortion * np.concatenate(
            [gradient_noise(points + _offset(seed)) for seed in range(3)], axis=1
        )
    detail = min(max(detail, 0.0), MAX_DETAIL)
    total, span, amplitude, frequency = np.zeros((len(points), 1)), 0.0, 1.0, 1.0

    def levelled(value, span):
        return 0.5 * value / span + 0.5 if normalize else value

    for _ in range(int(detail) + 1):
        total += amplitude * gradient_noise(points * frequency)
        span += amplitude
        amplitude *= max(roughness, 0.0)
        frequency *= lacunarity
    rest = detail - int(detail)
    result = levelled(total, span)
    if rest == 0.0:
        return result
    more = levelled(total + amplitude * gradient_noise(points * frequency), span + amplitude)
    return result + rest * (more - result)


def gradient_noise(points) -> np.ndarray:
    """(n, 1) in about [-1, 1] at points (n, 3)."""
    # Cycles works in single precision; the lattice cell must be the same.
    points = np.asarray(points, np.float32)
    cell = np.floor(points)
    f = points - cell
    cell = cell.astype(np.int64).astype(np.uint32)
    u = f * f * f * (f * (f * 6.0 - 15.0) + 10.0)
    result = np.zeros(len(points), np.float32)
    for i in (0, 1):
        for j in (0, 1):
            for k in (0, 1):
                corner = np.array([i, j, k])
                key = _hash(*(cell + corner.astype(np.uint32)).T)
                weight = np.where(corner, u, 1.0 - u).prod(axis=1)
                result += weight * _slope(key & np.uint32(15), f - corner)
    return (NOISE_RANGE * result)[:, None].astype(np.float64)


def _slope(h, f):
    """Dot product of gradient h with f (n, 3): the twelve edges of a cube, four of them twice."""
    x, y, z = f.T
    u = np.where(h < 8, x, y)
    v = np.where(h < 4, y, np.where((h == 12) | (h == 14), x, z))
    return np.where(h & 1, -u, u) + np.where(h & 2, -v, v)


def _hash(*keys):
    """lookup3's final mix of two or three uint32 arrays."""
    start = np.uint32((0xDEADBEEF + (len(keys) << 2) + 13) & 0xFFFFFFFF)
    a, b = keys[0] + start, keys[1] + start
    c = keys[2] + start if len(keys) == 3 else np.full_like(a, start)
    for target, bits in zip("cabcabc", (14, 11, 25, 16, 4, 14, 24)):
        if target == "c":
            c = (c ^ b) - _rotated(b, bits)
        elif target == "a":
            a = (a ^ c) - _rotated(c, bits)
        else:
            b = (b ^ a) - _rotated(a, bits)
    return c


def _rotated(value, bits):
    return (value << np.uint32(bits)) | (value >> np.uint32(32 - bits))


def _offset(seed: int) -> np.ndarray:
    """(3,) between 100 and 200, decorrelates seeds."""
    keys = np.array([seed, seed, seed], np.float32).view(np.uint32), np.arange(3, dtype=np.float32).view(np.uint32)
    return 100.0 + 100.0 * _hash(*keys) / np.float64(0xFFFFFFFF)


def gradient(points, kind: str) -> np.ndarray:
    """(n, 1) in [0, 1] at points (n, 3): the Gradient Texture of one kind."""
    x, y = points[:, :1], points[:, 1:2]
    inside = np.maximum(0.999999 - np.linalg.norm(points, axis=1, keepdims=True), 0.0)
    eased = np.clip(x, 0.0, 1.0)
    value = {
        "LINEAR": lambda: x,
        "QUADRATIC": lambda: np.maximum(x, 0.0) ** 2,
        "EASING": lambda: 3.0 * eased**2 - 2.0 * eased**3,
        "DIAGONAL": lambda: (x + y) * 0.5,
        "RADIAL": lambda: np.arctan2(y, x) / (2.0 * np.pi) + 0.5,
        "SPHERICAL": lambda: inside,
        "QUADRATIC_SPHERE": lambda: inside**2,
    }[kind]()
    return np.clip(value, 0.0, 1.0)
