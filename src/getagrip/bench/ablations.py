"""Ablations: settings to compare, and the variants (each method in each setting) that run on every clip."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, get_args

from getagrip.bench.inputs.added_views import MAX_ADDED_VIEWS, AddedViews
from getagrip.bench.inputs.hand_sources import HandSource, WithHands
from getagrip.bench.inputs.perturbations import (
    UNCHANGED,
    Change,
    EstimatedHands,
    FlippedHands,
    Gapped,
    Noisy,
    OtherObject,
    ScaleFree,
    ScaleKnown,
    Several,
    TrueHands,
    Wrong,
    WrongMasks,
)
from getagrip.bench.inputs.simulated_evidence import (
    DEPTH_ERROR_LEVELS,
    JOINT_ERROR_LEVELS,
    SimulatedDepth,
    SimulatedJoints,
)
from getagrip.bench.inputs.wrong_inputs import INPUT_MISTAKES
from getagrip.errors import UsageError
from getagrip.fitting.methods import METHODS
from getagrip.fitting.options import BesideMasks, Departures, Options
from getagrip.metrics.contact import CONTACT_DEFINITIONS, ContactDefinition
from getagrip.metrics.evaluate.external import ExternalSystem
from getagrip.synthetic.noise import NOISE_PRESETS, Noise

REFERENCE_METHOD = "one-dof"
"""Baseline of comparisons: our version of the paper's plain hinge."""
DEFAULT_METHODS = tuple(name for name, method in METHODS.own.items() if not method.slow)
"""Methods to compare by default; methods of other packages must be named."""
DEFAULT_CONTACT_DEFINITIONS = (ContactDefinition("object", 0.010),)
"""Default definitions of contact (docs/metrics.md) in the tables."""


@dataclass(frozen=True)
class Setting:
    """One step of an ablation."""

    label: str
    options: Mapping[str, Any] = field(default_factory=dict)
    """Fields of ``Options`` that differ from the run's."""
    change: Change = UNCHANGED
    contact: ContactDefinition | None = None
    """Definition of contact in the metrics; None: the run's."""


@dataclass(frozen=True)
class Ablation:
    """Settings to compare, for each of a few methods."""

    title: str
    usual: str | None
    """Label of the baseline setting; None: methods are compared in each setting."""
    settings: tuple[Setting, ...]
    methods: tuple[str, ...] = (REFERENCE_METHOD, "soft-hinge")
    """Default methods."""


def _hand_noise(mm: float) -> Setting:
    """Make a setting with a bias, and jitter of half its size correlated over 0.1 s; both rotate by 0.8 degrees/mm."""
    deg = 0.8 * mm
    jitter = {"hand_jitter_mm": mm / 2, "hand_jitter_deg": deg / 2, "jitter_memory_s": 0.1}
    return Setting(f"{mm:g} mm, {deg:g}°", change=Noisy(Noise(hand_bias_mm=mm, hand_bias_deg=deg, **jitter)))


def _hand_noise_level(name: str) -> Noise:
    return replace(NOISE_PRESETS[name], mask_ragged_px=0.0)


def _noise_level(name: str) -> Setting:
    return Setting(name, change=Noisy(_hand_noise_level(name)))


def _estimated_hands_setting(label: str, *evidence: Change, level: str = "estimated") -> Setting:
    """Make a setting with evidence simulated from the true hand, then hands that are estimated or as noisy."""
    return Setting(label, change=Several((*evidence, EstimatedHands(_hand_noise_level(level)))))


def _mask_noise(px: float) -> Setting:
    return Setting(f"{px:g} px", change=Noisy(Noise(mask_ragged_px=px)))


def _inaccurate_masks(px: float) -> Setting:
    return replace(_mask_noise(px), label=f"masks off by {px:g} px")


MASK_FAULT_FRACTIONS = (("another object", 0.2), ("another object", 0.4), ("half", 0.2), ("runs over", 0.2))
"""Faults of masks, each with its share of frames."""


