"""One clip, reconstructed and evaluated in every variant; results that exist already are kept.

A result is kept as a result folder, its metrics in ``result.json``, so that the other commands can read it.

Results of other systems as rows of the tables, beside our methods.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from itertools import groupby
from pathlib import Path

import numpy as np

from getagrip.batch.freshness import software_of_method, valid_result
from getagrip.batch.job import failed_outcome
from getagrip.bench.ablations import REFERENCE_METHOD, Variant, by_contact
from getagrip.bench.inputs.perturbations import UNCHANGED
from getagrip.bench.job import ClipScores, Trial
from getagrip.clip import Clip, Masks, input_sha256, observed_frames, read_clip, read_masks
from getagrip.clip.clip import frame_indices
from getagrip.errors import InputError, UsageError
from getagrip.fitting.methods import METHODS
from getagrip.fitting.options import Options, PriorsFile
from getagrip.io import files, plugins
from getagrip.io.files import Json, is_portable_name, sha256
from getagrip.metrics.contact import CONTACT_DEFINITIONS, ContactDefinition
from getagrip.metrics.evaluate.comparison import write_result_hands
from getagrip.metrics.evaluate.external import ExternalSystem
from getagrip.metrics.evaluate.metric import METRICS, REPLAY_STABILITY, SCA
from getagrip.result import Reconstruction, read_result_record, software_versions, write_result
from getagrip.result.findings import read_findings, read_probability


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


EVALUATION_CODE = "metrics/evaluate"
CHANGES_CODE = ("bench/inputs", "bench/job.py")
EXTERNAL_SYSTEMS_CODE = (EVALUATION_CODE, "bench/grasp_job.py")
"""Code that results depend on, besides that of a reconstruction: the metrics in them; those of changed clips; those of
other systems."""


@dataclass(frozen=True)
class GraspTrial(Trial["GraspClipScores"]):
    """A clip and the variants that are run on it; results go to ``results/<variant's folder>/<clip>``."""

    variants: tuple[Variant, ...]
    contacts: tuple[ContactDefinition, ...] = CONTACT_DEFINITIONS
    """Those by which results are evaluated."""
    replay: bool = False
    """True if they are simulated, too."""

    def failed(self, why: str, trace: str = "") -> GraspClipScores:
        return GraspClipScores(self.name, failure=why, trace=trace)

    def scores(self) -> GraspClipScores:
        """Reconstruct and evaluate a clip with every variant: failures of these are part of the scores."""
        clip = read_clip(self.sample.folder)
        checksum = input_sha256(self.sample.folder)
        scores, missing = dict[str, GraspVariantScore](), list[Variant]()
        for variant in self.variants:
            place = _variant_folder(self, variant)
            there, _ = _existing_result(self, variant, clip.name, _changed_clip_checksum(checksum, variant, clip.name))
            if there is None or not _is_evaluation_current(there[1], self.contacts, self.replay):
                missing.append(variant)
            else:
                scores[variant.folder] = _read_score(variant, place, there[1])
        if missing:
            scores |= _score_missing_variants(self, clip, missing, checksum)
        subject = str(clip.provenance.get("subject", ""))
        ordered = tuple(scores[variant.folder] for variant in self.variants if variant.folder in scores)
        return GraspClipScores(clip.name, clip.category, subject, clip.truth is not None, ordered, len(missing))


@dataclass(frozen=True)
class GraspVariantScore:
    """The score of a variant on a clip."""

    variant: str
    """The variant's folder."""
    metrics: dict[str, float]
    """Empty where it failed."""
    seconds: float
    energy: float
    ambiguous: bool
    status: str
    failed: bool = False
    again: str = ""
    """Why it was made again, where a result was there that is no longer good."""
    serious: tuple[str, ...] = ()
    """Names of the checks that found something serious."""
    noted: tuple[str, ...] = ()
    """Names of those that found something else."""
    probability_right: float | None = None
    """By its own signs; None where that is not calibrated."""
    probability_right_in_camera: float | None = None
    keep: float | None = None
    """Largest share of right results for which it is kept, in the hand."""
    keep_in_camera: float | None = None


@dataclass(frozen=True)
class GraspClipScores(ClipScores):
    """The scores of all variants on a clip."""

    category: str = ""
    subject: str = ""
    """Who holds the object; empty where unknown."""
    has_truth: bool = False
    """True if the clip has ground truth."""
    scores: tuple[GraspVariantScore, ...] = ()
    made: int = 0
    """How many results are new."""


def _score_missing_variants(
    trial: GraspTrial, clip: Clip, variants: list[Variant], checksum: str
) -> dict[str, GraspVariantScore]:
    """Score the variants without a result yet; masks are read once, and each change of the clip is made once."""
    masks, scores = read_masks(clip), dict[str, GraspVariantScore]()

    def change(variant: Variant) -> str:
        return repr(variant.change)

    for _, same in groupby(sorted(variants, key=change), change):
        alike = list(same)
        changed = alike[0].change(clip, masks, alike[0].options.seed)
        judged = masks.take(clip.index_of(changed[0].frames))
        for variant in alike:
            identity = _changed_clip_checksum(checksum, variant, clip.name)
            scores[variant.folder] = _run_variant(trial, variant, changed, judged, identity)
    return scores


