"""WiLoR: records like HaMeR's, from its demo or from WiLoR-mini (``wilor_preds``), and its demo's meshes."""

from __future__ import annotations

from dataclasses import dataclass

from getagrip.hands.trackers.hamer import Demo


@dataclass(frozen=True)
class WiLoR(Demo):
    """WiLoR's records."""

    name = "WiLoR"
    takes = "the demo's out_folder with --save_mesh, or a record for each image, of its demo or of WiLoR-mini"
