# SPDX-License-Identifier: GPL-3.0-or-later
"""What the shaders of Worlds and lamps emit."""

import numpy as np

from .evaluation import NodeEvaluator
from .sockets import Source, Unsupported, input_of, source_of

EMISSION, BACKGROUND = "ShaderNodeEmission", "ShaderNodeBackground"


def emitted(values: NodeEvaluator, source: Source, shaders: tuple[str, ...]) -> np.ndarray:
    """(n, 3) light of a shader, and of those that it adds and mixes; 0 without one.

    shaders: types of those that shine there. Raises Unsupported, naming the node, for what cannot be evaluated.
    """
    node, groups = source.node, source.groups
    if node is None:
        return np.zeros((1, 3))
    if node.bl_idname in shaders:
        return values.number(node, "Strength", groups) * values.colour(node, "Color", groups)
    if node.bl_idname == "ShaderNodeAddShader":
        first, second = (emitted(values, source_of(socket, groups), shaders) for socket in node.inputs)
        return first + second
    if node.bl_idname == "ShaderNodeMixShader":
        factor = np.clip(values.number(node, "Fac", groups), 0.0, 1.0)
        # A shader of weight 0 need not be supported.
        shares = [(name, share) for name, share in (("Shader", 1.0 - factor), ("Shader_001", factor)) if share.any()]
        parts = (share * emitted(values, source_of(input_of(node, name), groups), shaders) for name, share in shares)
        return sum(parts, np.zeros((1, 3)))
    raise Unsupported(f'node "{node.name}" ({node.bl_label}) cannot be evaluated')