def _run_variant(
    trial: GraspTrial, variant: Variant, changed: tuple[Clip, Masks], masks: Masks, checksum: str
) -> GraspVariantScore:
    """Reconstruct, evaluate and write the result: against the clip as the variant has it, and the masks as they are.

    A method's error, and another system's files that are missing or wrong, become its score; else ``InputError`` is
    raised.
    """
    from getagrip.export.replay import simulate_replay
    from getagrip.export.scene import Scene
    from getagrip.metrics.evaluate import evaluate
    from getagrip.reconstruct import reconstruct

    clip, place = changed[0], _variant_folder(trial, variant)
    try:
        there, why = _existing_result(trial, variant, clip.name, checksum)
        if there is not None:
            result = there[0]
        elif variant.system is not None:
            result = replace(external_result(variant, *changed), options=options_with_checksum(variant, clip.name))
        else:
            result = reconstruct(replace(clip, segments=()), changed[1], variant.options)
        metrics = evaluate(result, clip, masks, trial.contacts).metrics
        if trial.replay:
            metrics[REPLAY_STABILITY.name] = (
                simulate_replay(Scene.of(result, clip)).stays if clip.hand.joints is not None else np.nan
            )
        write_result(result, place, checksum, metrics, clip.folder, overwrite=True, made_by=_software_of(variant))
        if variant.change.other_hands:
            write_result_hands(clip, place, input_sha256(clip.origin))
    except Exception as error:
        if isinstance(error, InputError) and variant.system is None:
            raise
        return GraspVariantScore(
            variant.folder, {}, np.nan, np.nan, False, failed_outcome(clip.name, error).message, failed=True
        )
    return replace(_read_score(variant, place, read_result_record(place)), again=why)


def _is_evaluation_current(record: Json, contacts: Sequence[ContactDefinition], replay: bool) -> bool:
    """Return whether a result was evaluated by this code, by all these definitions; else only that is done again."""
    by_this = record["software"].get("evaluation") == _evaluation_fingerprint()
    if replay and REPLAY_STABILITY.name not in record["metrics"]:
        return False
    return by_this and all(SCA.key(contact) in record["metrics"] for contact in contacts)


def _read_score(variant: Variant, place: Path, record: Json) -> GraspVariantScore:
    """Read the score in a result's record."""
    metrics = {key: np.nan if value is None else float(value) for key, value in record["metrics"].items()}
    of_all = (record["seconds"]["total"], record["energy"]["total"])
    seconds, energy = (np.nan if value is None else float(value) for value in of_all)
    found = read_findings(place / "result.json", record["findings"])
    serious, noted = (tuple(f.check for f in found if f.serious == kind) for kind in (True, False))
    keys = ("probability_right", "probability_right_in_camera")
    known = [read_probability(place / "result.json", record[key], key) for key in keys]
    right, in_camera = (None if one is None else one.value for one in known)
    keep, keep_in_camera = (None if one is None else one.keep for one in known)
    return GraspVariantScore(
        variant.folder, metrics, seconds, energy, record["ambiguous"], record["message"], serious=serious, noted=noted,
        probability_right=right, probability_right_in_camera=in_camera, keep=keep, keep_in_camera=keep_in_camera,
    )  # fmt: skip


def _variant_folder(trial: GraspTrial, variant: Variant) -> Path:
    """Return the folder of a variant's result."""
    return trial.results / variant.folder / trial.sample.name


def _changed_clip_checksum(checksum: str, variant: Variant, clip: str) -> str:
    """Return the checksum of the clip as the variant changes it: ``evaluate`` must not take it for the folder's."""
    if variant.change == UNCHANGED:
        return checksum
    changed = f"{checksum} {variant.change} {variant.options.seed}"
    if inputs := variant.change.inputs(clip):
        changed += f" {files.sha256(inputs)}"
    return hashlib.sha256(changed.encode()).hexdigest()


def _existing_result(
    trial: GraspTrial, variant: Variant, clip: str, checksum: str
) -> tuple[tuple[Reconstruction, Json] | None, str]:
    """Return a variant's existing result, as ``valid_result``.

    ``checksum`` is that of the clip as the variant has it.
    """
    options, place = options_with_checksum(variant, clip), _variant_folder(trial, variant)
    return valid_result(place, checksum, variant.method, options, _software_of(variant), trial.overwrite)


def _software_of(variant: Variant) -> dict[str, str]:
    """Return the software that makes a variant's result, and the code of ``evaluation`` that measures it."""
    also: tuple[str, ...] = () if variant.change == UNCHANGED else CHANGES_CODE
    if variant.system is not None:
        also += EXTERNAL_SYSTEMS_CODE
    made = software_of_method(variant.method, *also) if variant.system is None else software_versions(*also)
    return made | {"evaluation": _evaluation_fingerprint()}


def _evaluation_fingerprint() -> str:
    """Return the checksum of ``evaluation``, and of other packages' metrics."""
    return " with ".join([plugins.fingerprint(EVALUATION_CODE, "export/replay.py"), *METRICS.made_of()])