def _mask_fault(fault: str, share: float) -> Setting:
    return Setting(f"{fault} in {100 * share:.0f} %", change=WrongMasks(fault, share))


CATEGORY_MESHES = {
    "category mesh": OtherObject(),
    "category mesh, size unknown": Several((OtherObject(), ScaleFree())),
    "category mesh, size unknown, hands moderate": Several(
        (OtherObject(), ScaleFree(), Noisy(_hand_noise_level("moderate")))
    ),
}
"""Template meshes in place of the object's own; the last setting is the paper's, footage without CAD models."""
DEGRADED_INPUT_SETTINGS = _inaccurate_masks(4.0), Setting("size unknown", change=ScaleFree())
"""Degraded inputs with exact hands, where depth helps."""
INPUT_ERROR_SETTINGS = (
    Setting("exact"),
    _hand_noise(10.0),
    _noise_level("strong"),
    _noise_level("estimated"),
    _inaccurate_masks(2.0),
    DEGRADED_INPUT_SETTINGS[0],
    _mask_fault("another object", 0.2),
    DEGRADED_INPUT_SETTINGS[1],
    *(
        Setting(label, change=CATEGORY_MESHES[label])
        for label in ("category mesh", "category mesh, size unknown, hands moderate")
    ),
)
"""Input errors that README summarises; the first four also run on the test objects."""
DEPARTURE_STEPS = {
    "+ energy scale": "scale",
    "+ optimiser": "optimiser",
    "+ search": "search",
    "+ axis start": "axis",
    "+ choice": "choice",
    "+ push": "push",
    "+ pull": "pull",
}
"""Departures from the paper's method, in the order in which the ablation adds them: the scale, the search for the
minimum, the form of the terms. Its first row has push and pull 1000 times as large: the printed units read as
millimetres."""
SIMULATED_LANDMARKS, COMMON_DEPTH_SOURCES = SimulatedJoints("landmarks"), ("mono", "realsense")
"""Evidence that users often have: 2D landmarks, and depth from a network or a sensor."""
ABLATIONS: dict[str, Ablation] = {
    "physical": Ablation(
        "Weights of the physical terms, the paper's λ₂ = λ₃ without the focal length",
        "0.1",
        tuple(Setting(f"{weight:g}", {"push": weight, "pull": weight}) for weight in (0.0, 0.1, 1.0)),
    ),
    "occlusion": Ablation(
        "Pixels occluded by the hand ignored (the paper's C_o)",
        "on",
        (Setting("off", {"occlusion": False}), Setting("on", {"occlusion": True})),
    ),
    "axis": Ablation(
        "Place of the axis: through the origin of the hand frame, or anywhere",
        "free",
        (Setting("hand", {"axis": "hand"}), Setting("free", {"axis": "free"})),
    ),
    "inits": Ablation(
        "Number of initial poses",
        "50",
        tuple(Setting(f"{count}", {"inits": count}) for count in (10, 25, 50, 100, 200)),
    ),
    "hand-noise": Ablation(
        "Noise of the hand poses: a bias, and jitter of half its size",
        "none",
        (
            Setting("none"),
            *(_hand_noise(mm) for mm in (2.5, 5.0, 7.5, 10.0)),
            *map(_noise_level, ("moderate", "strong", "estimated")),
        ),
    ),
    "hand-refinement": Ablation(
        "Hands refined against their own pixels, or as given",
        "none, as given",
        tuple(
            replace(noise, label=f"{noise.label}, {word}", options={"hands": hands})
            for noise in (Setting("none"), _hand_noise(10.0), *map(_noise_level, ("moderate", "strong", "estimated")))
            for hands, word in (("as-given", "as given"), ("corrected", "corrected"))
        ),
        ("soft-hinge",),
    ),
    "evidence": Ablation(
        "Estimated hands, with other evidence simulated at levels of errors (docs/datasets.md)",
        "nothing new",
        (
            _estimated_hands_setting("nothing new"),
            *(_estimated_hands_setting(f"2D joints, {level}", SimulatedJoints(level)) for level in JOINT_ERROR_LEVELS),
            *(_estimated_hands_setting(f"depth, {level}", SimulatedDepth(level)) for level in DEPTH_ERROR_LEVELS),
            *(
                _estimated_hands_setting(
                    f"2D joints, {joints}; depth, {level}", SimulatedJoints(joints), SimulatedDepth(level)
                )
                for joints in ("wild", "landmarks")
                for level in COMMON_DEPTH_SOURCES
            ),
            _estimated_hands_setting("strong, nothing new", level="strong"),
            *(
                _estimated_hands_setting(
                    f"strong, 2D joints; depth, {d}", SIMULATED_LANDMARKS, SimulatedDepth(d), level="strong"
                )
                for d in COMMON_DEPTH_SOURCES
            ),
            *(
                Setting(f"exact, {one.label}; depth, {d}", change=Several((SimulatedDepth(d), one.change)))
                for one in DEGRADED_INPUT_SETTINGS
                for d in COMMON_DEPTH_SOURCES
            ),
        ),
        ("soft-hinge",),
    ),
    "wrong-evidence": Ablation(
        "Estimated hands, with other evidence that is wrong",
        "nothing new",
        (
            _estimated_hands_setting("nothing new"),
            *(
                _estimated_hands_setting(f"2D joints, {level}", SimulatedJoints(level))
                for level in ("other hand", "shifted camera")
            ),
            _estimated_hands_setting("depth, mono-warped", SimulatedDepth("mono-warped")),
        ),
        ("soft-hinge",),
    ),
    "hand-flips": Ablation(
        "Hands that are flipped in some frames: repaired, or used",
        "none, as given",
        tuple(
            Setting(f"{label}, {word}", {"hands": hands}, change)
            for label, change in (
                ("none", UNCHANGED),
                *((f"{100 * p:.0f} %", FlippedHands(p)) for p in (0.1, 0.2, 0.4)),
            )
            for hands, word in (("as-given", "as given"), ("corrected", "repaired"))
        ),
        ("soft-hinge",),
    ),
    "true-hands": Ablation(
        "Hands: as given, refined against their own pixels, or the true ones",
        "as given",
        (
            Setting("as given", {"hands": "as-given"}),
            Setting("corrected", {"hands": "corrected"}),
            Setting("true", {"hands": "as-given"}, change=TrueHands()),
        ),
        ("one-dof", "soft-hinge"),
    ),
    "mask-noise": Ablation(
        "Noise of the masks: distance of their contours from the true ones, root mean square",
        "none",
        (Setting("none"), *(_mask_noise(px) for px in (0.5, 1.0, 2.0, 4.0))),
    ),
    "mask-gaps": Ablation(
        "Gaps between the masks of the object and of what hides it",
        "none",
        (Setting("none"), *(Setting(f"{px} px", change=Gapped(px)) for px in (1, 2, 3, 5))),
    ),
    "wrong-masks": Ablation(
        "Masks that are wrong in some frames: left out, or used",
        "none, as given",
        tuple(
            replace(fault, label=f"{fault.label}, {word}", options={"masks": masks})
            for fault in (Setting("none"), *(_mask_fault(*fault) for fault in MASK_FAULT_FRACTIONS))
            for masks, word in (("as-given", "as given"), ("checked", "checked"))
        ),
        ("soft-hinge",),
    ),
    "other-mesh": Ablation(
        "A mesh of the category: fitted to the masks, or unchanged",
        "own, as given",
        tuple(
            Setting(f"{label}, {word}", {"mesh": mesh}, change)
            for label, change in ({"own": UNCHANGED} | CATEGORY_MESHES).items()
            for mesh, word in (("as-given", "as given"), ("fitted", "fitted"))
        ),
        ("soft-hinge",),
    ),
    "scale": Ablation(
        "Scale of the object",
        "known",
        (Setting("known", change=ScaleKnown()), Setting("free", change=ScaleFree())),
    ),
    "sca": Ablation(
        "Definition of contact: whose points, and at which distance",
        None,
        tuple(Setting(f"{d.side}, {d.distance}", contact=d) for d in CONTACT_DEFINITIONS),
        DEFAULT_METHODS,
    ),
    "inputs": Ablation(
        "Errors of the input: none, or one of them; both methods with the same filters",
        None,
        INPUT_ERROR_SETTINGS,
    ),
    "final": Ablation(
        "Hands that are exact, off by 10 mm and 8°, or at the levels `strong` and `estimated`",
        None,
        INPUT_ERROR_SETTINGS[:4],
    ),
    "final-evidence": Ablation(
        "Estimated hands, with 2D joints and depth simulated as they usually are",
        "nothing new",
        (
            _estimated_hands_setting("nothing new"),
            _estimated_hands_setting("2D joints", SIMULATED_LANDMARKS),
            *(
                _estimated_hands_setting(f"2D joints, {d}", SIMULATED_LANDMARKS, SimulatedDepth(d))
                for d in COMMON_DEPTH_SOURCES
            ),
        ),
        ("soft-hinge",),
    ),
    "wrong-input": Ablation(
        "Deliberate mistakes, and the findings of the checks",
        "none",
        (Setting("none"), *(Setting(mistake, change=Wrong(mistake)) for mistake in INPUT_MISTAKES)),
        ("soft-hinge",),
    ),
    "pixels": Ablation(
        "Evidence beside the silhouette: all of it, without one, or none",
        "none of them",
        (
            Setting("all of it"),
            *(
                Setting(f"without {words}", options)
                for words, options in (
                    ("texture", {"without": ("texture",)}),
                    ("the free profile", {"without": ("profile",)}),
                    ("handles", {"without": ("handle",)}),
                    ("surface motion", {"without": ("surface-motion",)}),
                    ("firm ends", {"interval": "as-given"}),
                )
            ),
            Setting("none of them", {"without": get_args(BesideMasks), "interval": "as-given"}),
        ),
        ("soft-hinge",),
    ),
    "departures": Ablation(
        "From the paper's method to ours: one departure more in each row",
        "as it is",
        (
            Setting("one reading of the printed units", {"push": 100.0, "pull": 100.0}),
            Setting("as it is"),
            *(
                Setting(label, {"departures": Departures(**dict.fromkeys([*DEPARTURE_STEPS.values()][:count], True))})
                for count, label in enumerate(DEPARTURE_STEPS, start=1)
            ),
            # Hands as given, as in all rows: their correction has an ablation of its own.
            Setting("+ soft hinge", {"method": "soft-hinge", "hands": "as-given"}),
        ),
        ("paper",),
    ),
}


