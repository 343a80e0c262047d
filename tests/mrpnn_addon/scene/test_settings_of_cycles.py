# SPDX-License-Identifier: GPL-3.0-or-later
"""Every setting of objects, volumes, materials, lights, Worlds, film, light paths and view layers is rendered, has no
effect, or is named.

A setting that a new version of Blender brings is in none of the lists, and fails the first test.
"""

import importlib
import re

import pytest

bpy = pytest.importorskip("bpy")

from tests.support import blender_scenes

# Regular expressions of names, by why no warning names them.
OBJECT = {
    "rendered or named: test_visibility, test_surfaces, test_light_linking, test_light_groups": "visible_(camera|shadow"
    "|volume_scatter|diffuse)|is_(holdout|shadow_catcher)|hide_render|lightgroup|light_linking|show_instancer_.*",
    "of surfaces' own reflections": "visible_(glossy|transmission|raycast)|shadow_terminator_.*",
    "of nodes, which name it: test_nodes": "color|pass_index",
    "Blender evaluates it": "(delta_)?(location|rotation|scale).*|matrix_.*|parent.*"
    "|dimensions|use_instance.*|instance_.*|constraints|modifiers|particle_systems|pose|soft_body|rigid_body.*|field"
    "|collision|shader_effects|.*shape_key.*|.*simulation.*|track_axis|up_axis|is_(instancer|from_.*)|vertex_groups"
    "|use_parent_final_indices|add_rest_position_attribute|animation_.*|motion_path|bound_box",
    "the interface's": "show_.*|display.*|hide_(select|viewport|surface_pick)|lock_.*|empty_.*|use_empty.*|image_user"
    "|mode|use_camera_lock_parent|use_mesh_mirror.*|use_dynamic.*|selection_sets|active_.*|lineart|use_grease_pencil_lights",
    "other engines'": "hide_probe.*",
    "a reference": "cycles|data|type|material_slots",
}
OBJECT_CYCLES = {
    "rendered: test_motion_blur": "use_motion_blur|motion_steps",
    "belongs to a setting of the scene that is named": "use_(camera|distance)_cull|use_deform_motion|ao_distance",
    "of surfaces": "shadow_terminator.*|is_caustics.*|dicing_rate|use_adaptive_subdivision",
}
LAYER_COLLECTION = {
    "rendered or named: test_visibility": "exclude|holdout|indirect_only|hide_viewport|is_visible|children|collection"
}
LIGHT = {
    "rendered: test_lights, test_lamps": "type|color|energy|exposure|normalize|angle|shape|size|size_y|spread"
    "|use_temperature|temperature|temperature_color|use_nodes|node_tree|spot_size|spot_blend|shadow_soft_size"
    "|use_soft_falloff",
    "Cycles ignores it": "(diffuse|specular|transmission|volume)_factor|use_custom_distance|cutoff_distance|use_square"
    "|use_shadow_jitter|use_absolute_resolution|shadow_(?!soft).*|show_cone",
    "a reference": "animation_data|cycles",
    "other settings of Cycles are below": "use_shadow",
}
LIGHT_CYCLES = {
    "named as a portal: test_lamps": "is_portal",
    "how Cycles samples": "use_multiple_importance_sampling",
    "caustics on surfaces alone": "is_caustics_light",
}
WORLD = {
    "rendered: test_lights, test_background": "color|use_nodes|node_tree|lightgroup",
    "Cycles ignores it": "use_eevee.*|probe_resolution|sun_.*|use_sun_.*",
    "passes that this engine has not": "mist_settings|light_settings",
    "a reference": "animation_data|cycles|cycles_visibility",
}
WORLD_CYCLES = {
    "how Cycles samples": "sampling_method|sample_map_resolution",
    "of fog in the World, which is named: test_lights": "homogeneous_volume|volume_.*",
    "caustics on surfaces alone": "is_caustics_light",
}
WORLD_VISIBILITY = {
    "rendered: test_lights, test_background": "camera|scatter",
    "named beside surfaces: below": "diffuse",
    "of surfaces' own reflections": "glossy|transmission",
    "Cycles shows the same": "shadow",
}
SCENE_CYCLES = {
    "rendered: test_exposure": "film_exposure",
    "the layer has all bounces": "max_bounces|(min|diffuse|glossy|transmission|volume|transparent).*_bounces",
    "how Cycles samples, and how soon it stops": ".*samples?|sample_(offset|subset.*)|use_sample_subset|time_limit"
    "|sampling_pattern|.*scrambling_distance|use_layer_samples|light_sampling_threshold|.*adaptive.*|use_light_tree"
    "|direct_light_sampling_type|.*guiding.*|seed|use_animated_seed|volume_(preview_)?step_rate|volume_max_steps"
    "|volume_biased",
    "the layer has no noise to remove": ".*denois.*",
    "of surfaces": "caustics_.*|blur_glossy|film_transparent_.*|.*dicing.*|max_subdivisions",
    "rays go through pixels' centres": "pixel_filter_type|use_pixel_jitter",
    "belongs to a setting that is named": "(camera|distance)_cull_margin|rolling_shutter.*|fast_gi_method|ao_bounces.*",
    "the viewport's": "texture_limit|texture_resolution",
    "how Cycles computes": "device|feature_set|shading_system|debug_.*|preview_pause|use_auto_tile|tile_size|bake_type",
}
RENDER = {
    "rendered: test_scene, test_background, test_composite": "resolution_.*|pixel_aspect.*|(use_)?border.*"
    "|use_crop_to_border|film_transparent|engine|fps.*|frame_map.*|use_compositing|use_sequencer|threads.*"
    "|use_persistent_data",
    "rendered in the viewport: test_viewport": "preview_pixel_size",
    "stereo has its own tests": "use_multiview|views_format|(stereo_)?views|use_spherical_stereo",
    "Blender evaluates it": "use_simplify|simplify_.*|use_simplify_normals|hair_.*|use_.*single_layer|metadata_input",
    "Blender writes files by it": "image_settings|ffmpeg|dither_intensity|.*stamp.*|use_placeholder|use_overwrite"
    "|use_file_extension|file_extension|is_movie_format|filepath|use_render_cache|ppm_.*|save_output",
    "the interface's": "use_lock_interface|sequencer_.*|use_sequencer_override.*"
    "|has_multiple_engines|compositor_.*|use_new_cpu_compositor|_bpy.*",
    "other engines'": "filter_size|use_freestyle|line_thickness.*|use_high_quality_normals|anisotropic_filter",
    "of surfaces": "bake|bake_.*|use_bake.*",
    "of images' files": "use_texture_cache|use_auto_generate_texture_cache",
    "rendered: test_motion_blur": "use_motion_blur|motion_blur_.*",
}
VIEW_LAYER = {
    "rendered: test_layers, test_mattes, test_light_groups, test_visibility": "use|use_pass_(combined|z|emit|position"
    "|shadow|cryptomatte_(object|material))|pass_cryptomatte_depth|.*lightgroup.*"
    "|use_(solid|sky|strand|volumes)|(active_)?layer_collection|objects",
    "how Cycles samples": "samples",
    "passes that this engine has not": "use_pass_.*|.*cryptomatte.*|.*aov.*|pass_alpha_threshold",
    "of surfaces": "use_ao|use_grease_pencil|use_freestyle|freestyle_settings",
    "rendered: test_motion_blur": "use_motion_blur",
    "a reference": "eevee|cycles|depsgraph|has_export_collections|mrpnn|name",
}


