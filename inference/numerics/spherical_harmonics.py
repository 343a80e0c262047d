# SPDX-License-Identifier: GPL-3.0-or-later
"""Real spherical harmonics up to degree 3, as polynomials of unit vectors."""

import numpy as np

#: Degree of each harmonic.
DEGREES = np.repeat(np.arange(4), [1, 3, 5, 7])


def spherical_harmonics(directions: np.ndarray) -> np.ndarray:
    """Real spherical harmonics (16, N) of unit vectors (N, 3), in the order of DEGREES, Schmidt's semi-normalised.

    The scalar product of the harmonics of degree l of two vectors is Legendre's polynomial P_l of the vectors' cosine.
    The first harmonic is 1, the next three are the vector.
    """
    x, y, z = directions.T
    xx, yy, zz = x * x, y * y, z * z
    root3, root6, root10, root15 = np.sqrt([3.0, 6.0, 10.0, 15.0])
    return np.stack(
        [
            np.ones_like(x),
            *(x, y, z),
            *(root3 * product for product in (x * y, y * z, z * x)),
            0.5 * (3.0 * zz - 1.0),
            0.5 * root3 * (xx - yy),
            0.25 * root10 * y * (3.0 * xx - yy),
            root15 * x * y * z,
            0.25 * root6 * y * (5.0 * zz - 1.0),
            0.5 * z * (5.0 * zz - 3.0),
            0.25 * root6 * x * (5.0 * zz - 1.0),
            0.5 * root15 * z * (xx - yy),
            0.25 * root10 * x * (xx - 3.0 * yy),
        ]
    )
