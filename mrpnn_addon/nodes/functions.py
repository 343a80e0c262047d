# SPDX-License-Identifier: GPL-3.0-or-later
"""Nodes that output numbers, colours and vectors, by Cycles' definitions.

Each function takes (values, node, output, groups), with `values` a NodeEvaluator, and returns one output's array.
Measured against Cycles in tests/mrpnn_addon/test_nodes.py.
"""

from typing import TYPE_CHECKING, Any

import numpy as np

from ...inference.numerics.small_matmul import affine_inverse
from .colour_operations import BLENDS, from_hsl, from_hsv, luminance, to_hsl, to_hsv
from .emission import blackbody_colour
from .math_operations import MATH, VECTOR_MATH, about_axis, clamp, divide, euler_matrices, rotated, smoothstep
from .sockets import Groups, Node, Socket, unsupported
from .texture_nodes import TEXTURES

if TYPE_CHECKING:
    from .evaluation import NodeEvaluator

RAMP_CELLS = 256
CURVE_CELLS = 256


def _value_node(values: "NodeEvaluator", node: Node, output: Socket, groups: Groups) -> np.ndarray:
    value = output.default_value
    return np.full((1, 1), value) if isinstance(value, float) else np.array(value)[None, :3]


def _math(values: "NodeEvaluator", node: Node, output: Socket, groups: Groups) -> np.ndarray:
    operands = [values.number(node, socket.identifier, groups) for socket in node.inputs]
    result = MATH[node.operation](*operands)
    return clamp(result, 0.0, 1.0) if node.use_clamp else result


def _vector_math(values: "NodeEvaluator", node: Node, output: Socket, groups: Groups) -> np.ndarray:
    operation = VECTOR_MATH[node.operation]
    vectors = [values.colour(node, name, groups) for name in ("Vector", "Vector_001", "Vector_002")]
    return operation(*vectors, values.number(node, "Scale", groups))


def _map_range(values: "NodeEvaluator", node: Node, output: Socket, groups: Groups) -> np.ndarray:
    if node.data_type == "FLOAT":
        names, read = ("Value", "From Min", "From Max", "To Min", "To Max", "Steps"), values.number
    else:
        names, read = (
            ("Vector", "From_Min_FLOAT3", "From_Max_FLOAT3", "To_Min_FLOAT3", "To_Max_FLOAT3", "Steps_FLOAT3"),
            values.colour,
        )
    value, low, high, to_low, to_high, steps = (read(node, name, groups) for name in names)
    if node.interpolation_type in ("SMOOTHSTEP", "SMOOTHERSTEP"):
        share = smoothstep(
            value, np.minimum(low, high), np.maximum(low, high), smoother=node.interpolation_type == "SMOOTHERSTEP"
        )
        share = np.where(low > high, 1.0 - share, share)
    else:
        share = divide(value - low, high - low)
        if node.interpolation_type == "STEPPED":
            share = divide(np.floor(share * (steps + 1.0)), steps)
    result = to_low + share * (to_high - to_low)
    if node.clamp and node.interpolation_type in ("LINEAR", "STEPPED"):
        result = clamp(result, np.minimum(to_low, to_high), np.maximum(to_low, to_high))
    return np.where(low == high, 0.0, result)


def _clamp(values: "NodeEvaluator", node: Node, output: Socket, groups: Groups) -> np.ndarray:
    value, low, high = (values.number(node, name, groups) for name in ("Value", "Min", "Max"))
    if node.clamp_type == "RANGE":
        low, high = np.minimum(low, high), np.maximum(low, high)
    return clamp(value, low, high)


def _blackbody(values: "NodeEvaluator", node: Node, output: Socket, groups: Groups) -> np.ndarray:
    return np.maximum(blackbody_colour(values.number(node, "Temperature", groups)), 0.0)


def _color_ramp(values: "NodeEvaluator", node: Node, output: Socket, groups: Groups) -> np.ndarray:
    ramp = node.color_ramp
    table = np.array([ramp.evaluate(n / (RAMP_CELLS - 1)) for n in range(RAMP_CELLS)])
    table = table[:, 3:] if output.identifier == "Alpha" else table[:, :3]
    place = clamp(values.number(node, "Fac", groups), 0.0, 1.0)
    return _look_up(table, place, stepped=ramp.interpolation == "CONSTANT")


def _float_curve(values: "NodeEvaluator", node: Node, output: Socket, groups: Groups) -> np.ndarray:
    value, factor = values.number(node, "Value", groups), values.number(node, "Factor", groups)
    (curve,), low, high = curve_tables(node.mapping, 1)
    return value + factor * (_curved(curve, value, low, high, node.mapping) - value)


