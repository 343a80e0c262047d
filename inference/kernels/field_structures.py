# SPDX-License-Identifier: GPL-3.0-or-later
"""The structures of fields.h, and the functions that take them."""

from ctypes import c_double, c_int64, c_void_p

from .structures import Grid, Occupancy, Pyramid, Shared

#: Columns that a slice reaches beyond its cells.
MORE = 3


class ColumnSweep(Shared):
    """See fields.h, as for the others."""

    _fields_ = [
        ("density", c_void_p),
        ("shape", c_int64 * 3),
        ("strides", c_int64 * 3),
        ("count", c_int64),
        ("slices", c_void_p),
        ("starts", c_void_p),
        ("weights", c_void_p),
        ("fractions", c_void_p),
        ("half_step", c_double),
        ("columns", c_void_p),
        ("size", c_int64 * 2),
        ("depths", c_void_p),
        ("depth_strides", c_int64 * 3),
        ("scratch", c_void_p),
    ]


class BlockSweep(Shared):
    _fields_ = [
        ("values", c_void_p),
        ("rows", c_int64),
        ("strides", c_int64 * 3),
        ("blocks", c_int64),
        ("block_rows", c_void_p),
        ("block_places", c_void_p),
        ("slices", c_void_p),
        ("starts", c_void_p),
        ("weights", c_void_p),
        ("half_step", c_double),
        ("columns", c_void_p),
        ("size", c_int64 * 2),
        ("touched", c_int64),
        ("tiles", c_void_p),
        ("depths", c_void_p),
    ]


class OpenDepthSamples(Shared):
    _fields_ = [
        ("points", c_int64),
        ("positions", c_void_p),
        ("directions", c_int64),
        ("towards", c_void_p),
        ("samples", c_int64),
        ("middles", c_void_p),
        ("lengths", c_void_p),
        ("sampled", c_void_p),
        ("levels", c_void_p * 2),
        ("cells", c_void_p),
        ("strides", c_void_p),
        ("reach", c_double),
        ("lattice", c_void_p),
        ("edge", c_int64),
        ("depths", c_void_p),
    ]


class OrdinateSweep(Shared):
    _fields_ = [
        ("cells", c_int64),
        ("axis", c_int64),
        ("sign", c_int64),
        ("directions", c_int64),
        ("steps", c_void_p),
        ("kinds", c_void_p),
        ("emit", c_void_p),
        ("gather", c_void_p),
        ("field", c_void_p),
        ("beams", c_void_p),
        ("leaving", c_void_p),
        ("within", c_void_p),
        ("links", c_void_p),
        ("entering", c_void_p),
        ("sums", c_void_p),
        ("scratch", c_void_p),
    ]


class RadianceSweep(Shared):
    _fields_ = [
        ("shape", c_int64 * 3),
        ("strides", c_int64 * 3),
        ("directions", c_int64),
        ("slopes", c_void_p),
        ("weights", c_void_p),
        ("kinds", c_void_p),
        ("passed", c_void_p),
        ("mean", c_void_p),
        ("given", c_void_p),
        ("added", c_void_p),
        ("cells", c_int64),
        ("first", c_int64),
        ("fluence", c_void_p * 4),
        ("scratch", c_void_p),
    ]


class MomentSweep(Shared):
    _fields_ = [
        ("shape", c_int64 * 3),
        ("strides", c_int64 * 3),
        ("first", c_int64),
        ("kinds", c_void_p),
        ("slopes", c_void_p),
        ("along", c_void_p),
        ("weights", c_void_p),
        ("passed", c_void_p),
        ("mean", c_void_p),
        ("lobes", c_int64),
        ("light", c_void_p),
        ("rows", c_int64),
        ("columns", c_int64),
        ("table", c_void_p),
        ("moments", c_void_p),
        ("scratch", c_void_p),
    ]


class PeakPhotons(Shared):
    _fields_ = [
        ("shape", c_int64 * 3),
        ("depth", c_void_p),
        ("closed", c_void_p),
        ("lamp", c_double * 3),
        ("axis", c_double * 3),
        ("cosine", c_double),
        ("photons", c_int64),
        ("starts", c_void_p),
        ("numbers", c_void_p),
        ("collisions", c_int64),
        ("anisotropy", c_double),
        ("reduced", c_double),
        ("wide", c_double),
        ("albedo", c_double),
        ("sums", c_void_p),
    ]


class LightPaths(Shared):
    _fields_ = [
        ("volumes", c_int64),
        ("channels", c_int64),
        ("media", c_void_p),
        ("majorants", c_void_p),
        ("anisotropies", c_void_p),
        ("albedos", c_void_p),
        ("rays", c_int64),
        ("origins", c_void_p),
        ("directions", c_void_p),
        ("near_distance", c_void_p),
        ("far_distance", c_void_p),
        ("numbers", c_void_p),
        ("paths", c_int64),
        ("collisions", c_int64),
        ("steps", c_int64),
        ("negligible", c_double),
        ("stop", c_void_p),
        ("light", c_void_p),
        ("leaving", c_void_p),
        ("ends", c_void_p),
    ]


class Diffusion(Shared):
    _fields_ = [
        ("shape", c_int64 * 3),
        ("diagonal", c_void_p),
        ("couplings", c_void_p),
        ("x", c_void_p),
        ("residual", c_void_p),
        ("direction", c_void_p),
        ("product", c_void_p),
        ("rz", c_double),
        ("limit", c_double),
        ("iterations", c_int64),
    ]


