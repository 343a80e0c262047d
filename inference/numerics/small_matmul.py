# SPDX-License-Identifier: GPL-3.0-or-later
"""Matrix products on the calling thread.

BLAS libraries share large products among threads of their own, which then spin while they wait for the next product:
they would compete with the render's worker threads for the processor.
"""

import numpy as np

# Multiplications up to which OpenBLAS does not share a matrix-vector and a matrix-matrix product.
VECTOR_WORK, MATRIX_WORK = 8192, 1 << 17


def inverse(matrix: np.ndarray) -> np.ndarray:
    """Inverse of a (3, 3) matrix by Cramer's rule; LAPACK would wake its threads even for that."""
    # On Python's numbers, which are quicker than arrays as small as this.
    (a, b, c), (d, e, f), (g, h, i) = matrix.tolist()
    rows = [[e * i - h * f, h * c - b * i, b * f - e * c]]
    rows += [[f * g - i * d, i * a - c * g, c * d - f * a], [d * h - g * e, g * b - a * h, a * e - d * b]]
    return np.array(rows) / np.float64(a * rows[0][0] + d * rows[0][1] + g * rows[0][2])


def affine_inverse(matrix: np.ndarray) -> np.ndarray:
    """Inverse of an affine transform (4, 4)."""
    inverted = np.eye(4)
    inverted[:3, :3] = inverse(matrix[:3, :3])
    inverted[:3, 3] = -inverted[:3, :3] @ matrix[:3, 3]
    return inverted


def solve_positive(matrices: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solutions (K, N) of N systems of symmetric positive definite matrices (K, K, N) and right sides (K, N).

    Gaussian elimination of all systems at once. LAPACK would wake its threads for each of them.
    """
    matrices, right = matrices.copy(), right.copy()
    for k in range(len(right)):
        factors = matrices[k, k + 1 :] / matrices[k, k]
        right[k + 1 :] -= factors * right[k]
        # Elimination leaves what remains symmetric: the rows from the diagonal on are enough.
        for row, factor in enumerate(factors, k + 1):
            matrices[row, row:] -= factor * matrices[k, row:]
    for k in reversed(range(len(right))):
        right[k] /= matrices[k, k]
        right[:k] -= matrices[:k, k] * right[k]
    return right


def positive_inverse(matrix: np.ndarray) -> np.ndarray:
    """Inverse of a symmetric positive definite matrix (K, K)."""
    return solve_positive(np.repeat(matrix[..., None], len(matrix), axis=2), np.eye(len(matrix)))


def lengths(vectors: np.ndarray) -> np.ndarray:
    """Lengths (N,) of vectors (N, 3); numpy's own function is slow along short axes."""
    x, y, z = vectors.T
    return np.sqrt(x * x + y * y + z * z)


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a @ b for a (..., M, K) and b (K,) or (K, N), in blocks that are small enough to stay on this thread."""
    if not a.size or not b.size:
        return a @ b
    if b.size > VECTOR_WORK:
        # Too much for one row, which numpy treats as a vector.
        length = max(VECTOR_WORK * len(b) // b.size, 1)
        blocks = [slice(start, start + length) for start in range(0, len(b), length)]
        if len(blocks) > 1:
            return np.sum([product(a[..., block], b[block]) for block in blocks], axis=0)
    # numpy treats a matrix of one column as a vector, too.
    work = VECTOR_WORK if b.size == a.shape[-1] else MATRIX_WORK
    rows = a.reshape(-1, a.shape[-1])
    height = max(work // b.size, 1)
    even = len(rows) // height * height
    result = np.empty((len(rows), *b.shape[1:]), np.result_type(a, b))
    np.matmul(rows[:even].reshape(-1, height, a.shape[-1]), b, out=result[:even].reshape(-1, height, *b.shape[1:]))
    np.matmul(rows[even:], b, out=result[even:])
    return result.reshape((*a.shape[:-1], *b.shape[1:]))


def product_of_columns(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a @ b for a (M, K) and b (K, N), in blocks of columns that are small enough to stay on this thread."""
    result = np.empty((len(a), b.shape[1]), np.result_type(a, b))
    width = max(MATRIX_WORK // a.size, 1)
    for start in range(0, b.shape[1], width):
        block = slice(start, start + width)
        np.matmul(a, b[:, block], out=result[:, block])
    return result
