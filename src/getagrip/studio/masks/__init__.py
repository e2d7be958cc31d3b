"""Object masks of every frame, from a box, strokes, clicks or polygons on some."""
