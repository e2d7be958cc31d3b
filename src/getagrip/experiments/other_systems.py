"""Results of other systems as rows of the tables, beside our methods."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

from getagrip.clip import Clip, Masks, observed_frames
from getagrip.clip.sampling import frame_indices
from getagrip.errors import InputError, UsageError
from getagrip.evaluation.other_poses import ExternalSystem
from getagrip.experiments.changes import UNCHANGED
from getagrip.experiments.settings import REFERENCE_METHOD
from getagrip.experiments.variants import Variant, by_contact
from getagrip.fitting.methods import METHODS
from getagrip.fitting.options import Options, PriorsFile
from getagrip.io.files import is_portable_name, sha256
from getagrip.metrics.contact import ContactDefinition
from getagrip.result import Reconstruction


def system_of(text: str) -> ExternalSystem:
    """Parse ``NAME=FOLDER``. Raises ``UsageError``."""
    name, equals, folder = text.partition("=")
    if not (equals and folder and is_portable_name(name)):
        raise UsageError(f"--with must be NAME=FOLDER (got {text!r})")
    if name in METHODS:
        raise UsageError(f"--with must be another name than those of the methods (got {name!r})")
    if not Path(folder).is_dir():
        raise UsageError(f"--with must be a folder with poses for each clip (got {text!r})")
    return ExternalSystem(name, Path(folder))


def system_variants(
    systems: Sequence[ExternalSystem], base: Options, contacts: Sequence[ContactDefinition], refine: bool = False
) -> list[Variant]:
    """Make a row for each system, by each definition of contact, and one of ours that starts from its poses."""
    rows = [
        Variant(each.name, each.name, base, UNCHANGED, contacts[0], REFERENCE_METHOD, each.name, each.name, each)
        for each in systems
    ]
    for each in systems if refine else ():
        label, options = f"{each.name}, refined", replace(base, init="poses", priors=PriorsFile(each.root))
        folder = f"{each.name}+refined"
        rows.append(Variant(label, folder, options, UNCHANGED, contacts[0], each.name, each.name, label))
    return by_contact(rows, contacts)


def options_with_checksum(variant: Variant, clip: str) -> dict[str, object]:
    """Return a variant's options.

    For another system's results, they include the checksum of their files, empty where none are.
    """
    options = asdict(variant.options)
    if variant.system is None:
        return options
    try:
        return options | {"poses_sha256": sha256(variant.system.inputs(clip))}
    except InputError:  # named where they are read
        return options | {"poses_sha256": ""}


def external_result(variant: Variant, clip: Clip, masks: Masks) -> Reconstruction:
    """Return another system's poses in the frames in which our methods are evaluated. Raises ``InputError``."""
    assert variant.system is not None
    if variant.options.every_frame:
        return variant.system.result(clip, masks, clip.frames)
    visible = observed_frames(clip, masks.observed)
    return variant.system.result(clip, masks, visible.take(frame_indices(len(visible), variant.options.frames)).frames)