VOLUME = {
    "read by Blender, which chooses the file: test_sources": "filepath|packed_file|is_sequence|frame_.*|sequence_mode"
    "|grids|materials",
    "rendered: test_motion_blur": "velocity_.*",
    "a reference": "animation_data|display|render",
}
VOLUME_RENDER = {
    "rendered: test_scene": "space",
    "how Cycles samples": "step_size",
    "of Cycles' memory; the file's own precision is rendered": "precision",
}
VOLUME_DISPLAY = {"the viewport's, in Solid shading": ".*"}
MATERIAL = {
    "evaluated: test_materials": "node_tree|use_nodes",
    "of surfaces": "displacement_method|max_vertex_displacement|alpha_threshold|.*backface.*|use_transparent_shadow"
    "|thickness_mode|use_thickness.*|pass_index",
    "other engines'": "surface_render_method|volume_intersection_method|.*refraction.*|blend_method|shadow_method"
    "|use_sss.*|use_screen_.*|show_transparent_back|use_transparency_overlap|grease_pencil|is_grease_pencil|line.*",
    "the viewport's, in Solid shading": "diffuse_color|specular_.*|roughness|metallic",
    "the interface's": "preview_.*|use_preview_world|paint_.*|texture_paint_.*",
    "a reference": "animation_data|cycles",
}
MATERIAL_CYCLES = {
    "of surfaces": "emission_sampling|use_bump_map_correction|displacement_method|use_transparent_shadow",
    "how Cycles samples": "volume_sampling|volume_step_rate|homogeneous_volume",
}


