# SPDX-License-Identifier: GPL-3.0-or-later
"""The state of the open .blend file, to show that an operation leaves it alone."""

import bpy


def state_of_file():
    """How many data-blocks of each kind the file holds, and every setting of every scene."""
    # "Render Result" is Blender's own buffer for any render.
    counts = {
        name: sum(block.name != "Render Result" for block in blocks)
        for name in dir(bpy.data)
        if isinstance(blocks := getattr(bpy.data, name), bpy.types.bpy_prop_collection)
    }
    settings = {}
    for scene in bpy.data.scenes:
        for part in ("", "render", "cycles", "view_settings", "render.image_settings", "display_settings"):
            owner = scene.path_resolve(part) if part else scene
            for prop in owner.bl_rna.properties:
                value = getattr(owner, prop.identifier)
                if prop.type != "COLLECTION":
                    settings[scene.name, part, prop.identifier] = str(
                        tuple(value) if getattr(prop, "is_array", False) else value
                    )
        settings[scene.name, "objects"] = sorted(scene.objects.keys())
    return counts, settings
