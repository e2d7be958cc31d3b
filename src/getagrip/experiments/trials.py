"""One clip, reconstructed and evaluated in every variant; results that exist already are kept.

A result is kept as a result folder, its metrics in ``result.json``, so that the other commands can read it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

import getagrip
from getagrip.batch.job import failure
from getagrip.clip import Clip, Masks, input_sha256, read_clip, read_masks
from getagrip.errors import InputError, UsageError
from getagrip.evaluation.metric import SCA
from getagrip.experiments.changes import AS_GIVEN
from getagrip.experiments.other_systems import options_of, result_of
from getagrip.experiments.sources import Sample
from getagrip.experiments.variants import Variant
from getagrip.finding import read_findings
from getagrip.io import files
from getagrip.metrics.contact import CONTACT_DEFINITIONS, ContactDefinition
from getagrip.probability import read_probability
from getagrip.result import is_result, read_record, read_result, software, write_result


@dataclass(frozen=True)
class Trial:
    """A clip and the variants that are run on it."""

    sample: Sample
    variants: tuple[Variant, ...]
    results: Path
    """Results go to ``results/<variant's folder>/<clip>``."""
    overwrite: bool
    contacts: tuple[ContactDefinition, ...] = CONTACT_DEFINITIONS
    """Those by which results are evaluated."""

    @property
    def name(self) -> str:
        """The clip's."""
        return self.sample.name


@dataclass(frozen=True)
class Score:
    """What a variant made of a clip."""

    variant: str
    """The variant's folder."""
    metrics: dict[str, float]
    """Empty where it failed."""
    seconds: float
    energy: float
    ambiguous: bool
    status: str
    failed: bool = False
    outdated: bool = False
    """Whether its result existed already and is older than the package's files."""
    serious: tuple[str, ...] = ()
    """Names of the checks that found something serious."""
    noted: tuple[str, ...] = ()
    """Names of those that found something else."""
    probability_right: float | None = None
    """By its own signs; None where that is not calibrated."""
    probability_right_in_camera: float | None = None


@dataclass(frozen=True)
class Scores:
    """What all variants made of a clip."""

    clip: str
    category: str = ""
    subject: str = ""
    """Who holds the object; empty where unknown."""
    has_truth: bool = False
    """Whether the clip has ground truth."""
    scores: tuple[Score, ...] = ()
    made: int = 0
    """How many results are new."""
    failure: str = ""
    """Why there are no scores at all."""
    trace: str = ""


def run(trial: Trial) -> Scores:
    """Reconstruct and evaluate a clip with every variant. Raises nothing: failures are part of the scores."""
    sample = trial.sample
    try:
        if sample.make is not None and not sample.folder.exists():
            sample.make(sample.folder)
        clip = read_clip(sample.folder)
        checksum = input_sha256(sample.folder)
        scores, missing = dict[str, Score](), list[Variant]()
        for variant in trial.variants:
            place = _place(trial, variant)
            identity = _checksum(checksum, variant, clip.name)
            record = None if trial.overwrite else _kept(place, identity, options_of(variant, clip.name))
            if record is None or not _measured(record, trial.contacts):
                missing.append(variant)
            else:
                scores[variant.folder] = replace(_score(variant, place, record), outdated=_outdated(place))
        if missing:
            scores |= _made(trial, clip, missing, checksum)
    except Exception as error:  # one clip's trouble must not end the others
        outcome = failure(sample.name, error)
        return Scores(sample.name, failure=outcome.message, trace=outcome.trace)
    subject = str(clip.provenance.get("subject", ""))
    return Scores(clip.name, clip.category, subject, clip.truth is not None, tuple(scores.values()), len(missing))


def _made(trial: Trial, clip: Clip, variants: list[Variant], checksum: str) -> dict[str, Score]:
    """The scores of variants without a result yet; masks are read once, and each change of the clip is made once."""
    masks, scores = read_masks(clip), dict[str, Score]()

    def change(variant: Variant) -> str:
        return repr(variant.change)

    for _, same in groupby(sorted(variants, key=change), change):
        alike = list(same)
        changed = alike[0].change(clip, masks, alike[0].options.seed)
        judged = masks.take(clip.index_of(changed[0].frames))
        for variant in alike:
            identity = _checksum(checksum, variant, clip.name)
            scores[variant.folder] = _try(trial, variant, changed, judged, identity)
    return scores


