# SPDX-License-Identifier: GPL-3.0-or-later
"""Doors and features in pairs: every way to a picture, with every kind of scene.

`features` builds small scenes, `covering` chooses which, `doors` sends them through the extension and judges what comes
back, and `run` is the program that one Blender runs:

    python -m tests.matrix.run --row 17 --door bake
    blender -b --python tests/matrix/run.py -- --row 17 --door bake
"""
