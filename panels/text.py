"""Sentences in panels, whose labels do not wrap by themselves."""

import textwrap

# Of Blender's interface font, at scale 1.
PIXELS_A_LETTER = 8


def draw_text(context, layout, text: str, icon: str = 'NONE') -> None:
    """A sentence in as many labels as the region's width asks for, the first with the icon."""
    letters = int(context.region.width / (PIXELS_A_LETTER * context.preferences.system.ui_scale))
    column = layout.column(align=True)
    column.scale_y = 0.8
    for index, line in enumerate(textwrap.wrap(text, max(letters - 6, 20))):
        column.label(text=line, icon=icon if index == 0 else 'BLANK1')
