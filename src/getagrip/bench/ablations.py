"""The ablations: settings that are compared with each other, as data.

The comparison that a benchmark of grasps makes: options of ``getagrip bench``, light to load.

One step of an ablation, an ablation, and what is compared where nothing is named.

The variants that run on every clip, each method in each setting, with their options and folders.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Literal

from tyro.conf import arg

from getagrip.batch.scheduling import KeepOptions
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
from getagrip.errors import unknown_choice_error
from getagrip.fitting.methods import METHODS
from getagrip.fitting.options import Departures, Options
from getagrip.io.options import Flag
from getagrip.metrics.contact import CONTACT_DEFINITIONS, ContactDefinition
from getagrip.metrics.evaluate.external import ExternalSystem
from getagrip.synthetic.noise import NOISE_PRESETS, Noise


def _methods_help(_: str) -> str:
    """List the methods that there are when help is shown."""
    return f"(of {', '.join(METHODS)}; default: all of getagrip's but paper...)"


def _ablations_help(_: str) -> str:
    """Return the names that an option takes, loaded only to show its help."""

    return f"(one of {', '.join(ABLATIONS)}; default: none)"


@dataclass(frozen=True)
class ComparisonOptions:
    """Methods, or settings of methods, hands or other systems. Raises ``UsageError``."""

    methods: Annotated[tuple[str, ...], arg(metavar="METHOD...", help_behavior_hint=_methods_help)] = ()
    """Methods to compare. By default, ablations compare one-dof and soft-hinge, and the ablation departures compares
    the paper's. Methods of other packages, and the paper's, which are slow, run only if they are named."""
    ablation: Annotated[str | None, arg(metavar="NAME", help_behavior_hint=_ablations_help)] = None
    """Compare settings of each method, instead of the methods as they are."""
    hands: Annotated[tuple[str, ...], arg(metavar="NAME=DIR...", help_behavior_hint="")] = ()
    """Compare hands of several estimators for the same clips, on the frames that all have: DIR holds clips of the same
    names, or a hand file <clip>.npz for each (import hands --out)."""
    others: Annotated[tuple[str, ...], arg(name="with", metavar="NAME=DIR...", help_behavior_hint="")] = ()
    """Add rows with other systems' results: DIR holds the poses of each clip under its name, as for evaluate --poses,
    or result folders."""
    contact: Annotated[
        tuple[float, ...],
        arg(metavar="MM...", help_behavior_hint="(default: 10; for clips that import made, the value that cut them)"),
    ] = ()
    """In SCA, SCA-ADD and SCA-IOU, points of the object within MM of the hand's surface are in contact; with several
    values, rows for each. The paper uses 0 on ARCTIC."""

    replay: Flag = False
    """Also simulate each result (getagrip replay): in what share of the frames the object stays in the hand."""
    columns: Annotated[
        tuple[Literal["paper", "motion", "recall"], ...],
        arg(help_behavior_hint="(default: paper; of ho3d-eval: recall)"),
    ] = ()
    """Columns of the tables. paper: its own; motion: ARCTIC's metrics; recall: areas under curves of ADD and ADD-S, and
    BOP's average recall."""
    refine: Flag = False
    """Add a row for each system of --with: our joint fit that starts from its poses, as of refine."""
    keep: Annotated[KeepOptions, arg(name="")] = field(default_factory=KeepOptions)

    def __post_init__(self) -> None:
        for name in self.methods:
            if name not in METHODS:
                raise unknown_choice_error("--methods", name, METHODS)


REFERENCE_METHOD = "one-dof"
"""Ours after the paper, the plain hinge: what the others are compared with."""
DEFAULT_METHODS = tuple(name for name, method in METHODS.own.items() if not method.slow)
"""Methods that are compared where none is named; those of other packages only where they are."""
DEFAULT_CONTACT_DEFINITIONS = (ContactDefinition("object", 0.010),)
"""Definitions of contact (docs/metrics.md) in the tables, unless a run or a setting says otherwise."""


@dataclass(frozen=True)
class Setting:
    """One step of an ablation."""

    label: str
    options: Mapping[str, Any] = field(default_factory=dict)
    """``Options`` that differ from those of the run."""
    change: Change = UNCHANGED
    contact: ContactDefinition | None = None
    """Definition of contact in the metrics; None: the run's."""


@dataclass(frozen=True)
class Ablation:
    """Settings that are compared with each other, for each of a few methods."""

    title: str
    usual: str | None
    """Label of the setting that the others are compared with; None: methods are compared in each setting."""
    settings: tuple[Setting, ...]
    methods: tuple[str, ...] = (REFERENCE_METHOD, "soft-hinge")
    """Unless others are named."""


def _hand_noise(mm: float) -> Setting:
    """Make a setting with a bias, and jitter of half its size correlated over a tenth of a second.

    Both turn the hand by 0.8 degrees per millimetre.
    """
    deg = 0.8 * mm
    noise = Noise(
        hand_bias_mm=mm, hand_bias_deg=deg, hand_jitter_mm=mm / 2, hand_jitter_deg=deg / 2, jitter_memory_s=0.1
    )
    return Setting(f"{mm:g} mm, {deg:g}°", change=Noisy(noise))


def _noise_level(name: str) -> Setting:
    """Make a setting with the hands of a level of noise; the masks stay as they are."""
    return Setting(name, change=Noisy(replace(NOISE_PRESETS[name], mask_ragged_px=0.0)))


def _estimated_hands_setting(label: str, *evidence: Change, level: str = "estimated") -> Setting:
    """Name a change to estimated hands, at a level of noise where they are true; evidence is of true ones."""
    return Setting(
        label, change=Several((*evidence, EstimatedHands(replace(NOISE_PRESETS[level], mask_ragged_px=0.0))))
    )


