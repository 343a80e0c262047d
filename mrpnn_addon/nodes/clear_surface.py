# SPDX-License-Identifier: GPL-3.0-or-later
"""Surface shaders that let all light pass, so that Cycles shows a mesh as if it had none."""

import numpy as np

from .evaluation import NodeEvaluator, Nowhere
from .sockets import Node, Source, Unsupported, input_of, source_of


def shows_no_surface(output: Node) -> bool:
    """Whether a material's surface is invisible: nothing is linked, or shaders that are transparent without a tint."""
    try:
        passing = _passing(source_of(input_of(output, "Surface")), NodeEvaluator(Nowhere()))
    except Unsupported:
        return False
    return passing is None or bool(np.allclose(passing, 1.0, atol=1e-5))


def _passing(source: Source, values: NodeEvaluator) -> np.ndarray | None:
    """The colour (1, 3) of the light that passes straight through a shader; None of no shader.

    Raises Unsupported for shaders that do anything else with light.
    """
    node, groups = source.node, source.groups
    if node is None:
        return None
    kind = node.bl_idname
    if kind == "ShaderNodeBsdfTransparent":
        return np.maximum(values.colour(node, "Color", groups), 0.0)
    if kind == "ShaderNodeBsdfPrincipled" and not values.number(node, "Alpha", groups).max() > 0.0:
        return np.ones((1, 3))
    if kind == "ShaderNodeEmission":
        shines = values.number(node, "Strength", groups) * values.colour(node, "Color", groups)
        if not shines.any():
            return None
    if kind in ("ShaderNodeMixShader", "ShaderNodeAddShader"):
        shares = [1.0, 1.0]
        if kind == "ShaderNodeMixShader":
            factor = float(np.clip(values.number(node, "Fac", groups), 0.0, 1.0).max())
            shares = [1.0 - factor, factor]
        mixed = [socket for socket in node.inputs if socket.type == "SHADER"]
        parts = [
            (share, _passing(source_of(socket, groups), values)) for share, socket in zip(shares, mixed) if share > 0.0
        ]
        found = [share * part for share, part in parts if part is not None]
        return np.sum(found, axis=0) if found else None
    raise Unsupported(f'node "{node.name}" ({node.bl_label}) is a surface')
