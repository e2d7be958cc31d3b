"""Hand-object stable grasp reconstruction: the pose of a rigid object held in a hand, over a video clip.

::

    import getagrip

    clip, masks = getagrip.synthesise("mug")         # or read_clip(folder) and read_masks(clip)
    result = getagrip.reconstruct(clip, masks)
    print(getagrip.evaluate(result, clip, masks).metrics)

The public names and their modules are listed in ``__init__.pyi``. Each is loaded when it is first used, so that
``import getagrip`` takes no time.
"""

from getagrip.io import interrupts

if interrupts.is_program():  # before anything else takes time
    interrupts.while_loading()

import lazy_loader

__version__ = "0.1.0"
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
