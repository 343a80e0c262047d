"""Rendering from the command line.

    blender -b scene.blend --command mrpnn render --output cloud.exr
    blender -b scene.blend --python-expr "import bpy; bpy.ops.mrpnn.render(filepath='//cloud.exr')"
"""

import argparse
import os
import sys

import bpy

from ..inference import available_models
from ..inference.scene import SceneError
from ..mrpnn_addon.layer_image import save_view_transformed, show_in_image
from ..mrpnn_addon.render_job import render_scene
from ..mrpnn_addon.scene import read_scene

COMMAND = "mrpnn"


class _UsageError(Exception):
    pass


class _Parser(argparse.ArgumentParser):
    """Raises instead of ending the process, which is Blender's."""

    def error(self, message):
        raise _UsageError(f"{message} (see {self.prog} --help)")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog=f"blender -b FILE.blend --command {COMMAND}")
    actions = parser.add_subparsers(dest="action", required=True, metavar="render", parser_class=_Parser)
    render = actions.add_parser("render", help="render the scene's volumes to a file")
    render.add_argument("--output", required=True, metavar="FILE",
                        help=".exr: multi-layer, scene-linear; .png: with the scene's view transform")
    render.add_argument("--frame", type=int, metavar="N", help="frame to render; the file's own by default")
    for name, kind in (("depth-samples", int), ("seed", int), ("threads", int), ("model", str)):
        choices = available_models() if name == "model" else None
        render.add_argument(f"--{name}", type=kind, choices=choices,
                            help="the scene's own setting by default")
    return parser


def main(arguments) -> int:
    """Run the command with its arguments, e.g. ["render", "--output", "cloud.exr"].

    Returns the exit status: 0 when the file is there, 1 with one line on stderr when not.
    """
    try:
        options = _parser().parse_args(arguments)
        _render(bpy.context, options)
    except SystemExit:  # argparse after --help
        return 0
    except (_UsageError, SceneError, OSError) as error:
        print(f"mrpnn: error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("mrpnn: stopped", file=sys.stderr)
        return 1
    return 0


def _render(context, options) -> None:
    path = os.path.abspath(options.output)
    ending = os.path.splitext(path)[1].lower()
    if ending not in (".exr", ".png"):
        raise _UsageError(f"--output must end in .exr or .png, not {options.output!r}")
    if not os.path.isdir(os.path.dirname(path)):
        raise _UsageError(f"the folder of --output does not exist: {os.path.dirname(path)}")
    if options.frame is not None:
        context.scene.frame_set(options.frame)
    settings = _settings(context.scene, options)
    scene = read_scene(context.evaluated_depsgraph_get())
    finished = render_scene(scene, settings, path if ending == ".exr" else None, _Progress())
    if ending == ".png":
        image = show_in_image(finished.layer)
        try:
            save_view_transformed(image, path, context.scene)
        finally:
            bpy.data.images.remove(image)
    for warning in finished.warnings:
        print(f"mrpnn: warning: {warning}", file=sys.stderr)
    print(f"mrpnn: wrote {path} in {finished.seconds:.1f} s")


def _settings(scene, options):
    """The scene's settings with those of the command line in their place; the scene keeps its own."""
    settings = scene.mrpnn.settings()
    given = {name: getattr(options, name) for name in ("depth_samples", "seed", "threads", "model")
             if getattr(options, name) is not None}
    return type(settings)(**{**vars(settings), **given})


class _Progress:
    """Prints each tenth of the work."""

    def __init__(self):
        self.shown = -1

    def __call__(self, fraction, message):
        if int(fraction * 10) > self.shown:
            self.shown = int(fraction * 10)
            print(f"mrpnn: {fraction:4.0%} {message}", flush=True)


def register():
    # The bpy module has no program, so no command line, and crashes at its end over a command still
    # registered. (bpy.app.module would say so, but Blender 4.2 and 4.3 lack it.)
    if bpy.app.binary_path:
        global _handle
        _handle = bpy.utils.register_cli_command(COMMAND, main)


def unregister():
    if bpy.app.binary_path:
        bpy.utils.unregister_cli_command(_handle)


_handle = None
classes = ()
