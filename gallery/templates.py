# SPDX-License-Identifier: GPL-3.0-or-later
"""The gallery's scenes as application templates of Blender: one zip, a folder for each scene."""

from collections.abc import Iterable
from pathlib import Path

import bpy

from packages.archives import write_zip

from .scenes import SCENES

#: Blender shows a startup file without a path, so that the files beside it need one of their own.
CODE = '''# SPDX-License-Identifier: GPL-3.0-or-later
"""Find the template's volumes where it is installed."""

import pathlib

import bpy
from bpy.app.handlers import load_factory_startup_post, persistent


@persistent
def find_volumes(_):
    volumes = pathlib.Path(__file__).parent / "volumes"
    for data in bpy.data.volumes:
        if data.filepath:
            data.filepath = str(volumes / pathlib.PurePosixPath(data.filepath.replace("\\\\\\\\", "/")).name)


def register():
    load_factory_startup_post.append(find_volumes)


def unregister():
    load_factory_startup_post.remove(find_volumes)
'''


def pack(out: Path, names: Iterable[str]) -> Path:
    """Zip scenes of a folder that `make` filled: OUT/mrpnn-gallery.zip."""
    files = {}
    for name in names:
        path, folder = out / f"{name}.blend", f"Volumes_{SCENES[name].title.replace(' ', '_')}"
        files |= {f"{folder}/startup.blend": path.read_bytes(), f"{folder}/__init__.py": CODE.encode()}
        bpy.ops.wm.open_mainfile(filepath=str(path))
        for data in bpy.data.volumes:
            first = Path(bpy.path.abspath(data.filepath))
            several = sorted(first.parent.glob(f"{first.stem[:-4]}*.vdb")) if data.is_sequence else [first]
            files |= {f"{folder}/volumes/{one.name}": one.read_bytes() for one in several}
    return write_zip(out / "mrpnn-gallery.zip", files)
