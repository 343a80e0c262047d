// SPDX-License-Identifier: GPL-3.0-or-later
//
// Flamenco 3 job type: the volumes of a .blend file by MRPNN, in chunks of frames.
// Copy it into the `scripts` folder beside the Flamenco Manager and restart it.

const JOB_TYPE = {
    label: "MRPNN Volumes",
    description: "Render the volumes of the scene to multi-layer EXR files, one a frame",
    settings: [
        {
            key: "frames", type: "string", required: true,
            eval: "f'{C.scene.frame_start}-{C.scene.frame_end}'",
            evalInfo: { showLinkButton: true, description: "Frames of the scene" },
            description: "Frames to render, e.g. 1-30 or 3,5-10",
        },
        {
            key: "chunk_size", type: "int32", default: 5, visible: "submission",
            description: "Frames in one task; a task starts Blender once",
        },
        {
            key: "output", type: "string", subtype: "file_path", required: true,
            eval: "abspath('//mrpnn/######.exr')",
            description: "File of each frame, .exr or .png; # are the frame's digits",
        },
        {
            key: "skip_existing", type: "bool", default: true, visible: "submission",
            description: "Leave frames whose file is there, so that a task that is started again goes on where it was",
        },
        {
            key: "strict", type: "bool", default: true, visible: "submission",
            description: "Fail where an object cannot be rendered, instead of leaving it out with a warning",
        },
        { key: "blendfile", type: "string", required: true, visible: "web", description: "File to render" },
    ],
};

function compileJob(job) {
    const settings = job.settings;
    for (const chunk of frameChunker(settings.frames, settings.chunk_size)) {
        const task = author.Task(`render-${chunk}`, "blender");
        task.addCommand(author.Command("blender-render", {
            exe: "{blender}",
            exeArgs: "{blenderArgs}",
            argsBefore: [],
            blendfile: settings.blendfile,
            args: ["--command", "mrpnn", "render", "--output", settings.output, "--frames", chunk]
                .concat(settings.skip_existing ? ["--skip-existing"] : [], settings.strict ? ["--strict"] : []),
        }));
        job.addTask(task);
    }
}