def _colour_curves(values: "NodeEvaluator", node: Node, output: Socket, groups: Groups) -> np.ndarray:
    name = "Color" if node.bl_idname == "ShaderNodeRGBCurve" else "Vector"
    value, factor = values.colour(node, name, groups), values.number(node, "Fac", groups)
    curves, low, high = curve_tables(node.mapping, 4 if name == "Color" else 3)
    columns = [_curved(curve, value[:, [c]], low, high, node.mapping) for c, curve in enumerate(curves[:3])]
    return value + factor * (np.concatenate(columns, axis=1) - value)


def curve_tables(mapping: Any, count: int) -> tuple[list[np.ndarray], float, float]:
    """Tables (CURVE_CELLS + 1, 1) of the first `count` curves of a mapping, and the values of their ends.

    A fourth curve is applied before each of the others.
    """
    if hasattr(mapping, "tables"):
        return mapping.tables
    mapping.update()
    curves = [mapping.curves[number] for number in range(count)]
    low = min(curve.points[0].location[0] for curve in curves)
    high = max(curve.points[-1].location[0] for curve in curves)
    places = [low + (high - low) * n / CURVE_CELLS for n in range(CURVE_CELLS + 1)]
    if count == 4:
        places = [mapping.evaluate(curves[3], place) for place in places]
    return [np.array([[mapping.evaluate(curve, place)] for place in places]) for curve in curves[:3]], low, high


def _curved(table: np.ndarray, value: np.ndarray, low: float, high: float, mapping: Any) -> np.ndarray:
    """Values (n, 1) of a curve."""
    share = divide(value - low, np.float64(high - low))
    curved = _look_up(table, clamp(share, 0.0, 1.0))
    if mapping.extend == "EXTRAPOLATED":
        # Linear, with the slopes at the ends.
        curved = curved + CURVE_CELLS * (
            np.minimum(share, 0.0) * (table[1] - table[0]) + np.maximum(share - 1.0, 0.0) * (table[-1] - table[-2])
        )
    return curved


def _look_up(table: np.ndarray, place: np.ndarray, stepped: bool = False) -> np.ndarray:
    """Rows of a table (m, k) at positions (n, 1) in [0, 1], linearly interpolated unless stepped."""
    position = place[:, 0] * (len(table) - 1)
    first = np.minimum(position.astype(np.int64), len(table) - 1)
    if stepped:
        return table[first]
    second = np.minimum(first + 1, len(table) - 1)
    return table[first] + (position - first)[:, None] * (table[second] - table[first])


def _mix(values: "NodeEvaluator", node: Node, output: Socket, groups: Groups) -> np.ndarray:
    kind = {"FLOAT": "Float", "VECTOR": "Vector", "RGBA": "Color"}.get(node.data_type)
    if kind is None:
        raise unsupported(node, f"data type {node.data_type}")
    if kind == "Vector" and node.factor_mode == "NON_UNIFORM":
        factor = values.colour(node, "Factor_Vector", groups)
    else:
        factor = values.number(node, "Factor_Float", groups)
    read = values.number if kind == "Float" else values.colour
    blend = node.blend_type if kind == "Color" else "MIX"
    factor = clamp(factor, 0.0, 1.0) if node.clamp_factor else factor
    return _blend(
        blend,
        factor,
        read(node, f"A_{kind}", groups),
        read(node, f"B_{kind}", groups),
        kind == "Color" and node.clamp_result,
    )


def _mix_rgb(values: "NodeEvaluator", node: Node, output: Socket, groups: Groups) -> np.ndarray:
    factor = clamp(values.number(node, "Fac", groups), 0.0, 1.0)
    return _blend(
        node.blend_type,
        factor,
        values.colour(node, "Color1", groups),
        values.colour(node, "Color2", groups),
        node.use_clamp,
    )


def _blend(blend: str, factor: np.ndarray, first: np.ndarray, second: np.ndarray, clamp_result: bool) -> np.ndarray:
    result = BLENDS[blend](factor, *np.broadcast_arrays(first, second))
    return clamp(result, 0.0, 1.0) if clamp_result else result


SEPARATED = {"RGB": lambda rgb: rgb, "HSV": to_hsv, "HSL": to_hsl}
COMBINED = {"RGB": lambda rgb: rgb, "HSV": from_hsv, "HSL": from_hsl}


