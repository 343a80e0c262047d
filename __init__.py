# SPDX-License-Identifier: GPL-3.0-or-later
"""MRPNN: neural multiple scattering for clouds, smoke and fog (Blender extension).

Blender imports this package as `bl_ext.<repository>.mrpnn`. Registration loads only
classes and properties; onnxruntime and the network load at the first render.
"""

# Tests and training import `inference` and its neighbours from the repository root,
# where this file is a top-level module and has no package to import from.
if __package__:
    from . import operators, panels


def register() -> None:
    """Add operators and panels to Blender."""
    operators.register()
    panels.register()


def unregister() -> None:
    """Remove what `register` added, in the opposite order."""
    panels.unregister()
    operators.unregister()
