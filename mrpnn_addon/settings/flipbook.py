# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings of six-way flipbooks: `scene.mrpnn_flipbook`."""

import math
from typing import Any

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, PointerProperty, StringProperty

from .properties import RELATIVE_PATH


class MRPNN_PG_flipbook(bpy.types.PropertyGroup):
    filepath: StringProperty(
        name="Files",
        default="//flipbook",
        subtype="FILE_PATH",
        options=RELATIVE_PATH,
        description="Beginning of the files' names. The textures are called _A and _B, _emission where something "
        "glows, and _motion where volumes have velocities",
    )
    file_format: EnumProperty(
        name="Format",
        items=[
            ("PNG", "PNG", "8 bits per channel"),
            ("PNG16", "PNG 16-bit", "16 bits per channel"),
            ("TGA", "Targa", "8 bits per channel, uncompressed"),
            ("EXR", "OpenEXR", "Half floats: nothing is clipped"),
        ],
        description="Format of the textures. All hold linear data: turn sRGB off in the game engine",
    )
    layout: EnumProperty(
        name="Channels",
        items=[
            (
                "UNITY",
                "Right Top Back, Left Bottom Front",
                "What Unity's VFX Graph reads (Six-way Smoke Lit). The first texture has alpha, the second emission",
            ),
            (
                "RIGHT_LEFT_TOP",
                "Right Left Top, Bottom Back Front",
                "What other engines' materials often read. The first texture has alpha, the second emission",
            ),
        ],
        description="Which light map each color channel of the two textures holds",
    )
    alpha: EnumProperty(
        name="Alpha",
        items=[
            ("PREMULTIPLIED", "Premultiplied", "For Premultiply in Unity and AlphaComposite in Unreal; best for fire"),
            ("STRAIGHT", "Straight", "For Alpha in Unity and Translucent in Unreal"),
        ],
        description="Whether the light maps are multiplied by alpha. It follows the material's blend mode",
    )
    view: EnumProperty(
        name="View",
        items=[
            ("AUTO", "Frame Volumes", "An orthographic view along the camera that shows the volumes of all frames"),
            ("CAMERA", "Camera", "The active camera, as wide as its picture"),
        ],
        description="What a tile shows",
    )
    angle: FloatProperty(
        name="Light Angle",
        min=0.0,
        max=math.radians(40.0),
        subtype="ANGLE",
        description="Angular diameter of the six suns. With a high Anisotropy, larger suns lower the error of light "
        "from between them",
    )
    columns: IntProperty(name="Columns", default=8, min=1, max=64, description="Tiles in each row of the textures")
    rows: IntProperty(name="Rows", default=8, min=1, max=64, description="Rows of tiles in the textures")
    size: IntProperty(
        name="Width",
        default=2048,
        min=16,
        max=16384,
        subtype="PIXEL",
        description="Width of the textures. Tiles are square",
    )
    padding: IntProperty(
        name="Padding", default=2, min=0, max=64, subtype="PIXEL", description="Empty pixels at each edge of a tile"
    )
    normalized: BoolProperty(
        name="Normalize",
        description="Scale the light maps such that the brightest texel is 1. Otherwise 1 is a white matte surface "
        "that faces the light",
    )


def flipbook_settings(scene: "bpy.types.Scene") -> MRPNN_PG_flipbook:
    """`scene.mrpnn_flipbook`, which the types of bpy do not have."""
    return scene.path_resolve("mrpnn_flipbook")


def register() -> None:
    bpy.utils.register_class(MRPNN_PG_flipbook)
    scene: Any = bpy.types.Scene
    scene.mrpnn_flipbook = PointerProperty(type=MRPNN_PG_flipbook)


def unregister() -> None:
    scene: Any = bpy.types.Scene
    del scene.mrpnn_flipbook
    bpy.utils.unregister_class(MRPNN_PG_flipbook)
