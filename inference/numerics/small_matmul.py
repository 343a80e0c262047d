"""Products of matrices on the thread that asks for them.

Libraries behind numpy share large products among threads of their own, which then wait, busily, for the next one: they
would take the processor from the threads that a render has already.
"""

import numpy as np

# Products of a matrix and a vector, and of two matrices, that OpenBLAS does not share: multiplications at most.
VECTOR_WORK, MATRIX_WORK = 8192, 1 << 17


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a @ b for a (..., M, K) and b (K,) or (K, N), in parts of some rows each."""
    if not a.size or not b.size:
        return a @ b
    # One column is a vector to numpy as well.
    work = VECTOR_WORK if b.size == a.shape[-1] else MATRIX_WORK
    rows = a.reshape(-1, a.shape[-1])
    each = max(work // b.size, 1)
    whole = len(rows) // each * each
    result = np.empty((len(rows), *b.shape[1:]), np.result_type(a, b))
    np.matmul(rows[:whole].reshape(-1, each, a.shape[-1]), b, out=result[:whole].reshape(-1, each, *b.shape[1:]))
    np.matmul(rows[whole:], b, out=result[whole:])
    return result.reshape(*a.shape[:-1], *b.shape[1:])
