# SPDX-License-Identifier: GPL-3.0-or-later
"""The structures of kernels.h."""

import ctypes
import functools
from collections.abc import Sequence
from ctypes import c_double, c_int64, c_void_p
from typing import Any

import numpy as np

INTERFACE = 20
CHANNELS = 3
PHASES = 8192


class Shared(ctypes.Structure):
    """A structure that keeps alive what its pointers point to."""

    def __init__(self, **fields: Any):
        """Arrays become pointers or, where the structure holds their numbers itself, copies; tuples become pointers."""
        super().__init__()
        self.kept: list[Any] = []
        types = _types(type(self))
        for name, value in fields.items():
            if types[name] is c_void_p:
                value = self._pointer(value)
            elif issubclass(types[name], ctypes.Array) and isinstance(value, np.ndarray):
                value = types[name](*value.ravel().tolist())
            elif issubclass(types[name], ctypes.Array) and isinstance(value, tuple):
                value = types[name](*map(self._pointer, value))
            elif isinstance(value, Shared):
                self.kept.append(value)
            elif isinstance(value, np.bool_):
                # Which numpy no longer takes for a whole number.
                value = bool(value)
            setattr(self, name, value)

    def _pointer(self, value: Any) -> int | None:
        if value is None:
            return None
        self.kept.append(value)
        if isinstance(value, np.ndarray):
            assert value.flags.c_contiguous
            return value.ctypes.data
        return ctypes.addressof(value)


@functools.cache
def _types(structure: type[Shared]) -> dict[str, Any]:
    """Types of a structure's fields, by name."""
    return {field[0]: field[1] for field in structure._fields_}


class Grid(Shared):
    """See kernels.h, as for the others."""

    _fields_ = [
        ("values", c_void_p),
        ("table", c_void_p),
        ("size", c_int64 * 3),
        ("shape", c_int64 * 3),
        ("first", c_int64 * 3),
        ("rows", c_int64),
    ]


class Occupancy(Shared):
    _fields_ = [
        ("clearance", c_void_p),
        ("peaks", c_void_p),
        ("size", c_int64 * 3),
        ("first", c_double * 3),
        ("scale", c_double),
    ]


class SunColumns(Shared):
    _fields_ = [
        ("depths", c_void_p),
        ("table", c_void_p),
        ("offsets", c_void_p),
        ("slices", c_int64),
        ("size", c_int64 * 2),
        ("tiles", c_int64),
        ("first", c_int64),
        ("main", c_int64),
        ("others", c_int64 * 2),
        ("step", c_int64),
        ("integrated", c_int64),
        ("everywhere", c_int64),
        ("steep", c_int64),
        ("move", c_double * 3),
        ("length", c_double),
        ("direction", c_double * 3),
    ]


class Medium(Shared):
    _fields_ = [
        ("density", Grid),
        ("held", c_void_p),
        ("occupancy", Occupancy),
        ("suns", c_void_p),
        ("phase", c_void_p),
        ("linear", c_double * 9),
        ("offset", c_double * 3),
        ("sigma_t", c_double),
        ("emission", Grid * CHANNELS),
        ("emission_power", c_int64),
        ("emission_factor", c_double),
        ("varies", c_int64),
        ("scattering", Grid * CHANNELS),
    ]


class Pyramid(Shared):
    _fields_ = [
        ("depths", c_void_p),
        ("starts", c_void_p),
        ("slices", c_int64),
        ("size", c_int64 * 2),
        ("first", c_double * 2),
        ("spacing", c_double * 2),
    ]


class LampColumns(Shared):
    _fields_ = [
        ("density", Grid),
        ("pyramids", Pyramid * 6),
        ("lamp", c_double * 3),
        ("world_from_index", c_double * 9),
        ("integrated", c_int64),
        ("centre", c_double * 3),
        ("radius", c_double),
        ("offset", c_double * 3),
        ("soft_falloff", c_int64),
        ("around", c_double),
        ("uneven", c_int64),
        ("excess", c_void_p),
    ]


class LampShadowMap(Shared):
    _fields_ = [
        ("distances", c_void_p),
        ("cells", c_int64),
        ("position", c_double * 3),
        ("frames", c_double * 54),
    ]


