"""The variants that run on every clip, each method in each setting, with their options and folders."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

from getagrip.evaluation.other_poses import ExternalSystem
from getagrip.experiments.ablations import ABLATIONS
from getagrip.experiments.changes import UNCHANGED, Change
from getagrip.experiments.settings import (
    DEFAULT_CONTACT_DEFINITIONS,
    DEFAULT_METHODS,
    REFERENCE_METHOD,
    Ablation,
    Setting,
)
from getagrip.fitting.options import Options
from getagrip.metrics.contact import ContactDefinition


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
