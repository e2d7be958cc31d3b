"""The ablations: settings that are compared with each other, as data."""

from __future__ import annotations

from dataclasses import replace

from getagrip.datasets.synthetic.noise import NOISE_PRESETS, Noise
from getagrip.experiments.changes import (
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
from getagrip.experiments.settings import DEFAULT_METHODS, Ablation, Setting
from getagrip.experiments.simulated_evidence import (
    DEPTH_ERROR_LEVELS,
    JOINT_ERROR_LEVELS,
    SimulatedDepth,
    SimulatedJoints,
)
from getagrip.experiments.wrong_inputs import INPUT_MISTAKES
from getagrip.fitting.options import Departures
from getagrip.metrics.contact import CONTACT_DEFINITIONS


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
