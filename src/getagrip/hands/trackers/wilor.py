"""WiLoR: records like HaMeR's, from its demo or from WiLoR-mini (``wilor_preds``)."""

from __future__ import annotations

from dataclasses import dataclass

from getagrip.hands.trackers.hamer import HaMeR


@dataclass(frozen=True)
class WiLoR(HaMeR):
    """WiLoR's records."""

    name = "WiLoR"
    takes = "a record for each image, of its demo or of WiLoR-mini"
