"""An HTML page in one file, with its styles, scripts and data: nothing is loaded, and nothing else may run.

Names of clips and whatever else results hold may come from untrusted files. They are in the page as JSON whose ``<``,
``>`` and ``&`` are escaped, and reach the screen as text only. The Content-Security-Policy names the hashes of our own
scripts and styles: the browser refuses any other, and every request.
"""

from __future__ import annotations

import base64
import hashlib
import html
import json
import zlib
from collections.abc import Mapping, Sequence
from importlib import resources

import numpy as np
from numpy import ndarray

from getagrip import __version__
from getagrip.io import files

ARRAY_TYPE_CODES = {"float32": "f", "uint16": "H", "uint32": "I", "uint8": "B"}
"""Types of the arrays in a page; ``parts/page.js`` reads these."""
ARRAY_ALIGNMENT_BYTES = 8
"""Alignment of arrays in bytes, as JavaScript requires."""
SCRIPT_ESCAPES = {ord(letter): f"\\u{ord(letter):04x}" for letter in "<>&\u2028\u2029"}


def build_document(
    title: str, body: str, scripts: Sequence[str], data: Mapping[str, object], asks: bool = False
) -> str:
    """Build the page: ``body`` and ``scripts`` are files of ``parts/``.

    If it ``asks``, it may load more from its server.
    """
    style = _read_page_part("page.css")
    codes = [_read_page_part(name) for name in scripts]
    asking = "; connect-src 'self'" if asks else ""
    policy = (
        f"default-src 'none'; script-src {' '.join(map(_csp_hash, codes))}; style-src {_csp_hash(style)}; img-src data:; "
        f"base-uri 'none'; form-action 'none'{asking}"
    )
    return "\n".join(
        [
            '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">',
            f'<meta http-equiv="Content-Security-Policy" content="{policy}">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f'<meta name="generator" content="getagrip {__version__}">',
            f"<title>{html.escape(title)}</title>",
            f'<link rel="icon" href="data:,">\n<style>{style}</style>\n</head>\n<body>',
            _read_page_part(body),
            f'<script type="application/json" id="data">{json_for_script(data)}</script>',
            *(f"<script>{code}</script>" for code in codes),
            "</body>\n</html>\n",
        ]
    )


def json_for_script(data: Mapping[str, object]) -> str:
    """Write JSON that can stand in a script element: it holds nothing that ends or begins an element."""
    compact = json.dumps(json.loads(files.to_json(data)), separators=(",", ":"), ensure_ascii=True)
    return compact.translate(SCRIPT_ESCAPES)


def pack_arrays(arrays: Mapping[str, ndarray]) -> tuple[dict[str, dict[str, object]], str]:
    """Pack arrays: where each is (type, shape, offset in bytes), and all of them, deflated, as base64."""
    where, parts, size = {}, [], 0
    for name, values in arrays.items():
        kind = values.dtype.name
        assert kind in ARRAY_TYPE_CODES, kind
        content = np.ascontiguousarray(values).astype(values.dtype.newbyteorder("<")).tobytes()
        content += bytes(-len(content) % ARRAY_ALIGNMENT_BYTES)
        where[name] = {"type": kind, "shape": values.shape, "offset": size}
        parts.append(content)
        size += len(content)
    return where, base64.b64encode(zlib.compress(b"".join(parts), 9)).decode("ascii")


def _read_page_part(name: str) -> str:
    return resources.files("getagrip.pages").joinpath("parts", name).read_text("utf-8")


def _csp_hash(code: str) -> str:
    """Return the policy's hash of a script or style."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(code.encode()).digest()).decode()}'"
