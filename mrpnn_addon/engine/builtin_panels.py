"""Which of Blender's own panels are shown while this engine is chosen."""

import bpy

# For every engine although only some are named in them.
SHARED = ('EEVEE_MATERIAL_PT_context_material', 'VIEWLAYER_PT_layer_passes')
# Named for every engine, and of no use to this one: lights have a panel of their own here, previews of lights, light
# linking and what is drawn on surfaces are not rendered.
USELESS = ('DATA_PT_light', 'DATA_PT_spot', 'DATA_PT_preview', 'OBJECT_PT_shading', 'VIEWLAYER_PT_filter')


def _shown():
    for panel in bpy.types.Panel.__subclasses__():
        # The Shader Editor's copies of panels share the set of engines with what they are copied from.
        name, engines = panel.__name__.removeprefix('NODE_'), getattr(panel, 'COMPAT_ENGINES', ())
        useless = name in USELESS or 'freestyle' in name
        if name in SHARED or 'BLENDER_RENDER' in engines and not useless:
            yield panel


def register(engine: str) -> None:
    """Show them for an engine of this name, too."""
    for panel in _shown():
        panel.COMPAT_ENGINES.add(engine)


def unregister(engine: str) -> None:
    """Undo `register`."""
    for panel in _shown():
        panel.COMPAT_ENGINES.discard(engine)