def settings():
    """Owners by name: their properties, where these lie from the owner of the table, the table, and reasons."""
    tables = importlib.import_module("mrpnn.mrpnn_addon.objects.ignored_settings")
    lamp, world, scene = bpy.data.lights.new("Any", "POINT"), bpy.data.worlds.new("Any"), bpy.context.scene
    lights = [getattr(bpy.types, f"{kind}Light").bl_rna for kind in ("Point", "Spot", "Area", "Sun")]
    box, fog = bpy.data.objects.new("Any", bpy.data.meshes.new("Any")), bpy.data.materials.new("Any")
    return {
        "object": ([bpy.types.Object.bl_rna], "", tables.SHINING, OBJECT),
        "object.cycles": ([box.cycles.bl_rna], "cycles.", (), OBJECT_CYCLES),
        "layer collection": ([bpy.types.LayerCollection.bl_rna], "", (), LAYER_COLLECTION),
        "light": (lights, "data.", tables.LIGHT, LIGHT),
        "light.cycles": ([lamp.cycles.bl_rna], "data.cycles.", tables.LIGHT, LIGHT_CYCLES),
        "volume": ([bpy.types.Volume.bl_rna], "data.", tables.VOLUME, VOLUME),
        "volume.render": ([bpy.types.VolumeRender.bl_rna], "data.render.", tables.VOLUME, VOLUME_RENDER),
        "volume.display": ([bpy.types.VolumeDisplay.bl_rna], "", (), VOLUME_DISPLAY),
        "material": ([bpy.types.Material.bl_rna], "", tables.VOLUME_MATERIAL, MATERIAL),
        "material.cycles": ([fog.cycles.bl_rna], "cycles.", tables.VOLUME_MATERIAL, MATERIAL_CYCLES),
        "world": ([bpy.types.World.bl_rna], "", tables.WORLD, WORLD),
        "world.cycles": ([world.cycles.bl_rna], "cycles.", tables.WORLD, WORLD_CYCLES),
        "world.cycles_visibility": ([world.cycles_visibility.bl_rna], "", (), WORLD_VISIBILITY),
        "scene.cycles": ([scene.cycles.bl_rna], "cycles.", tables.SCENE, SCENE_CYCLES),
        "scene.render": ([scene.render.bl_rna], "render.", tables.SCENE, RENDER),
        "view layer": ([bpy.types.ViewLayer.bl_rna], "", tables.VIEW_LAYER, VIEW_LAYER),
    }