@dataclass(frozen=True)
class Variant:
    """One row of a table: options and changes for every clip, and the folder of the results."""

    label: str
    folder: str
    """Variants with the same folder share their results."""
    options: Options
    change: Change
    contact: ContactDefinition
    against: str
    """Label of the baseline variant."""
    group: str
    """Name of the line in a plot: the method."""
    step: str
    """Label on the plot's axis: the setting."""
    system: ExternalSystem | None = None
    """Other system that made the results; None: our methods."""

    @property
    def method(self) -> str:
        """Name of the method or the other system."""
        return self.options.method if self.system is None else self.system.name


def method_variants(
    methods: Sequence[str], base: Options, contacts: Sequence[ContactDefinition] = DEFAULT_CONTACT_DEFINITIONS
) -> list[Variant]:
    """Make a variant of each method (default: ``DEFAULT_METHODS``) by each definition of contact."""
    named: Sequence[str] = methods or DEFAULT_METHODS
    plain = [Variant(m, m, replace(base, method=m), UNCHANGED, contacts[0], REFERENCE_METHOD, m, m) for m in named]
    return by_contact(plain, contacts)


def ablation_variants(
    name: str,
    methods: Sequence[str],
    base: Options,
    contacts: Sequence[ContactDefinition] = DEFAULT_CONTACT_DEFINITIONS,
    ablation: Ablation | None = None,
) -> list[Variant]:
    """Make a variant of each method in each setting of an ablation (default: ``ABLATIONS[name]``).

    Each definition of contact gets variants of its own, unless the ablation compares definitions. A setting without a
    change shares the method's results, a setting of several ablations those of the first.
    """
    ablation, variants = ablation or ABLATIONS[name], []
    for method in methods or ablation.methods:
        usual = replace(base, method=method)
        for setting in ablation.settings:
            options = replace(usual, **setting.options)
            same = options == usual and setting.change == UNCHANGED
            folder = method if same else f"{method}+{_setting_folder(name, setting, usual)}"
            baseline = (REFERENCE_METHOD, setting.label) if ablation.usual is None else (method, ablation.usual)
            against = ", ".join(baseline)
            label, contact = f"{method}, {setting.label}", setting.contact or contacts[0]
            variants.append(Variant(label, folder, options, setting.change, contact, against, method, setting.label))
    own = any(setting.contact for setting in ablation.settings)
    return variants if own else by_contact(variants, contacts)


