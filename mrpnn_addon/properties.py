"""What a scene remembers about rendering with MRPNN: `scene.mrpnn`."""

import bpy
from bpy.props import BoolProperty, EnumProperty, IntProperty, PointerProperty, StringProperty

from ..inference import Settings, available_models

# Blender 4.5 wants to be told that "//" may start a path; earlier versions do not know the word.
RELATIVE_PATH = {'PATH_SUPPORTS_BLEND_RELATIVE'} if bpy.app.version >= (4, 5, 0) else set()

# Blender keeps no reference to the strings of a dynamic enum, so they live here.
_model_items = []


def model_items(_owner=None, _context=None):
    """Enum items: the networks in inference/weights."""
    _model_items[:] = [
        (name, name.upper().replace("_", " "), "Network that predicts multiple scattering")
        for name in available_models()
    ]
    return _model_items


class MRPNN_PG_scene(bpy.types.PropertyGroup):
    depth_samples: IntProperty(
        name="Depth Samples", default=8, min=1, max=256, soft_max=64,
        description="Points along each camera ray at which the network predicts multiple scattering",
    )
    model: EnumProperty(name="Network", items=model_items, description="Network that predicts multiple scattering")
    seed: IntProperty(
        name="Seed", default=0, min=0, description="Of the depths' random offsets; the same seed gives the same image")
    threads: IntProperty(
        name="Threads", default=0, min=0, max=1024, description="Worker threads; 0 uses one a core")
    memory_limit: IntProperty(
        name="Memory Limit", default=8, min=1, max=1024,
        description="GiB that a render may use; one that needs more is refused before it starts")
    use_exr: BoolProperty(
        name="Write EXR", default=False, description="Write the layer to a multi-layer OpenEXR file after each render")
    exr_path: StringProperty(
        name="EXR File", default="//mrpnn.exr", subtype='FILE_PATH', options=RELATIVE_PATH,
        description="File that Write EXR writes")

    def settings(self) -> Settings:
        """As `inference.render` takes them."""
        return Settings(
            depth_samples=self.depth_samples, model=self.model or Settings.model, seed=self.seed, threads=self.threads,
            memory_limit=self.memory_limit << 30)


def register():
    bpy.utils.register_class(MRPNN_PG_scene)
    bpy.types.Scene.mrpnn = PointerProperty(type=MRPNN_PG_scene)


def unregister():
    del bpy.types.Scene.mrpnn
    bpy.utils.unregister_class(MRPNN_PG_scene)
