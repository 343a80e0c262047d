# SPDX-License-Identifier: GPL-3.0-or-later
"""The structures of the kernels' headers, as classes of ctypes.

They are read from the headers when this module is imported: `structures.Grid`, with the fields of its declaration.
"""

import ctypes
import functools
import re
from collections.abc import Sequence
from ctypes import c_double, c_int64, c_void_p
from pathlib import Path
from typing import Any

import numpy as np


class Shared(ctypes.Structure):
    """A structure that keeps alive what its pointers point to."""

    def __init__(self, **fields: Any):
        """Arrays become pointers or, where the structure holds their numbers itself, copies; tuples become pointers.

        Pointers to arrays that are not C-contiguous are given as addresses.
        """
        super().__init__()
        self.fields, self.referenced = fields, list[Any]()
        types = _types(type(self))
        for name, value in fields.items():
            if types[name] is c_void_p:
                value = self._pointer(value)
            elif issubclass(types[name], ctypes.Array) and isinstance(value, np.ndarray):
                value = types[name](*value.ravel().tolist())
            elif issubclass(types[name], ctypes.Array) and isinstance(value, tuple):
                value = types[name](*map(self._pointer, value))
            elif isinstance(value, Shared):
                self.referenced.append(value)
            elif isinstance(value, np.bool_):
                # Which numpy no longer takes for a whole number.
                value = bool(value)
            setattr(self, name, value)

    def _pointer(self, value: Any) -> int | None:
        if value is None or isinstance(value, int):
            return value
        self.referenced.append(value)
        if isinstance(value, np.ndarray):
            if not value.flags.c_contiguous:
                raise ValueError("a kernel reads arrays in the order of C")
            return value.ctypes.data
        return ctypes.addressof(value)


@functools.cache
def _types(structure: type[Shared]) -> dict[str, Any]:
    """Types of a structure's fields, by name."""
    return {field[0]: field[1] for field in structure._fields_}


def array_of(values: list) -> ctypes.Array | None:
    """An array of structures, which keeps alive what they point to; None if there are none."""
    if not values:
        return None
    array = (type(values[0]) * len(values))(*values)
    # ctypes copies the structures, not the Python attributes of their objects.
    array.referenced = values
    return array


def instances_of(values: list, numbers: Sequence[int], **fields: np.ndarray) -> ctypes.Array | None:
    """As `array_of`, of copies of some structures, by number, with float64 fields (N, ...) of their own."""
    rows = rows_of(array_of(values), numbers)
    if rows is None:
        return None
    kind = type(values[0])
    for name, own in fields.items():
        held = np.ascontiguousarray(own, np.float64).reshape(len(rows), -1).view(np.uint8)
        start = getattr(kind, name).offset
        rows[:, start : start + held.shape[1]] = held
    array = (kind * len(rows)).from_buffer_copy(rows)
    array.referenced = values
    return array


def rows_of(array: Any, numbers: Sequence[int]) -> np.ndarray | None:
    """Copies of some structures of an `array_of`, by number, which must outlive them; None for None."""
    if array is None:
        return None
    size = ctypes.sizeof(array._type_)
    return np.frombuffer(array, np.uint8).reshape(-1, size)[np.asarray(numbers, np.int64)]


def copied(structure: Shared, **fields: Any) -> Shared:
    """A copy of a structure with other fields, which keeps alive what the structure does."""
    copy = type(structure)(**fields)
    for name in structure.fields.keys() - fields:
        setattr(copy, name, getattr(structure, name))
    copy.referenced.append(structure)
    return copy


def pointers_to(values: Sequence[Shared | None]) -> ctypes.Array:
    """Pointers to structures, which it keeps alive, or to nothing."""
    array: Any = (c_void_p * len(values))(*(None if value is None else ctypes.addressof(value) for value in values))
    array.referenced = values
    return array


def _read(*headers: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Structures and whole-number constants of some headers, and the structure that each function takes, by name."""
    defined: dict[str, Any] = {}
    texts = [(Path(__file__).parent / header).read_text() for header in headers]
    text = re.sub(r"/\*.*?\*/|\\\n", "", "".join(texts), flags=re.DOTALL)
    for name, number, body, structure in re.findall(
        r"#define MRPNN_(\w+) (\d+)$|typedef struct {([^}]*)} (\w+);", text, flags=re.MULTILINE
    ):
        if structure:
            fields = [field for line in body.split(";")[:-1] for field in _fields(line, defined)]
            defined[structure] = type(structure, (Shared,), {"_fields_": fields})
        else:
            defined[name] = int(number)
    return defined, {name: defined[structure] for name, structure in re.findall(r" X\((\w+), (?:const )?(\w+)\)", text)}


def _fields(line: str, defined: dict[str, Any]) -> list[tuple[str, Any]]:
    """Fields of a line of declarations, such as `const double *nodes, areas[4]`; defined: structures and constants."""
    kind, declared = re.match(r"\s*((?:\w+ )*\w+) (.*)", line, flags=re.DOTALL).groups()  # type: ignore[union-attr]
    fields = []
    for declaration in declared.split(","):
        pointer, name, size = re.match(r"\s*([*\w ]*[* ])?(\w+)(?:\[(\w+)\])?", declaration).groups()  # type: ignore[union-attr]
        kinds = {"double": c_double, "int64_t": c_int64, **defined}
        field = c_void_p if pointer else kinds[kind.split()[-1]]
        count = defined.get(size.removeprefix("MRPNN_")) if size and size.startswith("MRPNN_") else size
        fields.append((name, field * int(count) if count else field))
    return fields


_DEFINED, FUNCTIONS = _read("kernels.h", "fields.h")


def __getattr__(name: str) -> Any:
    """A structure, or a constant without its prefix."""
    if name in _DEFINED:
        return _DEFINED[name]
    raise AttributeError(f"the kernels' headers have no {name}")
