"""Colours and letters that all pictures share."""

from __future__ import annotations

from contextlib import AbstractContextManager

PAPER_COLOUR, INK_COLOUR, MUTED_COLOUR, LINE_COLOUR = "#f4f4f1", "#2b2f33", "#8a9096", "#d9dad6"
RESULT_COLOUR, AXIS_COLOUR, HIDDEN_AXIS_COLOUR, TRUTH_COLOUR, HAND_LINE_COLOUR = (
    "#c8553d",
    "#2a9d8f",
    "#a8e0d5",
    "#6c757d",
    "#7b5ea7",
)
STATE_COLOURS = {"static": "#6f9a8d", "contact": "#e0a458", "grasp": "#c8553d", "free": "#7b5ea7", "unknown": "#d9dad6"}
"""Colours of the states in a timeline's bar."""
HAND_RGB, OBJECT_RGB = (0.87, 0.72, 0.63), (0.44, 0.58, 0.69)
"""Colours of rendered surfaces."""
PAPER_RGB = (0xF4 / 255.0, 0xF4 / 255.0, 0xF1 / 255.0)
"""``PAPER_COLOUR`` as rendered pictures take it."""
BLANK_RGB, OBSERVED_MASK_RGB, IGNORED_MASK_RGB = (244, 244, 241), (126, 158, 184), (216, 200, 186)
"""Colours of pixels, where masks are drawn for want of an image: neither, object, ignored."""


def figure_style() -> AbstractContextManager[None]:
    """Set the project's font, and its colours of text and axes, for figures that are drawn within."""
    from matplotlib import rc_context

    return rc_context(
        {
            "font.family": "DejaVu Sans",
            "font.size": 8.5,
            "text.color": INK_COLOUR,
            "axes.edgecolor": LINE_COLOUR,
            "axes.labelcolor": MUTED_COLOUR,
            "xtick.color": MUTED_COLOUR,
            "ytick.color": MUTED_COLOUR,
        }
    )
