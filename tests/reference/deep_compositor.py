# SPDX-License-Identifier: GPL-3.0-or-later
"""A compositor of deep images, written from OpenEXR's description of deep pixels, one pixel after another."""

import math


def seen_before(samples, depth):
    """What samples of a pixel show in front of a depth: [r, g, b, a].

    samples: (front, back, r, g, b, a) each, the nearest first, colours premultiplied.
    """
    shown = [0.0] * 4
    for front, back, *colour, alpha in samples:
        if depth <= front:
            break
        part = 1.0
        if depth < back:
            fraction = (depth - front) / (back - front)
            if alpha <= 0.0:
                part = fraction
            elif alpha >= 1.0:
                part = 1.0
            else:
                part = -math.expm1(fraction * math.log1p(-alpha)) / alpha
        left = 1.0 - shown[3]
        for number, value in enumerate((*colour, alpha)):
            shown[number] += left * value * part
    return shown


def merged_with_surface(samples, depth, colour):
    """What shows of a pixel's samples and an opaque surface at a depth behind or within them: [r, g, b, a]."""
    shown = seen_before(samples, depth)
    return [value + (1.0 - shown[3]) * of_surface for value, of_surface in zip(shown, (*colour, 1.0))]
