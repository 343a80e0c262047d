# SPDX-License-Identifier: GPL-3.0-or-later
"""A World's content as text: equal where it looks the same."""

import os
from typing import Any

import bpy

# Properties of the editor or of a node's history, without effect on its output.
IRRELEVANT = {
    "rna_type",
    "name",
    "label",
    "location",
    "location_absolute",
    "width",
    "height",
    "select",
    "color",
    "parent",
    "show_options",
    "show_preview",
    "show_texture",
    "hide",
    "dimensions",
    "warning_propagation",
    "internal_links",
    "outputs",
    "node_preview",
    "users",
    "is_evaluated",
}
# Nesting limit of structs in nodes: ramps, curves, mappings, image users.
MAX_DEPTH = 6


def world_key(world: "bpy.types.World") -> str:
    """The key of an evaluated World: its nodes, their values and links, and those of groups."""
    if world.node_tree is None:
        return repr((world.color.r, world.color.g, world.color.b))
    return repr(_tree(world.node_tree, {}))


def trees(world: "bpy.types.World") -> list:
    """The node trees of a World: its own and its groups'."""
    found = [world.node_tree] if world.node_tree else []
    for tree in found:
        groups = (getattr(node, "node_tree", None) for node in tree.nodes)
        found += [group for group in groups if group is not None and group not in found]
    return found


def _tree(tree: "bpy.types.NodeTree", seen: dict[str, bool]) -> list | str:
    if tree.name_full in seen:
        return tree.name_full
    seen[tree.name_full] = True
    links = sorted(
        (link.from_node.name, link.from_socket.identifier, link.to_node.name, link.to_socket.identifier, link.is_muted)
        for link in tree.links
    )
    return [tree.name_full, links, [(node.name, _values(node, seen, 0)) for node in tree.nodes]]


def _values(struct: Any, seen: dict[str, bool], depth: int) -> list:
    found = [struct.bl_rna.identifier]
    for prop in struct.bl_rna.properties:
        if prop.identifier in IRRELEVANT or depth > MAX_DEPTH:
            continue
        value = getattr(struct, prop.identifier, None)
        if prop.type == "COLLECTION":
            value = [_values(item, seen, depth + 1) for item in value]
        elif isinstance(value, bpy.types.NodeTree):
            value = _tree(value, seen)
        elif isinstance(value, bpy.types.ID):
            value = _block(value)
        elif isinstance(value, bpy.types.bpy_struct):
            value = _values(value, seen, depth + 1) if depth < MAX_DEPTH else None
        elif getattr(prop, "is_array", False):
            value = [float(number) for number in value] if prop.type == "FLOAT" else list(value)
        found.append((prop.identifier, value))
    return found


def _block(block: "bpy.types.ID") -> tuple:
    """A data-block that a node refers to: an image, or an object whose coordinates it reads."""
    more = _image(block) if isinstance(block, bpy.types.Image) else getattr(block, "filepath", None)
    matrix = getattr(block, "matrix_world", None)
    return block.name_full, more, [tuple(row) for row in matrix] if matrix is not None else None


def _image(image: "bpy.types.Image") -> tuple:
    """An image's origin, interpretation and last change."""
    path = bpy.path.abspath(image.filepath, library=image.library)
    try:
        status = os.stat(path)
        written = status.st_size, status.st_mtime_ns
    except OSError:
        written = None
    packed = [item.packed_file.size for item in image.packed_files]
    return path, written, packed, image.is_dirty, image.source, image.colorspace_settings.name, image.alpha_mode