def _mask_noise(px: float) -> Setting:
    return Setting(f"{px:g} px", change=Noisy(Noise(mask_ragged_px=px)))


def _inaccurate_masks(px: float) -> Setting:
    return replace(_mask_noise(px), label=f"masks off by {px:g} px")


MASK_FAULT_FRACTIONS = (("another object", 0.2), ("another object", 0.4), ("half", 0.2), ("runs over", 0.2))
"""Faults of masks, and the share of the frames that have them."""


def _mask_fault(fault: str, share: float) -> Setting:
    return Setting(f"{fault} in {100 * share:.0f} %", change=WrongMasks(fault, share))


CATEGORY_MESHES = {
    "category mesh": OtherObject(),
    "category mesh, size unknown": Several((OtherObject(), ScaleFree())),
    "category mesh, size unknown, hands moderate": Several(
        (OtherObject(), ScaleFree(), Noisy(replace(NOISE_PRESETS["moderate"], mask_ragged_px=0.0)))
    ),
}
"""Knowledge of an object without its own mesh; the last is the paper's own setting, footage without CADs."""


DEGRADED_INPUT_SETTINGS = _inaccurate_masks(4.0), Setting("size unknown", change=ScaleFree())
"""Inputs that depth improves though hands are exact."""
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
"""The errors that are summed up in README; the first four are run on the test objects, too."""


DEPARTURE_STEPS = {
    "+ energy scale": "scale",
    "+ optimiser": "optimiser",
    "+ search": "search",
    "+ axis start": "axis",
    "+ choice": "choice",
    "+ push": "push",
    "+ pull": "pull",
}
"""Departures from the paper's method, in the order in which they are added up: the scale; how the minimum is found; the
form of the terms. Before them stands the method in millimetres, a thousand times as much push and pull: one reading of
the printed units.
"""


def _departures(count: int) -> Departures:
    """Return the first ``count`` steps."""
    return Departures(**dict.fromkeys(list(DEPARTURE_STEPS.values())[:count], True))


SIMULATED_LANDMARKS, COMMON_DEPTH_SOURCES = SimulatedJoints("landmarks"), ("mono", "realsense")
"""Evidence that users often have: 2D joints of landmarks; depth of a network, or of a sensor."""
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
        (
            Setting("known", change=ScaleKnown()),
            Setting("free", change=ScaleFree()),
        ),
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
    "departures": Ablation(
        "From the paper's method to ours: one departure more in each row",
        "as it is",
        (
            Setting("one reading of the printed units", {"push": 100.0, "pull": 100.0}),
            Setting("as it is"),
            *(
                Setting(label, {"departures": _departures(count)})
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
    """One row of a table: what is done with every clip, and where the results go."""

    label: str
    folder: str
    """Variants with the same folder share their results."""
    options: Options
    change: Change
    contact: ContactDefinition
    against: str
    """Label of the variant that this one is compared with."""
    group: str
    """Name of the line in a plot: the method."""
    step: str
    """The place on the plot's axis."""
    system: ExternalSystem | None = None
    """Whose results these are, where they are not ours."""

    @property
    def method(self) -> str:
        """The method's name, or the other system's."""
        return self.options.method if self.system is None else self.system.name


def method_variants(
    methods: Sequence[str], base: Options, contacts: Sequence[ContactDefinition] = DEFAULT_CONTACT_DEFINITIONS
) -> list[Variant]:
    """Make a variant of each method, by each definition of contact; all but the slow ones where none is named."""
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
    """Make a variant of each method in each setting of an ablation, by default that of the name in ``ABLATIONS``.

    They are measured by each definition of contact, unless the ablation is about these. A setting that changes nothing
    shares the method's own results, one that another ablation has too shares that one's.
    """
    ablation, variants = ablation or ABLATIONS[name], []
    for method in methods or ablation.methods:
        usual = replace(base, method=method)
        for setting in ablation.settings:
            options = replace(usual, **setting.options)
            same = options == usual and setting.change == UNCHANGED
            folder = method if same else f"{method}+{_setting_folder(name, setting, usual)}"
            against = (
                f"{REFERENCE_METHOD}, {setting.label}" if ablation.usual is None else f"{method}, {ablation.usual}"
            )
            label, contact = f"{method}, {setting.label}", setting.contact or contacts[0]
            variants.append(Variant(label, folder, options, setting.change, contact, against, method, setting.label))
    own = any(setting.contact for setting in ablation.settings)
    return variants if own else by_contact(variants, contacts)


def by_contact(variants: Sequence[Variant], contacts: Sequence[ContactDefinition]) -> list[Variant]:
    """Return the variants by each definition of contact, which their labels name where there are several."""
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


def _setting_folder(name: str, setting: Setting, usual: Options) -> str:
    """Name the folder of a setting after the first ablation that has one with the same options and change."""

    def changed(one: Setting) -> tuple[dict[str, object], Change]:
        return {name: value for name, value in one.options.items() if value != getattr(usual, name)}, one.change

    every = [(other, one) for other, ablation in ABLATIONS.items() for one in ablation.settings]
    alike = [(other, one) for other, one in every if changed(one) == changed(setting)]
    first, one = (alike or [(name, setting)])[0]
    return f"{first}-{_slug(one.label)}"


def _slug(label: str) -> str:
    """Turn a label into a part of a folder's name."""
    return re.sub(r"[^a-z0-9.]+", "-", label.lower().replace("°", " deg")).strip("-")
