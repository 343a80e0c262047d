# SPDX-License-Identifier: GPL-3.0-or-later
"""Shader node trees, evaluated as Cycles evaluates them, at many points at once.

A value is a float64 array (n, k): one row per point, or one row where it is uniform; k is 1 for a number and 3 for a
colour or vector.
"""

from typing import NoReturn, Protocol

import numpy as np

from .colour_operations import luminance
from .functions import FUNCTIONS
from .sockets import Groups, Node, Socket, Source, Unsupported, input_of, source_of


class Points(Protocol):
    """What nodes read besides other nodes, at n points; raises Unsupported for what is not known there."""

    def attribute(self, name: str, node: Node) -> np.ndarray:
        """(n, k)."""

    def coordinates(self, kind: str, node: Node) -> np.ndarray:
        """(n, 3)."""


class NodeEvaluator:
    """Evaluates sockets at one set of points, each output once.

    points: see `volumes.voxel_points`.
    """

    def __init__(self, points: Points) -> None:
        self.points = points
        self._known: dict[tuple, np.ndarray] = {}

    def number(self, node: Node, identifier: str, groups: Groups = ()) -> np.ndarray:
        """(n, 1) value of an input socket, converted to a number as in Cycles.

        Raises Unsupported, naming the node, where it cannot be evaluated.
        """
        return as_number(*self._value(input_of(node, identifier), groups))

    def colour(self, node: Node, identifier: str, groups: Groups = ()) -> np.ndarray:
        """(n, 3) value of an input socket as a colour or vector. Raises as `number`."""
        return as_colour(self._value(input_of(node, identifier), groups)[0])

    def is_linked(self, node: Node, identifier: str, groups: Groups = ()) -> bool:
        """Whether another node drives the socket."""
        return source_of(input_of(node, identifier), groups).node is not None

    def _value(self, socket: Socket, groups: Groups) -> tuple[np.ndarray, str]:
        """The value of a socket and its type."""
        source = source_of(socket, groups)
        if source.node is not None:
            value, kind = self._output(source), source.output.type
        elif source.socket is not None:
            value, kind = _own_value(source.socket), source.socket.type
        else:
            value, kind = np.zeros((1, 1)), "VALUE"
        # Each socket converts: a colour that passes through a number becomes grey.
        for passed in source.passed:
            value, kind = _converted(value, kind, passed), passed
        return value, kind

    def _output(self, source: Source) -> np.ndarray:
        node, output = source.node, source.output
        key = (node.as_pointer(), output.identifier, tuple(group.as_pointer() for group in source.groups))
        if key not in self._known:
            function = FUNCTIONS.get(node.bl_idname)
            if function is None:
                raise Unsupported(
                    f'node "{node.name}" ({node.bl_label}) cannot be evaluated; unlink it and enter a value'
                )
            with np.errstate(all="ignore"):
                self._known[key] = function(self, node, output, source.groups)
        return self._known[key]


def as_number(value: np.ndarray, kind: str) -> np.ndarray:
    """(n, 1): the luminance of a colour, the mean component of a vector."""
    if value.shape[1] == 1:
        return value
    return luminance(value) if kind == "RGBA" else value.mean(axis=1, keepdims=True)


def as_colour(value: np.ndarray) -> np.ndarray:
    """(n, 3): a number becomes grey."""
    return value if value.shape[1] == 3 else np.repeat(value, 3, axis=1)


def _converted(value: np.ndarray, kind: str, passed: str) -> np.ndarray:
    """A value of one type as a socket of another passes it on."""
    if passed not in ("VALUE", "INT", "BOOLEAN"):
        return as_colour(value)
    number = as_number(value, kind)
    return number if passed == "VALUE" else np.trunc(number)


def _own_value(socket: Socket) -> np.ndarray:
    if not hasattr(socket, "default_value"):
        raise Unsupported(f'socket {socket.name} of node "{socket.node.name}" holds no value')
    value = socket.default_value
    if isinstance(value, (int, float)):
        return np.full((1, 1), float(value))
    return np.array(value, dtype=np.float64)[None, :3]


class Nowhere:
    """Points without positions or attributes: nodes that read either cannot be evaluated."""

    def attribute(self, name: str, node: Node) -> NoReturn:
        raise Unsupported(
            f'node "{node.name}" ({node.bl_label}) varies in space, which is not supported here; '
            "unlink it and enter a value"
        )

    def coordinates(self, kind: str, node: Node) -> NoReturn:
        self.attribute(kind, node)
