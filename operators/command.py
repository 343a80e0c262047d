# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line: render, bake, flipbook, compare, report.

blender -b scene.blend --command mrpnn render --output //cloud_####.exr --frames 1-10
blender -b scene.blend --python-exit-code 1 --python mrpnn_script.py -- render --output cloud.exr
"""

import argparse
import os
import re
import time
from collections.abc import Sequence
from typing import NoReturn

import bpy

from ..inference import available_models
from ..inference.network.provider import PROVIDERS
from ..inference.scene import SceneError
from ..inference.scene.optimizations import ALL, OPTIMIZATIONS, RETIRED
from ..mrpnn_addon.baking.light_folder import FOLDER
from ..mrpnn_addon.comparison.run import REPORT_FOLDER
from ..mrpnn_addon.runtime.atomic_write import make_folder
from ..mrpnn_addon.runtime.json_file import write_json
from ..mrpnn_addon.scene.kept_frame import kept_frame
from . import command_actions, command_flipbook
from .command_frames import error_message
from .console import Console

COMMAND = "mrpnn"
# Version of the output of --json and --progress json.
FORMAT_VERSION = 1


class _UsageError(Exception):
    pass


class _Parser(argparse.ArgumentParser):
    """Raises instead of ending the process, which is Blender's."""

    def error(self, message: str) -> NoReturn:
        raise _UsageError(f"{message} (see {self.prog} --help)")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog=f"blender -b FILE.blend --command {COMMAND}")
    actions = parser.add_subparsers(
        dest="action", required=True, metavar="render|bake|flipbook|compare|report", parser_class=_Parser
    )

    render = actions.add_parser("render", help="render the scene's volumes to files")
    render.add_argument(
        "--output",
        required=True,
        metavar="FILE",
        help=".exr: multi-layer, scene-linear; .png: with the scene's view transform. The last run of # is the "
        "frame's number, // the .blend file's folder",
    )
    render.add_argument(
        "--frames",
        "--frame",
        metavar="LIST",
        help="1-10,15 or 1..10, or every third as 1-10:3; the file's current frame without it",
    )
    render.add_argument(
        "--deep", action="store_true", help="write deep samples, too, as FILE_deep.exr; the scene's Deep EXR without it"
    )
    render.add_argument("--skip-existing", action="store_true", help="skip frames whose file exists")

    bake = actions.add_parser("bake", help="bake predicted scattering into light for Cycles and EEVEE")
    bake.add_argument(
        "--frames",
        "--frame",
        metavar="LIST",
        help="1-10,15 or 1..10, or every third as 1-10:3; the file's current frame without it",
    )
    bake.add_argument(
        "--folder", default=FOLDER, metavar="FOLDER", help="folder of the .vdb files; // is the .blend file's folder"
    )
    bake.add_argument("--save", metavar="FILE", help=".blend file to write that shows the light")
    bake.add_argument("--fast", action="store_true", help="with --save: also apply Fast Cycles Settings to that file")
    bake.add_argument("--no-directions", action="store_true", help="bake only the light that the camera sees")

    flipbook = actions.add_parser("flipbook", help="render six-way light maps into textures for game engines")
    command_flipbook.add_options(flipbook)

    compare = actions.add_parser("compare", help="measure the layer against Cycles on the same view")
    compare.add_argument(
        "--samples",
        type=_positive,
        default=32,
        metavar="N",
        help="samples per pixel in each of the reference's two halves, at most",
    )
    compare.add_argument(
        "--seconds", type=_number, default=0.0, metavar="N", help="time limit for Cycles, roughly; 0: none"
    )
    compare.add_argument(
        "--ladder", type=_whole, default=64, metavar="N", help="most samples per pixel of Cycles; 0: none"
    )
    compare.add_argument("--no-denoise", action="store_true", help="do not measure Cycles with OpenImageDenoise")
    compare.add_argument(
        "--usual",
        action="store_true",
        help="measure Cycles as artists set it, too: few bounces, clamped, denoised, adaptive, guided",
    )
    compare.add_argument("--all-models", action="store_true", help="measure every network, not only the scene's")
    compare.add_argument("--reference", metavar="FILE", help=".exr of the same view, instead of rendering it")
    compare.add_argument(
        "--folder",
        default=REPORT_FOLDER,
        metavar="FOLDER",
        help="folder of the report and of finished images, from which another run continues",
    )
    compare.add_argument(
        "--bounces", type=_positive, default=1024, metavar="N", help="volume bounces of Cycles, at most"
    )
    compare.add_argument(
        "--scale", type=_positive, default=25, metavar="PERCENT", help="size, in percent of the resolution"
    )

    report = actions.add_parser("report", help="describe what a render would do, without rendering")
    for action in (render, bake, flipbook, report):
        action.add_argument(
            "--strict",
            action=argparse.BooleanOptionalAction,
            default=False,
            help="exit status 1 and a message, instead of a picture, where an object cannot be rendered, or no volume "
            "or light is left; the command stops there",
        )
    for action in (compare, report):
        action.add_argument("--frame", type=_whole, metavar="N", help="the file's current frame without it")

    for action in (render, bake, flipbook, compare, report):
        action.add_argument(
            "--json",
            metavar="FILE",
            help="file for the results, also after an error: the report of each frame, with its expected error",
        )
        action.add_argument(
            "--progress",
            choices=("text", "json"),
            default="text",
            help="json: one object per line on standard output; its event is progress, warning, estimate, skipped, "
            "frame, saved, report, comparison, error or end",
        )
        choices = {"model": available_models(), "provider": list(PROVIDERS)}
        for name, kind, metavar in (
            ("depth-samples", _whole, "N"),
            ("blur-rays", _whole, "N"),
            ("seed", _whole, "N"),
            ("threads", _whole, "N"),
            ("memory-limit", _number, "GIB"),
            ("model", str, None),
            ("provider", str, None),
            ("resolution-percentage", _positive, "PERCENT"),
            ("camera", str, "NAME"),
            ("view-layer", str, "NAME"),
        ):
            action.add_argument(
                f"--{name}",
                type=kind,
                choices=choices.get(name),
                metavar=metavar,
                help="in place of the scene's own, for this command",
            )
        action.add_argument(
            "--optimizations",
            type=_optimizations,
            metavar="NAMES",
            help="optimizations in place of the scene's own: all, none, or of these, with commas between: "
            + ", ".join(OPTIMIZATIONS),
        )
        # The name of earlier versions.
        action.add_argument("--leave-out", dest="optimizations", type=_optimizations, help=argparse.SUPPRESS)
    return parser


