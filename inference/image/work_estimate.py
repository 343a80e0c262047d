# SPDX-License-Identifier: GPL-3.0-or-later
"""How much work a render is: told to its Progress, and corrected as tiles and predictions are finished."""

from dataclasses import replace

import numpy as np

from .camera_pass import estimate_march
from .context import ChannelPass, PreparedScene, RenderContext, Tile
from .framebuffer import Window

# Share of the depth samples at which the network is evaluated, before any is known: pixels interpolate from their
# neighbours.
EVALUATED_SHARE = 0.4


class WorkEstimate:
    """Expects marched steps and depth samples by what a sparse grid of rays takes in the first channel pass.

    A job is one group of volumes in the light of one sun, or of all environments, in one set of colour channels.
    """

    def __init__(self, context: RenderContext, scene: PreparedScene):
        self._context, self._scene, self._passes = context, scene, len(scene.plan.channels)
        # By the window of each tile, and of all tiles in all passes; and of those that are finished.
        self._expected: dict[Window, np.ndarray] = {}
        self._all, self._finished = np.zeros((2, 2))
        plan, progress = scene.plan, context.progress
        groups = sum(plan.predicts(g, channels) for channels in plan.channels for g in range(len(plan.groups)))
        suns = groups * (len(plan.predicted_suns()) + len(plan.lamps) * plan.predicts_lamps)
        # Environments are predicted together.
        self._jobs = suns + groups * bool(scene.environments)
        progress.expect("transport", self._jobs)
        progress.expect("lattices", self._jobs)

    def survey(self, channel_pass: ChannelPass) -> None:
        """Set what is expected of camera rays and of the network, once, where somebody wants to know."""
        if self._expected or not self._context.progress.wanted:
            return
        jobs, rays = self._jobs / self._passes, 1 if self._scene.eyes is None else self._scene.eyes.rays
        for window in self._scene.plan.tiles:
            expected = np.zeros(2)
            for part, groups in self._scene.parts(window):
                camera = replace(self._scene.camera, region=part)
                steps, samples = estimate_march(self._context, channel_pass.through(groups), camera, rays)
                expected += [steps, samples * jobs]
            self._expected[window] = expected
        self._all = sum(self._expected.values()) * self._passes
        self._context.progress.expect("march", self._all[0])
        self._context.progress.expect("network", EVALUATED_SHARE * self._all[1])

    def tile_finished(self, tile: Tile) -> None:
        """Count what a tile took, and correct by it what is expected of the others."""
        progress, threads = self._context.progress, self._context.tasks.threads
        counts, seconds = tile.report.counts, tile.report.seconds
        self._finished = self._finished + self._expected.get(tile.camera.window, 0.0)
        for number, (stage, unit) in enumerate((("march", "steps evaluated"), ("network", "network points"))):
            progress.advance(stage, counts.get(unit, 0), seconds.get(stage, 0.0) / threads)
            if self._finished[number] > 0.0:
                left = self._all[number] / self._finished[number]
                progress.expect(stage, progress.done(stage) * max(left, 1.0))