def test_every_setting_is_rendered_or_without_effect_or_named(addon, scene):
    common = {prop.identifier for prop in bpy.types.ID.bl_rna.properties} | {"name"}
    unknown, count = [], 0
    for owner, (kinds, prefix, table, reasons) in settings().items():
        named = {setting.path.removeprefix(prefix) for setting in table}
        for name in {prop.identifier for rna in kinds for prop in rna.properties} - common - named:
            count += 1
            if not any(re.fullmatch(names, name) for names in reasons.values()):
                unknown.append(f"{owner}.{name}")
    assert count > 200
    assert not unknown, f"Blender {bpy.app.version_string} has settings whose effect nobody has looked at: {unknown}"


@pytest.fixture
def lit(addon, scene, tmp_path):
    """A cloud below a sun and a World, and what reading it warns of."""
    blender_scenes.cloud_scene(scene, tmp_path)
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 1.0
    return lambda: set(addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph()).warnings)


def changed(owner, path):
    """Set a setting to another value than its default; gives whether this Blender has it."""
    *parents, name = path.split(".")
    for parent in parents:
        owner = getattr(owner, parent)
    prop = owner.bl_rna.properties.get(name)
    if prop is None:
        return False
    if prop.type == "POINTER":
        value = getattr(
            bpy.data,
            {"Collection": "collections", "Material": "materials", "World": "worlds"}[prop.fixed_type.identifier],
        ).new("Another")
    elif prop.type == "ENUM":
        value = next(item.identifier for item in prop.enum_items if item.identifier != prop.default)
    elif prop.type == "BOOLEAN":
        value = not prop.default
    else:
        value = prop.default + 1 if prop.default < prop.hard_max else prop.default / 2
        value = type(prop.default)(value)
    setattr(owner, name, value)
    return True


@pytest.mark.parametrize("name", ["LIGHT", "VOLUME", "VOLUME_MATERIAL", "WORLD", "SCENE", "VIEW_LAYER"])
def test_each_ignored_setting_is_named_once_it_is_set(addon, scene, lit, name):
    owner = {
        "LIGHT": scene.objects["Sun"],
        "VOLUME": scene.objects["Cloud"],
        "VOLUME_MATERIAL": scene.objects["Cloud"].data.materials[0],
        "WORLD": scene.world,
        "SCENE": scene,
        "VIEW_LAYER": scene.view_layers[0],
    }[name]
    before, table = lit(), getattr(importlib.import_module("mrpnn.mrpnn_addon.objects.ignored_settings"), name)
    assert not any(setting.warning in text for text in before for setting in table)
    for setting in table:
        if not changed(owner, setting.path):
            continue
        if setting.switch:
            assert lit() == before, setting.path
            changed(owner, setting.switch)
        said = lit() - before
        assert len(said) == 1 and setting.warning in said.pop(), setting.path
        for value in setting.harmless:
            parent, _, last = setting.path.rpartition(".")
            setattr(owner.path_resolve(parent), last, value)
            assert lit() == before
        restore(owner, setting.path)
        if setting.switch:
            restore(owner, setting.switch)
    assert lit() == before


def restore(owner, path):
    parent, _, name = path.rpartition(".")
    parent = owner.path_resolve(parent) if parent else owner
    prop = parent.bl_rna.properties[name]
    setattr(parent, name, None if prop.type == "POINTER" else prop.default)


def test_worlds_that_surfaces_and_volumes_see_differently_are_named(addon, scene, lit):
    plane = bpy.data.meshes.new("Ground")
    plane.from_pydata([(-4, -4, -2), (4, -4, -2), (4, 4, -2)], [], [(0, 1, 2)])
    rays = scene.world.cycles_visibility
    rays.diffuse = False
    assert not any("diffuse rays" in text for text in lit())
    blender_scenes.add_object(scene, "Ground", plane)
    assert any('World "World" is hidden from diffuse rays' in text for text in lit())
    rays.diffuse, rays.scatter = True, False
    assert any('World "World" is hidden from volume scatter rays' in text for text in lit())
    rays.scatter = True
    assert not any("hidden from" in text for text in lit())
