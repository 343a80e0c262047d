# SPDX-License-Identifier: GPL-3.0-or-later
"""The actions of the command line: render frames, bake them, compare one with Cycles, report on a scene, and more."""

import argparse
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import bpy

from ..inference.scene import SceneError, Settings
from ..mrpnn_addon.baking.bake_job import bake_scene
from ..mrpnn_addon.baking.baked_scene import show_light, show_sequence
from ..mrpnn_addon.baking.light_folder import light_folder
from ..mrpnn_addon.baking.light_sequence import LightSequence
from ..mrpnn_addon.comparison.run import ComparisonRun, Options
from ..mrpnn_addon.engine.render_job import deep_path, render_scene, write_deep_files
from ..mrpnn_addon.objects.views import view_path, view_paths, wanted_views
from ..mrpnn_addon.output.frames import frame_path, parse_frames
from ..mrpnn_addon.output.layer_image import save_view_transformed, show_in_image
from ..mrpnn_addon.runtime.atomic_write import make_folder
from ..mrpnn_addon.runtime.text import reason
from ..mrpnn_addon.scene.reader import SceneDescription
from ..mrpnn_addon.settings.properties import scene_settings
from ..mrpnn_addon.status.forecast import forecast_bake
from .bake import bake_warnings, learn_from_bake, light_frames, make_fast
from .command_flipbook import render_flipbook
from .command_frames import each_frame, frame_reader, require_none
from .console import Console

ENDINGS = (".exr", ".png")


def render(options: argparse.Namespace, console: Console, found: dict) -> None:
    """Render each frame to its file. `found` collects the output of --json, frame by frame."""
    scene = bpy.context.scene
    if os.path.splitext(options.output)[1].lower() not in ENDINGS:
        raise SceneError(f"--output must end in .exr or .png, not {options.output!r}")
    frames = parse_frames(options.frames) if options.frames else [scene.frame_current]
    paths = {frame: frame_path(options.output, frame, many=len(frames) > 1) for frame in frames}

    with _overridden(options) as settings:

        def work(frame: int) -> dict:
            path = paths[frame]
            wanted = view_paths(path, scene.render)
            if options.deep or scene_settings(scene).use_deep:
                suffixes = [view.file_suffix for view in wanted_views(scene.render)] or [""]
                wanted += [view_path(deep_path(path), suffix) for suffix in suffixes]
            if options.skip_existing and all(map(os.path.exists, wanted)):
                console.event("skipped", f"frame {frame}: {path} is there already", frame=frame, file=path)
                return {"frame": frame, "file": path, "skipped": True}
            reads = replace(settings, outputs=frozenset({"deep"})) if options.deep else settings
            return _render_frame(frame, path, reads, console, frame_reader(options, frames))

        failed = each_frame(frames, work, console, found, options.strict)
    require_none(failed, frames)


def _render_frame(
    frame: int, path: str, settings: Settings, console: Console, read: Callable[[int], SceneDescription]
) -> dict:
    """Render one frame to `path`; returns its facts."""
    scene, started = bpy.context.scene, time.perf_counter()
    description = read(frame)
    # As Blender does, once the scene is known to be valid.
    make_folder(os.path.dirname(path))
    exr = path.lower().endswith(".exr")
    exr_path = path if exr else None
    finished = render_scene(description, settings, exr_path, console.progress(frame), started=started)
    if not exr:
        for view, layer in finished.layers:
            finished.files.append(view_path(path, view.suffix))
            image = show_in_image(layer)
            try:
                save_view_transformed(image, finished.files[-1], scene)
            finally:
                bpy.data.images.remove(image)
        finished.files += write_deep_files(path, finished.layers)
    for warning in finished.warnings:
        console.event("warning", warning, frame=frame, message=warning)
    facts = {
        "frame": frame,
        "file": finished.files[0],
        "files": finished.files,
        "seconds": finished.seconds,
        "warnings": finished.warnings,
    }
    expected = finished.layer.report.expected_error
    error = f", expected error {expected}" if expected else ""
    # Render farms parse Blender's message.
    saved = "\n".join(f"Saved: '{file}'" for file in finished.files)
    console.event("frame", f"wrote {' and '.join(finished.files)} in {finished.seconds:.1f} s{error}\n{saved}", **facts)
    return {**facts, "report": finished.layer.report.to_dict()}


def bake(options: argparse.Namespace, console: Console, found: dict) -> None:
    """Bake the light of each frame, and write a .blend file that shows it."""
    scene = bpy.context.scene
    if options.save and not options.save.lower().endswith(".blend"):
        raise SceneError(f"--save must end in .blend, not {options.save!r}")
    frames = parse_frames(options.frames) if options.frames else [scene.frame_current]
    frames, sequence = light_frames(frames), LightSequence(light_folder(options.folder))
    with _overridden(options) as settings:
        settings, read = replace(settings, directional=not options.no_directions), frame_reader(options, frames)

        def work(frame: int) -> dict:
            description = read(frame)
            expected = forecast_bake(bpy.context.evaluated_depsgraph_get(), settings.directional)
            if expected is not None and not sequence.frames:
                said = f"baking frame {frame} takes {expected}"
                console.event("estimate", said, frame=frame, seconds=round(expected.seconds, 1))
            one = sequence.add(bake_scene(description, settings, sequence.target, console.progress(frame)))
            for warning in dict.fromkeys(one.warnings + bake_warnings(description)):
                console.event("warning", warning, frame=frame, message=warning)
            learn_from_bake(one, expected)
            files = {light.name: light.path for light in one.volumes}
            facts = {"frame": frame, "files": files, "seconds": one.seconds, "warnings": one.warnings}
            done = f"baked frame {frame} in {one.seconds:.1f} s" if one.seconds else f"frame {frame} has not changed"
            lines = [done, *(f"Saved: '{path}'" for path in files.values())]
            console.event("frame", "\n".join(lines), **facts)
            return facts

        failed = each_frame(frames, work, console, found, options.strict)
    if options.save:
        if len(frames) == 1:
            show_light(scene, sequence.frames[0])
        elif any(one.volumes for one in sequence.frames):
            show_sequence(scene, sequence.frames)
        if options.fast and scene.render.engine == "CYCLES":
            console.event("fast", make_fast(bpy.context.evaluated_depsgraph_get()))
        path = os.path.abspath(bpy.path.abspath(options.save))
        try:
            bpy.ops.wm.save_as_mainfile(filepath=path, copy=True)
        except RuntimeError as error:
            raise SceneError(f"cannot write {path}: {reason(error)}") from error
        found["save"] = path
        console.event("saved", f"Saved: '{path}'", file=path)
    require_none(failed, frames)


