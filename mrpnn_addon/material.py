"""Volume materials as extinction, albedo and anisotropy, with Cycles' meaning of each socket."""

from dataclasses import dataclass
from typing import List, Optional

import numpy as np

from ..inference.scene import SceneError
from .sockets import Unsupported, active_output, constant, density_input, linked_node

DEFAULT_GRID = "density"


@dataclass
class Shading:
    """density_grid: name of the grid that scales everything below.
    sigma_t: float64 (3,), extinction per unit of the grid's density.
    albedo: float64 (3,), in [0, 1].
    anisotropy: Henyey-Greenstein mean cosine.
    """

    density_grid: str
    sigma_t: np.ndarray
    albedo: np.ndarray
    anisotropy: float


def read_shading(volume_object, grids: List[str], owner: str) -> Shading:
    """The shading of the first material of a Volume object whose file holds `grids`.

    Without a material, Cycles' default: Principled Volume as it is when added.

    Raises SceneError, naming object, material and node, for anything that this extension would
    have to ignore.
    """
    material = _first_material(volume_object)
    if material is None:
        return Shading(DEFAULT_GRID, *principled_medium(1.0, np.full(3, 0.5), np.zeros(3)), 0.0)
    try:
        return _volume_shader(material, grids)
    except Unsupported as problem:
        raise SceneError(f"Volume object \"{owner}\", material \"{material.name}\": {problem}") from None


def _first_material(volume_object):
    slots = volume_object.material_slots
    if len(slots):
        return slots[0].material
    return next(iter(volume_object.data.materials), None)


def _volume_shader(material, grids) -> Shading:
    output = active_output(material)
    if output is None:
        raise Unsupported("it has no nodes, so the volume is invisible; add a Principled Volume node")
    node = linked_node(output.inputs['Volume'])
    if node is None:
        raise Unsupported("nothing is linked to the Volume socket of its output; add a Principled Volume node")
    reader = READERS.get(node.bl_idname)
    if reader is None:
        raise Unsupported(f"node \"{node.name}\" is not supported; use Principled Volume or Volume Scatter")
    return reader(node, grids)


def _read_principled(node, grids) -> Shading:
    _refuse_emission(node, grids)
    colour_grid = constant(node.inputs['Color Attribute'], node)
    if colour_grid in grids:
        raise Unsupported(f"node \"{node.name}\" colours the volume by grid \"{colour_grid}\", "
                          "which is not supported; clear its Color Attribute")
    # An attribute that the file lacks leaves Density as it is, if another node names the grid.
    own_grid: Optional[str] = constant(node.inputs['Density Attribute'], node) or None
    linked_grid, density = density_input(node.inputs['Density'], node)
    if linked_grid and own_grid in grids:
        raise Unsupported(f"node \"{node.name}\" multiplies its Density Attribute \"{own_grid}\" by the grid "
                          f"\"{linked_grid}\" linked to Density; unlink one of them")
    grid = linked_grid or own_grid
    if not grid:
        raise Unsupported(f"node \"{node.name}\" has no Density Attribute, so no grid shapes the volume; "
                          f"enter the grid's name (in this file: {', '.join(grids)})")
    colour = np.array(constant(node.inputs['Color'], node)[:3])
    absorption = np.array(constant(node.inputs['Absorption Color'], node)[:3])
    medium = principled_medium(density, colour, absorption)
    return Shading(grid, *medium, _anisotropy(node))


def principled_medium(density: float, colour: np.ndarray, absorption: np.ndarray):
    """(sigma_t, albedo) of Principled Volume, as Cycles 4.5 and 5.0 render it:

    sigma_s = density colour, sigma_a = density max(1 - colour, 0) max(1 - sqrt(absorption), 0).
    """
    colour = np.maximum(colour, 0.0)
    lost = np.maximum(1.0 - colour, 0.0) * np.maximum(1.0 - np.sqrt(np.maximum(absorption, 0.0)), 0.0)
    extinction = colour + lost
    albedo = np.divide(colour, extinction, out=np.zeros(3), where=extinction > 0.0)
    return max(density, 0.0) * extinction, albedo


def _refuse_emission(node, grids) -> None:
    strength = constant(node.inputs['Emission Strength'], node)
    glows = strength > 0.0 and max(constant(node.inputs['Emission Color'], node)[:3]) > 0.0
    if glows or constant(node.inputs['Blackbody Intensity'], node) > 0.0:
        raise Unsupported(f"node \"{node.name}\" emits light, which is not supported; "
                          "set Emission Strength and Blackbody Intensity to 0")


def _read_scatter(node, grids) -> Shading:
    phase = getattr(node, 'phase', 'HENYEY_GREENSTEIN')
    if phase != 'HENYEY_GREENSTEIN':
        raise Unsupported(f"node \"{node.name}\" has phase function {phase}; only Henyey-Greenstein is supported")
    grid, density = density_input(node.inputs['Density'], node)
    if not grid:
        raise Unsupported(f"node \"{node.name}\" does not read a grid, so the volume is invisible; "
                          "link Volume Info or Attribute to its Density")
    # Volume Scatter takes nothing away: sigma_t = sigma_s = density colour.
    colour = np.maximum(np.array(constant(node.inputs['Color'], node)[:3]), 0.0)
    return Shading(grid, max(density, 0.0) * colour, np.ones(3), _anisotropy(node))


def _anisotropy(node) -> float:
    # Cycles' own limit: the phase function degenerates at -1 and 1.
    return float(np.clip(constant(node.inputs['Anisotropy'], node), -0.999, 0.999))


READERS = {
    'ShaderNodeVolumePrincipled': _read_principled,
    'ShaderNodeVolumeScatter': _read_scatter,
}
