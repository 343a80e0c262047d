"""How much work a render will be: told to its Progress, and corrected as tiles are finished."""

from typing import List

from .camera_pass import estimate_steps
from .context import PreparedScene, RenderContext, Tile

# Network points per depth sample before any are known: pixels interpolate from their neighbours.
POINTS_PER_SAMPLE = 0.5


class WorkEstimate:
    """Expects marched steps and network points in proportion to the steps that each tile's rays take."""

    def __init__(self, context: RenderContext, scene: PreparedScene, tiles: List[Tile]):
        self._progress, plan = context.progress, scene.plan
        self._weights = {}
        media = scene.media(plan.channels[0]) if tiles else []
        for tile in tiles:
            self._weights[tile.camera.window] = estimate_steps(scene, media, tile.camera)
        self._total = sum(self._weights.values()) * len(plan.channels)
        self._finished = 0.0
        jobs = sum(plan.multiple) * len(plan.suns) * len(plan.channels)
        pixels = sum((x1 - x0) * (y1 - y0) for x0, y0, x1, y1 in self._weights)
        self._progress.expect("march", self._total)
        self._progress.expect("network", POINTS_PER_SAMPLE * pixels * context.settings.depth_samples * jobs)

    def tile_finished(self, tile: Tile) -> None:
        """Correct what is expected of the rest by what this tile took."""
        self._finished += self._weights[tile.camera.window]
        if self._finished > 0.0:
            for stage in ("march", "network"):
                self._progress.expect(stage, self._progress.done(stage) * max(self._total / self._finished, 1.0))
