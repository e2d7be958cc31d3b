"""The page of the site that explores all tables: ``{{ explorer }}`` in docs/explore.md.

Tables are embedded as JSON, so that the page works from disk; it shares the elements of the pages of results.
"""

from __future__ import annotations

import json
from pathlib import Path

from benchmarks import store

PARTS = store.ROOT / "src/getagrip/pages/parts"
SCRIPTS = (PARTS / "page.js", PARTS / "plots.js", Path(__file__).with_suffix(".js"))
CONTROLS = """
<div id="explorer">
<p id="controls">
<label>table <select id="table"></select></label>
<label>find <input id="words" type="search" placeholder="words of a row"></label>
<label>plot <select id="drawn"></select></label>
<label><input id="differences" type="checkbox"> differences in pairs</label>
</p>
<div id="about"></div>
<div id="plot"></div>
<div id="rows"></div>
</div>
"""


def explorer() -> str:
    """The page's part of HTML."""
    tables = {name: json.loads((store.RESULTS / f"{name}.json").read_text(encoding="utf-8")) for name in store.names()}
    data = json.dumps(tables, ensure_ascii=False, separators=(",", ":")).replace("</", "<\\/")
    code = "\n".join(path.read_text(encoding="utf-8") for path in SCRIPTS)
    parts = (CONTROLS, f'<script type="application/json" id="data">{data}</script>', f"<script>{code}</script>")
    return "\n".join(("`````{raw} html", *parts, "`````"))