def _optimizations(text: str) -> frozenset:
    named = {"all": ALL, "none": frozenset()}.get(text, frozenset(text.split(",")) - set(RETIRED.values()))
    if named <= ALL:
        return named
    raise argparse.ArgumentTypeError(
        f"there is no optimization {min(named - ALL)!r}; there are: {', '.join(OPTIMIZATIONS)}"
    )


def _whole(text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number") from None


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number") from None


def _positive(text: str) -> int:
    number = _whole(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"{number} is not positive")
    return number


def _joined(arguments: Sequence[str]) -> list[str]:
    """Options with values that begin with a minus as one word each: argparse takes frames -5..-1 for an option."""
    found: list[str] = []
    for word in arguments:
        if found and found[-1].startswith("--") and "=" not in found[-1] and re.match(r"-\d", word):
            found[-1] += f"={word}"
        else:
            found.append(word)
    return found


def main(arguments: Sequence[str]) -> int:
    """Run the command with its arguments, e.g. ["render", "--output", "cloud.exr"].

    Returns the exit status: 0 on success, 1 after one line with the error.
    """
    # Errors are text until the arguments are parsed.
    console, options = Console(machine=False), None
    found = {"version": FORMAT_VERSION, "blend": bpy.data.filepath, "blender": bpy.app.version_string}
    start = time.perf_counter()
    try:
        options = _parser().parse_args(_joined(arguments))
        console = Console(machine=options.progress == "json")
        found["action"] = options.action
        with kept_frame(bpy.context.scene):
            getattr(command_actions, options.action)(options, console, found)
        error = None
    except SystemExit:  # argparse after --help
        return 0
    except (_UsageError, SceneError, OSError) as problem:
        error = str(problem)
    except OverflowError as problem:  # Blender's properties have 32 bits.
        error = f"a number is too large ({problem})"
    except KeyboardInterrupt:
        error = "stopped"
    except Exception as bug:
        error = error_message(bug)
    found.update(error=error, seconds=time.perf_counter() - start)
    if options is not None and options.json:
        try:
            make_folder(os.path.dirname(os.path.abspath(options.json)))
            write_json(options.json, found)
        except (SceneError, OSError) as problem:
            error = error or str(problem)
    if error is not None:
        console.event("error", error, message=error)
    if console.machine:
        console.event("end", "", status=int(error is not None), seconds=found["seconds"])
    return int(error is not None)


def register() -> None:
    # The bpy module has no command line, and crashes at its end while a command is registered. (bpy.app.module would
    # tell, but Blender 4.2 and 4.3 lack it.)
    if bpy.app.binary_path:
        global _handle
        _handle = bpy.utils.register_cli_command(COMMAND, main)


def unregister() -> None:
    if bpy.app.binary_path:
        bpy.utils.unregister_cli_command(_handle)


_handle = None
classes = ()
