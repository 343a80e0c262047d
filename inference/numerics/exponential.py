"""1 - exp(-x) in single precision."""

import numpy as np

# Beyond it nothing is left; 0 is 1 beside it.
_MOST, _LEAST = np.float32(60.0), np.float32(1e-30)


def one_minus_exp(x: np.ndarray) -> np.ndarray:
    """1 - exp(-x) for float32 x >= 0, to single precision for small x as well.

    numpy's expm1 computes one number at a time. With u = exp(-x), rounded, (1 - u) / -log(u) is as smooth as
    (1 - exp(-x)) / x, and so is right to rounding though -log(u) is not quite x.
    """
    x = np.minimum(x, _MOST)
    u = np.exp(-x)
    ratio = -np.log(u)
    ratio += _LEAST
    np.subtract(np.float32(1.0), u, out=u)
    u += _LEAST
    u /= ratio
    u *= x
    return u
