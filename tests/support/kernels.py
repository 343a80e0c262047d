# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernels for every kind of processor that this one can stand in for."""

import contextlib
from collections.abc import Iterator

from inference.kernels.library import load_kernels

VARIANTS = range(load_kernels().best + 1)


@contextlib.contextmanager
def variant(number: int) -> Iterator[None]:
    """Use those of one of VARIANTS."""
    kernels = load_kernels()
    before, kernels.variant = kernels.variant, number
    try:
        yield
    finally:
        kernels.variant = before
