# SPDX-License-Identifier: GPL-3.0-or-later
"""Between Blender and `inference`: reads scenes and hands layers back.

Packages import only those above them in this list; `tests/package/test_import_order.py` checks it.

    runtime     threads, processes of their own, files that are complete or absent
    settings    properties of scenes and view layers, preferences, networks to choose from
    textures    procedural textures
    nodes       shader nodes and materials, evaluated as Cycles evaluates them
    vdb         density grids of .vdb files
    objects     transforms, visibility, camera, lights, meshes and surfaces
    world       the World as directional lights and as a picture
    volumes     volume objects, meshes and fluid domains as density grids
    scene       the evaluated scene as `inference.render` takes it
    output      layers as images, render passes, OpenEXR files and compositing nodes
    baking      baked light for Cycles and EEVEE
    status      forecasts, checks, and the last results, for panels
    engine      the render engine, its viewport, and render jobs
    cycles      path-traced references by Cycles
    comparison  MRPNN against Cycles: plan, job, report
    flipbook    six-way light maps for games and relighting

bpy is called on Blender's main thread only; what other threads need is read there first.
"""
