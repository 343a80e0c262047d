# SPDX-License-Identifier: GPL-3.0-or-later
"""Numbers that differ by rounding alone, as keys of what is made once for all of them."""

import numpy as np

# Significant digits, and decimals of unit vectors, to which numbers have to agree.
SAME = 10


def alike(*values: float) -> tuple[float, ...]:
    """Numbers to SAME significant digits."""
    return tuple(float(f"{value:.{SAME}g}") for value in values)


def alike_vector(vector: np.ndarray) -> tuple[float, ...]:
    """A vector of numbers up to 1, to SAME decimals."""
    # Adding 0 turns -0 into 0.
    return tuple(np.round(vector, SAME) + 0.0)