def _separate(values: "NodeEvaluator", node: Node, output: Socket, groups: Groups) -> np.ndarray:
    name = "Vector" if node.bl_idname == "ShaderNodeSeparateXYZ" else "Color"
    parts = SEPARATED[getattr(node, "mode", "RGB")](values.colour(node, name, groups))
    return parts[:, [list(node.outputs).index(output)]]


def _combine(values: "NodeEvaluator", node: Node, output: Socket, groups: Groups) -> np.ndarray:
    parts = [values.number(node, socket.identifier, groups) for socket in node.inputs]
    parts = np.concatenate(np.broadcast_arrays(*parts), axis=1)
    return COMBINED[getattr(node, "mode", "RGB")](parts)


def _hue_saturation(values: "NodeEvaluator", node: Node, output: Socket, groups: Groups) -> np.ndarray:
    colour = values.colour(node, "Color", groups)
    hue, saturation, value, factor = (
        values.number(node, name, groups) for name in ("Hue", "Saturation", "Value", "Fac")
    )
    h, s, v = np.split(to_hsv(colour), 3, axis=1)
    parts = np.broadcast_arrays((h + hue + 0.5) % 1.0, np.clip(s * saturation, 0.0, 1.0), v * value)
    changed = from_hsv(np.concatenate(parts, axis=1))
    return np.maximum(colour + factor * (changed - colour), 0.0)


def _rgb_to_bw(values: "NodeEvaluator", node: Node, output: Socket, groups: Groups) -> np.ndarray:
    return luminance(values.colour(node, "Color", groups))


def _gamma(values: "NodeEvaluator", node: Node, output: Socket, groups: Groups) -> np.ndarray:
    colour, power = values.colour(node, "Color", groups), values.number(node, "Gamma", groups)
    return np.where(colour > 0.0, np.power(np.maximum(colour, 0.0), power), colour)


def _invert(values: "NodeEvaluator", node: Node, output: Socket, groups: Groups) -> np.ndarray:
    colour, factor = values.colour(node, "Color", groups), values.number(node, "Fac", groups)
    return colour + factor * (1.0 - 2.0 * colour)


def _bright_contrast(values: "NodeEvaluator", node: Node, output: Socket, groups: Groups) -> np.ndarray:
    contrast = values.number(node, "Contrast", groups)
    bright = values.number(node, "Bright", groups)
    return np.maximum(values.colour(node, "Color", groups) * (1.0 + contrast) + bright - contrast * 0.5, 0.0)


def _attribute(values: "NodeEvaluator", node: Node, output: Socket, groups: Groups) -> np.ndarray:
    of_object = getattr(node, "object_value", None)
    if of_object is not None:
        colour = np.array([of_object[:3]])
        if output.identifier == "Alpha":
            return np.full((1, 1), of_object[3])
        return colour.mean(axis=1, keepdims=True) if output.type == "VALUE" else colour
    if node.attribute_type != "GEOMETRY" or output.identifier == "Alpha":
        raise unsupported(node, f"{output.name} of type {node.attribute_type}")
    found = values.points.attribute(node.attribute_name, node)
    # The mean of a vector's components is its factor.
    return found.mean(axis=1, keepdims=True) if output.type == "VALUE" else found


def _volume_info(values: "NodeEvaluator", node: Node, output: Socket, groups: Groups) -> np.ndarray:
    return values.points.attribute(output.identifier.lower(), node)


def _texture_coordinate(values: "NodeEvaluator", node: Node, output: Socket, groups: Groups) -> np.ndarray:
    if output.identifier == "Object" and node.object is None:
        return values.points.coordinates("object", node)
    if output.identifier == "Object":
        matrix = np.array(node.object.matrix_world)
        if not np.linalg.det(matrix):
            raise unsupported(node, "an object of scale 0")
        inverse = affine_inverse(matrix)
        return values.points.coordinates("world", node) @ inverse[:3, :3].T + inverse[:3, 3]
    if output.identifier == "Generated" and not node.from_instancer:
        return values.points.coordinates("generated", node)
    raise unsupported(node, f"output {output.name}")


def _geometry(values: "NodeEvaluator", node: Node, output: Socket, groups: Groups) -> np.ndarray:
    if output.identifier != "Position":
        raise unsupported(node, f"output {output.name}")
    return values.points.coordinates("world", node)


def _light_path(values: "NodeEvaluator", node: Node, output: Socket, groups: Groups) -> np.ndarray:
    # Only a World knows which ray evaluates it.
    seen = getattr(values.points, "visible_to_camera", None)
    if seen is None or output.identifier != "Is Camera Ray":
        raise unsupported(node, f"output {output.name}")
    return np.full((1, 1), float(seen))