class CellMeans(Shared):
    _fields_ = [
        ("density", Grid),
        ("low", c_int64 * 3),
        ("voxels", c_int64 * 3),
        ("cells", c_int64),
        ("widths", c_int64 * 3),
        ("firsts", c_void_p * 3),
        ("weights", c_void_p * 3),
        ("begin", c_int64),
        ("end", c_int64),
        ("out", c_void_p),
        ("strides", c_int64 * 3),
        ("held", c_void_p),
        ("scratch", c_void_p),
    ]


class Halving(Shared):
    _fields_ = [
        ("fine", c_void_p),
        ("fine_strides", c_int64 * 2),
        ("coarse", c_void_p),
        ("coarse_strides", c_int64 * 2),
        ("size", c_int64 * 3),
    ]


class Refinement(Shared):
    _fields_ = [("values", c_void_p), ("shape", c_int64 * 3), ("below", c_void_p * 3), ("share", c_void_p * 3)]


class LatticePart(Shared):
    _fields_ = [
        ("shape", c_int64 * 3),
        ("density", Refinement),
        ("depth", Refinement),
        ("visibility", Refinement),
        ("density_scale", c_double),
        ("density_step", c_double),
        ("depth_scale", c_double),
        ("least_visible", c_double),
        ("packed", c_void_p),
        ("columns", c_int64),
        ("scratch", c_void_p),
    ]


class Resampling(Shared):
    _fields_ = [
        ("grid", Grid),
        ("occupancy", Occupancy),
        ("power", c_int64),
        ("shape", c_int64 * 3),
        ("linear", c_double * 9),
        ("offset", c_double * 3),
        ("points", c_int64),
        ("places", c_void_p),
        ("out", c_void_p),
        ("strides", c_int64 * 3),
    ]


class LampSlices(Shared):
    _fields_ = [
        ("density", Grid),
        ("pyramid", Pyramid),
        ("axis", c_int64),
        ("lamp", c_double * 3),
        ("inside", c_int64),
        ("planes", c_int64),
        ("numbers", c_void_p),
        ("slices", c_void_p),
        ("ways", c_void_p),
        ("running", c_void_p),
        ("scratch", c_void_p),
        ("cells", c_void_p),
    ]


class LampDepths(Shared):
    _fields_ = [
        ("columns", c_void_p),
        ("points", c_int64),
        ("index", c_void_p),
        ("sigma_t", c_double),
        ("out", c_void_p),
    ]


class LampBeam(Shared):
    _fields_ = [
        ("lamp", c_int64),
        ("columns", c_void_p),
        ("emitters", c_void_p),
        ("shadow_maps", c_void_p),
        ("shape", c_int64 * 3),
        ("first", c_int64 * 3),
        ("count", c_int64),
        ("numbers", c_void_p),
        ("parts", c_int64),
        ("world", c_double * 9),
        ("offset", c_double * 3),
        ("sigma", c_double),
        ("radius", c_double),
        ("light", c_void_p),
        ("open", c_void_p),
    ]


class LampFluence(Shared):
    _fields_ = [
        ("points", c_int64),
        ("positions", c_void_p),
        ("lamp", c_int64),
        ("emitters", c_void_p),
        ("fluence", c_void_p),
        ("brightest", c_void_p),
    ]


class NearbyLight(Shared):
    _fields_ = [
        ("points", c_int64),
        ("index", c_void_p),
        ("omega", c_void_p),
        ("towards", c_void_p),
        ("irradiance", c_void_p),
        ("depth", c_void_p),
        ("scattering", c_void_p),
        ("places", c_int64),
        ("parts", c_void_p),
        ("matter", c_void_p),
        ("cells", c_void_p),
        ("edge", c_int64),
        ("scale", c_double),
        ("anisotropy", c_double),
        ("reduced", c_double),
        ("albedo", c_double),
        ("terms", c_int64),
        ("weights", c_double * 4),
        ("straightest", c_double),
        ("straightest_peak", c_double),
        ("least", c_double),
        ("out", c_void_p),
    ]


class LightGather(Shared):
    _fields_ = [
        ("points", c_int64),
        ("positions", c_void_p),
        ("frames", c_void_p),
        ("rays", c_int64),
        ("directions", c_void_p),
        ("steps", c_int64),
        ("thickness", c_double),
        ("growth", c_double),
        ("shifts", c_void_p),
        ("media", c_void_p),
        ("edge", c_int64),
        ("light", c_void_p),
        ("light_edge", c_int64),
        ("sigma", c_double),
        ("flux", c_double),
        ("out", c_void_p),
    ]


#: Columns that lie together in the right matrix of a product: MRPNN_PANEL.
PANEL = 16


class MatrixProduct(Shared):
    _fields_ = [
        ("rows", c_int64),
        ("inner", c_int64),
        ("columns", c_int64),
        ("left", c_void_p),
        ("right", c_void_p),
        ("out", c_void_p),
    ]


#: Functions of the library that take one structure.
FUNCTIONS = {
    "sweep_columns": ColumnSweep,
    "sweep_blocks": BlockSweep,
    "sample_open_depths": OpenDepthSamples,
    "sweep_ordinates": OrdinateSweep,
    "sweep_radiance": RadianceSweep,
    "sweep_moments": MomentSweep,
    "follow_peak": PeakPhotons,
    "trace_paths": LightPaths,
    "conjugate_gradients": Diffusion,
    "mean_cells": CellMeans,
    "halve": Halving,
    "fill_lattice": LatticePart,
    "resample": Resampling,
    "fill_lamp_columns": LampSlices,
    "lamp_depths": LampDepths,
    "lamp_beam": LampBeam,
    "lamp_fluence": LampFluence,
    "scatter_nearby": NearbyLight,
    "gather_light": LightGather,
    "multiply": MatrixProduct,
}