class Emitter(Shared):
    _fields_ = [
        ("flat", c_int64),
        ("position", c_double * 3),
        ("extent", c_double),
        ("centre", c_double * 3),
        ("radius", c_double),
        ("intensity", c_double),
        ("closest", c_double),
        ("soft_falloff", c_int64),
        ("cone", c_int64),
        ("axis", c_double * 3),
        ("cosine", c_double),
        ("width", c_double),
        ("corners", c_double * 12),
        ("normal", c_double * 3),
        ("radiance", c_double),
        ("area", c_double),
        ("nodes", c_double * 12),
        ("areas", c_double * 4),
        ("far", c_double),
        ("tangent", c_double),
        ("focus", c_double),
        ("focused", c_double),
    ]


class Lamp(Shared):
    _fields_ = [
        ("emitters", c_int64),
        ("parts", c_void_p),
        ("columns", c_void_p),
        ("shadow_maps", c_void_p),
        ("centre", c_double * 3),
        ("reach", c_double),
        ("smooth", c_double),
        ("mean", c_void_p),
        ("mean_from", c_double),
    ]


class ShadowMap(Shared):
    _fields_ = [
        ("heights", c_void_p),
        ("rows", c_int64),
        ("columns", c_int64),
        ("linear", c_double * 9),
        ("offset", c_double * 3),
    ]


class Fluence(Shared):
    _fields_ = [
        ("lights", c_void_p),
        ("scales", c_void_p),
        ("cells", c_int64),
        ("linear", c_double * 9),
        ("offset", c_double * 3),
        ("flux_from_world", c_double * 9),
        ("reduced_fraction", c_double),
    ]


class Scene(Shared):
    _fields_ = [
        ("volumes", c_int64),
        ("suns", c_int64),
        ("groups", c_int64),
        ("channels", c_int64),
        ("varying", c_int64),
        ("scattering", c_int64),
        ("media", c_void_p),
        ("group_starts", c_void_p),
        ("group_members", c_void_p),
        ("shadow_maps", c_void_p),
        ("fluence", c_void_p),
        ("lamps", c_int64),
        ("lamp_list", c_void_p),
        ("lamp_fluence", c_void_p),
        ("lamp_radius", c_double),
        ("brief", c_double),
        ("wide", c_double),
        ("wide_count", c_int64),
        ("wide_nodes", c_void_p),
        ("wide_weights", c_void_p),
        ("nodes", c_void_p),
        ("node_weights", c_void_p),
        ("depth_samples", c_int64),
        ("most_detail", c_int64),
        ("adaptive", c_int64),
        ("coarse_count", c_int64),
        ("skip_empty", c_int64),
        ("step_thickness", c_double),
        ("step_growth", c_double),
        ("peak_thickness", c_double),
        ("peak_growth", c_double),
        ("finest", c_double),
        ("behind", c_double),
        ("behind_emission", c_double),
        ("min_alpha", c_double),
        ("dark", c_double),
        ("visible", c_double),
        ("max_sun_depth", c_double),
        ("max_tau_sun", c_double),
        ("max_tau_ahead", c_double),
        ("scales", c_double * 3),
        ("jitter", c_double * 3),
    ]


class Rays(Shared):
    _fields_ = [
        ("rays", c_int64),
        ("origins", c_void_p),
        ("directions", c_void_p),
        ("near_distance", c_void_p),
        ("far_distance", c_void_p),
        ("counts", c_void_p),
        ("detail", c_void_p),
        ("max_count", c_int64),
        ("stop", c_void_p),
        ("scratch", c_void_p),
    ]


class Gathered(Shared):
    _fields_ = [
        ("alpha", c_void_p),
        ("depth", c_void_p),
        ("optical_depth", c_void_p),
        ("single_scattering", c_void_p),
        ("lamp_scattering", c_void_p),
        ("scattering_depth", c_void_p),
        ("emission", c_void_p),
        ("sample_counts", c_void_p),
        ("sample_distance", c_void_p),
        ("sample_weight", c_void_p),
        ("sample_fraction", c_void_p),
        ("sample_scattering", c_void_p),
        ("sample_features", c_void_p),
        ("lamp_features", c_void_p),
        ("samples", c_int64),
        ("blocks", c_int64),
    ]


def array_of(values: list) -> ctypes.Array | None:
    """An array of structures, which keeps alive what they point to; None if there are none."""
    if not values:
        return None
    array = (type(values[0]) * len(values))(*values)
    # ctypes copies the structures, not the Python attributes of their objects.
    array.kept = values
    return array


def pointers_to(values: Sequence[Shared | None]) -> ctypes.Array:
    """Pointers to structures, which it keeps alive, or to nothing."""
    array: Any = (c_void_p * len(values))(*(None if value is None else ctypes.addressof(value) for value in values))
    array.kept = values
    return array