def _light_falloff(values: "NodeEvaluator", node: Node, output: Socket, groups: Groups) -> np.ndarray:
    # What is brighter or darker at other distances is no light that falls off with their square.
    if not getattr(values.points, "is_lamp", False):
        raise unsupported(node, "what has no place")
    if output.identifier != "Quadratic" or values.number(node, "Smooth", groups).any():
        raise unsupported(node, "any other falloff than Quadratic with a Smooth of 0")
    return values.number(node, "Strength", groups)


def _mapping(values: "NodeEvaluator", node: Node, output: Socket, groups: Groups) -> np.ndarray:
    vector, scale = values.colour(node, "Vector", groups), values.colour(node, "Scale", groups)
    turn = euler_matrices(values.colour(node, "Rotation", groups))
    if node.vector_type == "VECTOR":
        return rotated(turn, vector * scale)
    if node.vector_type == "NORMAL":
        turned = rotated(turn, divide(vector, scale))
        return divide(turned, np.linalg.norm(turned, axis=1, keepdims=True))
    location = values.colour(node, "Location", groups)
    if node.vector_type == "TEXTURE":
        return divide(rotated(turn.swapaxes(1, 2), vector - location), scale)
    return rotated(turn, vector * scale) + location


AXES = {"X_AXIS": (1.0, 0.0, 0.0), "Y_AXIS": (0.0, 1.0, 0.0), "Z_AXIS": (0.0, 0.0, 1.0)}


def _vector_rotate(values: "NodeEvaluator", node: Node, output: Socket, groups: Groups) -> np.ndarray:
    vector, centre = (values.colour(node, name, groups) for name in ("Vector", "Center"))
    if node.rotation_type == "EULER_XYZ":
        turn = euler_matrices(values.colour(node, "Rotation", groups))
        return rotated(turn.swapaxes(1, 2) if node.invert else turn, vector - centre) + centre
    fixed = AXES.get(node.rotation_type)
    axis = values.colour(node, "Axis", groups) if fixed is None else np.array([fixed])
    angle = values.number(node, "Angle", groups)
    return about_axis(vector - centre, axis, -angle if node.invert else angle) + centre


def _normal(values: "NodeEvaluator", node: Node, output: Socket, groups: Groups) -> np.ndarray:
    # Its output's value is the direction that the node shows.
    shown = next(socket for socket in node.outputs if socket.identifier == "Normal")
    direction = np.array(shown.default_value, np.float64)[None, :3]
    direction = divide(direction, np.linalg.norm(direction))
    if output.identifier == "Normal":
        return direction
    vector = values.colour(node, "Normal", groups)
    return (direction * divide(vector, np.linalg.norm(vector, axis=1, keepdims=True))).sum(axis=1, keepdims=True)


FUNCTIONS = {
    "ShaderNodeValue": _value_node,
    "ShaderNodeRGB": _value_node,
    "ShaderNodeMath": _math,
    "ShaderNodeVectorMath": _vector_math,
    "ShaderNodeMapRange": _map_range,
    "ShaderNodeClamp": _clamp,
    "ShaderNodeBlackbody": _blackbody,
    "ShaderNodeValToRGB": _color_ramp,
    "ShaderNodeFloatCurve": _float_curve,
    "ShaderNodeRGBCurve": _colour_curves,
    "ShaderNodeVectorCurve": _colour_curves,
    "ShaderNodeHueSaturation": _hue_saturation,
    "ShaderNodeNormal": _normal,
    "ShaderNodeVectorRotate": _vector_rotate,
    "ShaderNodeMix": _mix,
    "ShaderNodeMixRGB": _mix_rgb,
    "ShaderNodeSeparateXYZ": _separate,
    "ShaderNodeSeparateColor": _separate,
    "ShaderNodeCombineXYZ": _combine,
    "ShaderNodeCombineColor": _combine,
    "ShaderNodeRGBToBW": _rgb_to_bw,
    "ShaderNodeGamma": _gamma,
    "ShaderNodeInvert": _invert,
    "ShaderNodeBrightContrast": _bright_contrast,
    "ShaderNodeAttribute": _attribute,
    "ShaderNodeVolumeInfo": _volume_info,
    "ShaderNodeTexCoord": _texture_coordinate,
    "ShaderNodeNewGeometry": _geometry,
    "ShaderNodeLightPath": _light_path,
    "ShaderNodeLightFalloff": _light_falloff,
    "ShaderNodeMapping": _mapping,
    **TEXTURES,
}
