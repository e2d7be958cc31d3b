"""The page of ``getagrip view``: results in 3D, moving, beside their images. Served by viser, which is an extra."""
