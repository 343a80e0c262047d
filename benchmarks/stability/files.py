# SPDX-License-Identifier: GPL-3.0-or-later
"""Generated .vdb files through the extension's reader: voxels that are not a density, and grids that are not fog.

Needs bpy, whose OpenVDB writes them.
"""

import tempfile

import numpy as np
from scipy.ndimage import map_coordinates

from inference import SceneError, Volume

from ..support.extension import extension
from .case import refused
from .renders import RenderSpec, render_case
from .scenes import blob, placed

# Voxels of a blob that are replaced.
SPOILT = (slice(6, 9), slice(5, 8), slice(7, 11))


def without() -> np.ndarray:
    """The blob with 0 in the spoilt voxels."""
    density = blob()
    density[SPOILT] = 0.0
    return density


def fog(openvdb, value=0.0, background=0.0):
    """The blob as a grid, with `value` in the spoilt voxels."""
    grid = openvdb.FloatGrid(background)
    grid.copyFromArray(blob())
    # One by one: copyFromArray mistakes NaN for the background.
    accessor = grid.getAccessor()
    for voxel in np.argwhere(blob() != without()):
        accessor.setValueOn(tuple(voxel.tolist()), value)
    return grid


def level_set(openvdb):
    return openvdb.createLevelSetSphere(radius=5.0, voxelSize=0.5)


def read(make, told: str = "") -> Volume:
    """Write the grid that `make` creates with the OpenVDB module, and read it as a scene's volume.

    A blob is put where `placed` puts it. Raises SceneError as the reader does, and ValueError where no warning contains
    `told`.
    """
    import bpy

    addon = extension().mrpnn_addon
    with tempfile.TemporaryDirectory() as folder:
        reader = addon.vdb.density_grid
        openvdb = addon.vdb.openvdb_module.load_openvdb()
        grid, path = make(openvdb), folder + "/volume.vdb"
        grid.name = "density"
        if grid.gridClass != "level set":
            matrix = placed(blob()).world_from_index
            matrix[:3, 3] -= matrix[:3, :3].sum(axis=1) * reader.VOXEL_CENTRE
            # OpenVDB's matrices act on rows.
            grid.transform = openvdb.createLinearTransform(matrix.T.tolist())
        openvdb.write(path, grids=[grid])
        data = bpy.data.volumes.new("cloud")
        data.filepath = path
        shown = bpy.data.objects.new("cloud", data)
        bpy.context.scene.collection.objects.link(shown)
        try:
            found, warnings = addon.volumes.reader.VolumeReader().read(
                next(
                    one
                    for one in addon.objects.visibility.visible_objects(bpy.context.evaluated_depsgraph_get())
                    if one.name == shown.name
                )
            )
        except extension().inference.SceneError as error:
            raise SceneError(str(error)) from None
        finally:
            bpy.data.volumes.remove(data)
        if told not in " ".join(warnings):
            raise ValueError(f'no warning says "{told}"')
        ((volume, _),) = found
        return volume


def interpolated(value: float) -> np.ndarray:
    """The blob with `value` in the spoilt voxels, interpolated to four times as many along each axis and then clamped:
    what Cycles shows before Blender 5.
    """
    density = blob().astype(np.float64)
    density[SPOILT] = value
    fine = (np.arange(4 * len(density)) + 0.5) / 4.0 - 0.5
    places = np.meshgrid(fine, fine, fine, indexing="ij")
    return np.maximum(map_coordinates(density, places, order=1, mode="grid-constant"), 0.0)


def taken_as_0(name, value, told):
    """A file with an invalid value in some voxels, against the blob that has 0 there."""
    return render_case(
        "file",
        name,
        RenderSpec(lambda: read(lambda openvdb: fog(openvdb, value), told), visible=placed(without())),
        quick=True,
    )


def clamped(name, value, told, **bounds):
    """A file with negative voxels, against the blob that is interpolated before it is clamped."""
    return render_case(
        "file",
        name,
        RenderSpec(lambda: read(lambda openvdb: fog(openvdb, value), told), visible=placed(interpolated(value))),
        quick=True,
        **bounds,
    )


def refusal(name, make, words):
    return refused(f"a file's {name}", lambda: read(make), words)


CASES = [
    taken_as_0("36 voxels of NaN", np.nan, "36 NaN"),
    taken_as_0("36 voxels of infinity", np.inf, "36 NaN or infinite"),
    taken_as_0("36 voxels of −infinity", -np.inf, "36 NaN or infinite"),
    # The reader's voxels are half as large as the file's, and clamped at their centres.
    clamped("36 voxels of −1", -1.0, "36 negative", alpha=0.06, single=0.08),
    clamped("36 voxels of −3e38", -3e38, "36 negative", alpha=0.06, single=0.08),
    render_case(
        "file",
        "background of −1e-30",
        RenderSpec(lambda: read(lambda openvdb: fog(openvdb, background=-1e-30)), visible=placed(without())),
        quick=True,
    ),
    refusal("background of 1", lambda openvdb: fog(openvdb, background=1.0), "background 1"),
    # OpenVDB takes every value for such a background.
    refusal("background of NaN", lambda openvdb: fog(openvdb, background=np.nan), "is empty"),
    refusal("level set", level_set, "is a level set, a distance and not a density"),
]
