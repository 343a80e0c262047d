"""Operators whose work begins once a thread has read the scene's volumes; Blender stays usable meanwhile."""

from ..mrpnn_addon.grid_loading import GridLoading
from ..mrpnn_addon.volumes import VolumeReader

SECONDS_A_TICK = 0.1


class WaitsForVolumes:
    """Mixin of an operator with a window."""

    _loading = None
    _reading_timer = None

    def wait_for_volumes(self, context) -> bool:
        """Begin to read what the scene's volumes lack; whether there is anything to wait for, in `modal`."""
        wanted = VolumeReader().wanted(context.evaluated_depsgraph_get())
        if not wanted:
            return False
        self._loading = GridLoading(wanted)
        self._reading_timer = context.window_manager.event_timer_add(SECONDS_A_TICK, window=context.window)
        context.workspace.status_text_set("Reading volumes  (Esc stops)")
        context.window_manager.modal_handler_add(self)
        return True

    def still_waiting(self, context, event):
        """What `modal` has to give while this reads, or where it has failed; None once everything is read."""
        if event.type == 'ESC':
            self._loading.stop()
            return {'RUNNING_MODAL'}
        if event.type != 'TIMER' or not self._loading.done:
            return {'PASS_THROUGH'}
        error = self._loading.error
        if error is None:
            self.stop_waiting(context, keep=True)
            return None
        cancelled = self._loading.cancelled
        self.stop_waiting(context)
        self.report({'INFO'} if cancelled else {'ERROR'}, "stopped" if cancelled else str(error))
        return {'CANCELLED'}

    def stop_waiting(self, context, keep: bool = False) -> None:
        """End it. keep: what was read stays in use for as long as this operator is at work."""
        if self._reading_timer is not None:
            context.window_manager.event_timer_remove(self._reading_timer)
            context.workspace.status_text_set(None)
            self._reading_timer = None
        if not keep and self._loading is not None:
            self._loading.stop()
            self._loading = None
