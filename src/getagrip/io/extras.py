"""Libraries that not everybody has: each belongs to an extra of the package."""

from __future__ import annotations

import importlib
import json
import re
from importlib import metadata
from pathlib import Path
from types import ModuleType
from urllib.parse import urlsplit
from urllib.request import url2pathname

from getagrip.errors import UsageError


def import_extra(module: str, extra: str, option: str = "") -> ModuleType:
    """Import a module of an extra of this package.

    Raises ``UsageError`` that says how to install it.

    ``option`` is what asks for it; empty: ``--to`` and the extra's name.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise UsageError(
            f"missing module {module!r} ({error}): {option or f'--to {extra}'} needs it; {install_command(extra)}"
        ) from error


def install_command(extra: str) -> str:
    """Write the command that installs an extra, as this package was installed: from a clone, a wheel or otherwise.

    Where that is not known or gone, it names the libraries themselves: never our name, which an index may not have or
    may have from somebody else.
    """
    source = _install_source()
    if source:
        option, path = source
        return f'pip install {option}"{path}[{extra}]"'
    libraries = " ".join(f'"{each}"' for each in libraries_of(extra))
    return f"pip install {libraries}" if libraries else f"install the libraries of the extra {extra!r}"


def libraries_of(extra: str) -> list[str]:
    """List the requirements of an extra, as pip takes them; those of the extras that it brings, for ``all``."""
    mark = re.compile(rf"""extra == ['"]{re.escape(extra)}['"]""")
    found: list[str] = []
    for requirement in metadata.requires("getagrip") or ():
        library, _, condition = requirement.partition(";")
        if not mark.search(condition):
            continue
        others = re.match(r"getagrip\[(.*)\]", library)
        found += [each for name in others[1].split(",") for each in libraries_of(name)] if others else [library.strip()]
    return found


def _install_source() -> tuple[str, str] | None:
    """Return pip's option and the folder or wheel that this package was installed from, where it is there (PEP 610)."""
    try:
        record = json.loads(metadata.distribution("getagrip").read_text("direct_url.json") or "null")
    except (metadata.PackageNotFoundError, ValueError):
        return None
    if not isinstance(record, dict) or not str(record.get("url", "")).startswith("file:"):
        return None
    path = Path(url2pathname(urlsplit(record["url"]).path))
    if not path.exists():
        return None
    editable = bool(record.get("dir_info", {}).get("editable"))
    return ("-e " if editable else ""), str(path)