def _try(trial: Trial, variant: Variant, changed: tuple[Clip, Masks], masks: Masks, checksum: str) -> Score:
    """Reconstruct, evaluate and write the result: against the clip as the variant has it, and the masks as they are.

    A method's error, and another system's files that are missing or wrong, become its score; else ``InputError`` is
    raised.
    """
    from getagrip.evaluation import evaluate
    from getagrip.fitting.reconstruct import reconstruct

    clip, place = changed[0], _place(trial, variant)
    try:
        kept = None if trial.overwrite else _kept(place, checksum, options_of(variant, clip.name))
        if kept is not None:
            result = read_result(place)[0]
        elif variant.system is not None:
            result = replace(result_of(variant, *changed), options=options_of(variant, clip.name))
        else:
            result = reconstruct(*changed, variant.options)
        metrics = evaluate(result, clip, masks, trial.contacts)["metrics"]
        write_result(result, place, checksum, metrics, clip_folder=clip.folder, overwrite=True)
    except Exception as error:
        if isinstance(error, InputError) and variant.system is None:
            raise
        return Score(variant.folder, {}, np.nan, np.nan, False, failure(clip.name, error).message, failed=True)
    return _score(variant, place, read_record(place))


def _measured(record: Mapping[str, Any], contacts: Sequence[ContactDefinition]) -> bool:
    """Whether a result was evaluated by all these definitions of contact; else only that is done again."""
    return all(SCA.key(contact) in record["metrics"] for contact in contacts)


def _score(variant: Variant, place: Path, record: dict[str, Any]) -> Score:
    """The score that a result's record holds."""
    metrics = {key: np.nan if value is None else float(value) for key, value in record["metrics"].items()}
    of_all = (record["seconds"]["total"], record["energy"]["total"])
    seconds, energy = (np.nan if value is None else float(value) for value in of_all)
    found = read_findings(place / "result.json", record["findings"])
    serious, noted = (tuple(f.check for f in found if f.serious == kind) for kind in (True, False))
    keys = ("probability_right", "probability_right_in_camera")
    known = [read_probability(place / "result.json", record[key], key) for key in keys]
    right, in_camera = (None if one is None else one.value for one in known)
    return Score(
        variant.folder, metrics, seconds, energy, record["ambiguous"], record["status"], serious=serious, noted=noted,
        probability_right=right, probability_right_in_camera=in_camera,
    )  # fmt: skip


def _place(trial: Trial, variant: Variant) -> Path:
    """The folder of a variant's result."""
    return trial.results / variant.folder / trial.sample.name


def _checksum(checksum: str, variant: Variant, clip: str) -> str:
    """The checksum of the clip as the variant has it: ``evaluate`` must not take a changed one for the folder's."""
    if variant.change == AS_GIVEN:
        return checksum
    changed = f"{checksum} {variant.change} {variant.options.seed}"
    if inputs := variant.change.inputs(clip):
        changed += f" {files.sha256(inputs)}"
    return hashlib.sha256(changed.encode()).hexdigest()


def _outdated(folder: Path) -> bool:
    """Whether a result is older than the code, which a developer may have changed within a version."""
    return (folder / "result.json").stat().st_mtime < _code_changed()


@lru_cache
def _code_changed() -> float:
    """When the package's files were last changed."""
    return max(file.stat().st_mtime for file in Path(getagrip.__file__).parent.rglob("*.py"))


def _kept(folder: Path, checksum: str, options: Mapping[str, Any]) -> dict[str, Any] | None:
    """The record of the result that is there, if it is one of this clip, these options and this version.

    Raises ``UsageError`` where something else is in its place.
    """
    if not folder.exists():
        return None
    if not is_result(folder):
        raise UsageError(f"{folder}: exists and is no result; it is not overwritten")
    record = read_record(folder)
    same = (
        record["input_sha256"] == checksum
        and record["options"] == json.loads(files.to_json(options))
        and record["software"].get("getagrip") == software()["getagrip"]
        and record["metrics"]
    )
    return record if same else None
