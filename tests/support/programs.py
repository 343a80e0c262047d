# SPDX-License-Identifier: GPL-3.0-or-later
"""Whole Blender programs to test with: MRPNN_BLENDER names them, with paths separated as in PATH."""

import os

import pytest

BLENDERS = [path for path in os.environ.get("MRPNN_BLENDER", "").split(os.pathsep) if path]

# Marks of files whose tests start them.
MARKS = [
    pytest.mark.blender,
    pytest.mark.slow,
    pytest.mark.skipif(not BLENDERS, reason="MRPNN_BLENDER names no Blender program"),
]
