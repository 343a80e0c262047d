# SPDX-License-Identifier: GPL-3.0-or-later
"""MRPNN's command line for farms and scripts that cannot use Blender's `--command`:

    blender -b scene.blend --python mrpnn_script.py -- render --output //cloud_####.exr --frames 1-10

Everything after -- is as after `--command mrpnn`, and so is the exit status.
"""

import importlib
import sys

import bpy

enabled = [name for name in bpy.context.preferences.addons.keys() if name.rpartition(".")[2] == "mrpnn"]
if not enabled:
    sys.exit("mrpnn: error: the extension MRPNN Volumes is not enabled in this Blender's preferences")
arguments = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else []
sys.exit(importlib.import_module(f"{enabled[0]}.operators.command").main(arguments))