def by_contact(variants: Sequence[Variant], contacts: Sequence[ContactDefinition]) -> list[Variant]:
    """Return the variants by each definition of contact; several definitions are named in the labels."""
    if len(contacts) == 1:
        return [replace(variant, contact=contacts[0]) for variant in variants]
    return [
        replace(
            variant,
            contact=contact,
            label=f"{variant.label}, {contact.distance}",
            against=f"{variant.against}, {contact.distance}",
            group=f"{variant.group}, {contact.distance}",
        )
        for variant in variants
        for contact in contacts
    ]


VIEW_INPUTS = (INPUT_ERROR_SETTINGS[0], _estimated_hands_setting("estimated"), DEGRADED_INPUT_SETTINGS[0])
"""Errors of the input with which numbers of views are compared."""


def view_ablation(counts: Sequence[int]) -> Ablation:
    """Make an ablation with a setting for each number of views and each of ``VIEW_INPUTS``; the first is the baseline.

    Raises ``UsageError`` for numbers that are not from 1 to ``MAX_ADDED_VIEWS``, each once.
    """
    if len({*counts}) < len(counts) or not all(1 <= count <= MAX_ADDED_VIEWS for count in counts):
        raise UsageError(f"--views must be different numbers from 1 to {MAX_ADDED_VIEWS} (got {[*counts]})")
    settings = tuple(
        Setting(f"{one.label}, {count}", change=one.change if count == 1 else AddedViews(count, one.change))
        for one in VIEW_INPUTS
        for count in counts
    )
    return Ablation("Number of views, rendered from the ground truth", settings[0].label, settings, ("soft-hinge",))


def hand_source_ablation(sources: Sequence[HandSource]) -> Ablation:
    """Make an ablation with a setting for each hand source; the first is the baseline.

    Raises ``UsageError`` for two sources of the same name.
    """
    names = [source.name for source in sources]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise UsageError(f"--hands must be different names (got {twice} twice)")
    settings = tuple(Setting(source.name, change=WithHands(source, tuple(sources))) for source in sources)
    return Ablation("Hands, on the frames that all of them have", names[0], settings)


def _setting_folder(name: str, setting: Setting, usual: Options) -> str:
    """Name the folder of a setting after the first ablation with the same options and change."""

    def changed(one: Setting) -> tuple[dict[str, object], Change]:
        return {name: value for name, value in one.options.items() if value != getattr(usual, name)}, one.change

    every = [(other, one) for other, ablation in ABLATIONS.items() for one in ablation.settings]
    alike = [(other, one) for other, one in every if changed(one) == changed(setting)]
    first, one = (alike or [(name, setting)])[0]
    slug = re.sub(r"[^a-z0-9.]+", "-", one.label.lower().replace("°", " deg")).strip("-")
    return f"{first}-{slug}"
