# SPDX-License-Identifier: GPL-3.0-or-later
"""ONNX files: their graph, weights and metadata, as far as this project's networks need them.

An ONNX file is a protocol buffer: fields of a number and a value, which is an integer of variable length, four or
eight bytes, or bytes after their length. A message is the bytes of its own fields.
https://protobuf.dev/programming-guides/encoding/ and https://github.com/onnx/onnx/blob/main/onnx/onnx.proto
"""

import struct
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

# Types of tensors: TensorProto.DataType.
DTYPES: dict[int, np.dtype[Any]] = {1: np.dtype("<f4"), 6: np.dtype("<i4"), 7: np.dtype("<i8")}
# Wire types.
VARINT, EIGHT_BYTES, LENGTH, FOUR_BYTES = 0, 1, 2, 5


class MalformedFile(ValueError):
    """A file that is no ONNX file, or holds fields, types or operators that are not supported."""


@dataclass(frozen=True)
class Input:
    """An input of a graph. type: as onnxruntime writes it, "tensor(float)". shape: numbers, and names of free axes."""

    name: str
    type: str
    shape: tuple[int | str, ...]


@dataclass(frozen=True)
class Node:
    """An operation. inputs, outputs: names; an input that is left out is "". attributes: by name."""

    operation: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    attributes: dict[str, Any]


@dataclass(frozen=True)
class Model:
    """A graph with its weights. nodes: in an order in which each follows its inputs. metadata: texts by key."""

    inputs: tuple[Input, ...]
    outputs: tuple[str, ...]
    nodes: tuple[Node, ...]
    weights: dict[str, np.ndarray]
    metadata: dict[str, str]


def read_model(content: bytes) -> Model:
    """The model in an ONNX file's bytes. Raises MalformedFile."""
    try:
        model = _fields(content)
        graph = _fields(model[7][0])
        weights = dict(_tensor(data) for data in graph[5])
        return Model(
            inputs=tuple(_input(data) for data in graph[11]),
            outputs=tuple(_fields(data)[1][0].decode() for data in graph[12]),
            nodes=tuple(_node(data) for data in graph[1]),
            weights=weights,
            metadata={entry[1][0].decode(): entry[2][0].decode() for entry in map(_fields, model[14])},
        )
    except (IndexError, KeyError, TypeError, AttributeError, UnicodeDecodeError, struct.error) as error:
        raise MalformedFile(f"this is no ONNX file that is known here ({error})") from error


def _fields(message: bytes) -> defaultdict[int, list[Any]]:
    """Values of a message by field number: integers, and bytes for everything else."""
    fields: defaultdict[int, list[Any]] = defaultdict(list)
    position = 0
    while position < len(message):
        tag, position = _varint(message, position)
        wire = tag & 7
        value: int | bytes
        if wire == VARINT:
            value, position = _varint(message, position)
        else:
            if wire == LENGTH:
                size, position = _varint(message, position)
            elif wire in (EIGHT_BYTES, FOUR_BYTES):
                size = 8 if wire == EIGHT_BYTES else 4
            else:
                raise MalformedFile(f"wire type {wire} is unknown")
            value = message[position : position + size]
            if len(value) < size:
                raise MalformedFile("the file ends early")
            position += size
        fields[tag >> 3].append(value)
    return fields


def _varint(message: bytes, position: int) -> tuple[int, int]:
    """An integer of seven bits a byte, the lowest first, and the position behind it."""
    value = shift = 0
    while True:
        byte = message[position]
        value |= (byte & 127) << shift
        position, shift = position + 1, shift + 7
        if byte < 128:
            return value, position
        if shift > 63:
            raise MalformedFile("an integer has more than 64 bits")


def _signed(value: int) -> int:
    return value - (1 << 64) if value >= 1 << 63 else value


def _integers(values: list[Any]) -> Iterator[int]:
    """Repeated integers, packed into bytes or not."""
    for value in values:
        if isinstance(value, int):
            yield _signed(value)
            continue
        position = 0
        while position < len(value):
            packed, position = _varint(value, position)
            yield _signed(packed)


def _tensor(data: bytes) -> tuple[str, np.ndarray]:
    """Name and read-only array of a TensorProto."""
    fields = _fields(data)
    if fields[13] or fields[14]:
        raise MalformedFile("its weights are in another file")
    kind = fields[2][0]
    if kind not in DTYPES:
        raise MalformedFile(f"tensors of type {kind} are unknown")
    dtype = DTYPES[kind]
    if fields[9]:
        values = np.frombuffer(fields[9][0], dtype)
    elif kind == 1:
        values = np.frombuffer(b"".join(fields[4]), dtype)
    else:
        values = np.array(list(_integers(fields[5 if kind == 6 else 7])), dtype)
    shape = tuple(_integers(fields[1]))
    if values.size != int(np.prod(shape, dtype=np.int64)):
        raise MalformedFile(f"a tensor of shape {shape} holds {values.size} numbers")
    values.flags.writeable = False
    return fields[8][0].decode(), values.reshape(shape)


def _input(data: bytes) -> Input:
    fields = _fields(data)
    tensor = _fields(_fields(fields[2][0])[1][0])
    dimensions = [_fields(dimension) for dimension in _fields(tensor[2][0])[1]]
    shape = tuple(size[2][0].decode() if size[2] else _signed(size[1][0]) for size in dimensions)
    return Input(
        name=fields[1][0].decode(),
        type={1: "tensor(float)", 6: "tensor(int32)", 7: "tensor(int64)"}[tensor[1][0]],
        shape=shape,
    )


def _node(data: bytes) -> Node:
    fields = _fields(data)
    return Node(
        operation=fields[4][0].decode(),
        inputs=tuple(name.decode() for name in fields[1]),
        outputs=tuple(name.decode() for name in fields[2]),
        attributes=dict(_attribute(attribute) for attribute in fields[5]),
    )


def _attribute(data: bytes) -> tuple[str, Any]:
    """Name and value of an AttributeProto: a number, a tensor, or numbers."""
    fields = _fields(data)
    name, kind = fields[1][0].decode(), fields[20][0]
    if kind == 1:
        return name, struct.unpack("<f", fields[2][0])[0]
    if kind == 2:
        # A value of 0 may be left out.
        return name, _signed(fields[3][0]) if fields[3] else 0
    if kind == 4:
        return name, _tensor(fields[5][0])[1]
    if kind == 7:
        return name, tuple(_integers(fields[8]))
    raise MalformedFile(f"attribute {name} is of unknown type {kind}")