def flipbook(options: argparse.Namespace, console: Console, found: dict) -> None:
    """Render six-way light maps of the frames into textures."""
    with _overridden(options) as settings:
        render_flipbook(options, settings, console, found)


def compare(options: argparse.Namespace, console: Console, found: dict) -> None:
    """Compare one frame with Cycles and write the report."""
    scene = bpy.context.scene
    if options.frame is not None:
        scene.frame_set(options.frame)
    with _overridden(options) as settings:
        run = ComparisonRun(
            bpy.context,
            settings,
            Options(
                samples=options.samples,
                seconds=options.seconds,
                ladder=options.ladder,
                denoised=not options.no_denoise,
                usual=options.usual,
                all_models=options.all_models,
                bounces=options.bounces,
                scale=options.scale,
                reference_path=options.reference or "",
                folder=options.folder,
            ),
        )
        run.wait(console.progress(scene.frame_current))
    comparison = run.result()
    page = run.write(comparison)
    found["comparison"] = comparison.figures()
    for warning in comparison.warnings:
        console.event("warning", warning, message=warning)
    console.event("comparison", f"{comparison.table()}\nreport: {page}", report=str(page), **found["comparison"])


def report(options: argparse.Namespace, console: Console, found: dict) -> None:
    """Describe what a frame's render would do, without rendering."""
    scene = bpy.context.scene
    if options.frame is not None:
        scene.frame_set(options.frame)
    with _overridden(options) as settings:
        description = frame_reader(options, [scene.frame_current])(scene.frame_current)
        plan, bakes = description.plan(settings), forecast_bake(bpy.context.evaluated_depsgraph_get())
    width, height = description.camera.resolution
    found["plan"] = {
        "frame": description.frame,
        "resolution": [width, height],
        "volumes": [{"name": volume.name, "voxels": list(volume.density.shape)} for volume, _ in description.volumes],
        "suns": [light.name for light in description.lights],
        "planned": plan.planned if plan else [],
        "left_out": plan.left_out if plan else [],
        "warnings": description.warnings,
        "memory": plan.memory if plan else 0,
        "bake_seconds": round(bakes.seconds, 1) if bakes else 0.0,
    }
    memory = f"{found['plan']['memory'] / 2**30:.1f} GiB of memory"
    lines = [f"frame {description.frame}, {width} x {height} pixels, about {memory}"]
    lines += [
        f'  volume "{volume.name}": {" x ".join(map(str, volume.density.shape))} voxels'
        for volume, _ in description.volumes
    ]
    lines += [f"  {light.name}" for light in description.lights]
    lines += [f"  renders {sentence}" for sentence in found["plan"]["planned"]]
    lines += [f"  leaves out {sentence}" for sentence in found["plan"]["left_out"]]
    lines += [f"  baking its light takes {bakes}"] if bakes else []
    for warning in description.warnings:
        console.event("warning", warning, message=warning)
    console.event("report", "\n".join(lines), **found["plan"])


@contextmanager
def _overridden(options: argparse.Namespace) -> Iterator[Settings]:
    """The scene's settings with those of the command line; the scene is restored afterwards."""
    scene = bpy.context.scene
    settings = scene_settings(scene).settings()
    names = ("depth_samples", "blur_rays", "seed", "threads", "model", "provider", "optimizations")
    given = {name: getattr(options, name) for name in names if getattr(options, name) is not None}
    if options.memory_limit is not None:
        given["memory_limit"] = options.memory_limit * 2**30
    before = scene.render.resolution_percentage, scene.camera
    try:
        if options.resolution_percentage is not None:
            scene.render.resolution_percentage = options.resolution_percentage
        if options.camera is not None:
            scene.camera = _camera(options.camera)
        with bpy.context.temp_override(view_layer=_view_layer(scene, options.view_layer)):
            yield replace(settings, **given)
    finally:
        scene.render.resolution_percentage, scene.camera = before


def _camera(name: str) -> "bpy.types.Object":
    camera: Any = bpy.context.scene.objects.get(name)
    if camera is None or camera.type != "CAMERA":
        cameras = [other.name for other in bpy.context.scene.objects if other.type == "CAMERA"]
        raise SceneError(f"there is no camera {name!r} in the scene; there are: {', '.join(cameras) or 'none'}")
    return camera


def _view_layer(scene: "bpy.types.Scene", name: str | None) -> "bpy.types.ViewLayer":
    if name is None:
        return bpy.context.view_layer
    if name not in scene.view_layers:
        raise SceneError(f"there is no view layer {name!r}; there are: {', '.join(scene.view_layers.keys())}")
    return scene.view_layers[name]
