"""``getagrip reproduce epic-grasps``: Tables 3 to 6, 7 and 9 of the paper."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from getagrip.cli.reproduce.reproduction import (
    AUTHORS_CODE_URL,
    MANO_DOWNLOAD,
    OWN_METHODS,
    Reproduce,
    RequiredFile,
    find_required,
)
from getagrip.io.terminal import print_note

if TYPE_CHECKING:
    from getagrip.batch.job import Outcome
    from getagrip.cli.reproduce.paper_tables import PaperTable

VISOR_FOCAL_PX = 5000.0 / 256.0 * 854.0
"""HaMeR's focal length, as in the paper, for VISOR's masks, 854 px wide [px]."""
EPIC_REQUIREMENTS = {
    "csv": RequiredFile(
        "EPIC-Grasps' table", ("epicgrasps_2431.csv", "code_epichor/image_sets/epicgrasps_2431.csv"), AUTHORS_CODE_URL
    ),
    "visor": RequiredFile(
        "VISOR's annotations, sparse and dense, with frame_mapping.json",
        ("visor", "VISOR", "2v6cgv1x04ol22qp9rm9x2j6a7"), "https://doi.org/10.5523/bris.2v6cgv1x04ol22qp9rm9x2j6a7",
        ("*.json", "*.zip", "*/*.json", "*/*.zip", "*/*/*.zip", "*/*/*/*.json"),
    ),
    "frames": RequiredFile(
        "EPIC-KITCHENS' images", ("EPIC-KITCHENS", "images", "frames"),
        "https://github.com/epic-kitchens/epic-kitchens-download-scripts", ("P*/rgb_frames", "P*_*"),
    ),
    "cad": RequiredFile(
        "the categories' CAD models", ("cad", "weights/obj_models/epichor_export_getagrip"), AUTHORS_CODE_URL,
        ("*.obj",),
    ),
    "priors": RequiredFile(
        "the authors' initial poses", ("pose_priors", "weights/pose_priors/epic"), AUTHORS_CODE_URL,
        ("*/left_*.npy", "*/right_*.npy"),
    ),
    "mano": MANO_DOWNLOAD,
}  # fmt: skip
EPIC_HAND_SOURCES = {
    name: RequiredFile(
        f"{label}'s hands, a folder for each clip, run on its frames", (name,), f"docs/estimators.md; {source}", ("*",)
    )
    for name, label, source in (
        ("hamer", "HaMeR", "https://github.com/geopavlakos/hamer"),
        ("frankmocap", "FrankMocap", "https://github.com/facebookresearch/frankmocap"),
    )
}
EPIC_COLUMNS = {"IOU": "IOU", "SCA@0.8": "SCA-IOU 0.8", "SCA@0.6": "SCA-IOU 0.6"}
EPIC_PAPER_METHODS = {"HOMan": "paper-homan", "Dynamic": "paper-dynamic", "1-DoF": "paper"}
"""The paper's groups with their methods, which use its energy and optimiser."""
EPIC_BASELINES = {"HOMan, ours": "homan"}
"""The paper's baseline with our energy and solver."""


@dataclass(frozen=True, kw_only=True)
class ReproduceEpic(Reproduce):
    """The paper's tables of EPIC-Grasps; while HaMeR's hands are missing, only the clips that it runs on.

    Without FrankMocap's hands, Tables 4 and 9 are left out.
    """

    def run(self) -> int:
        """Import, add hands, compare, and write the tables; 1 if a step failed or hands are still missing, else 0.

        Raises ``UsageError`` with a list of missing files before the first step.
        """
        from getagrip.bench.options import ComparisonOptions
        from getagrip.cli.datasets import Import, ImportEpic
        from getagrip.cli.import_hands import ImportHands, Trackers
        from getagrip.cli.study import Stats
        from getagrip.fitting.options import PriorsFile, SearchOptions

        needs = find_required(EPIC_REQUIREMENTS, self.roots, EPIC_HAND_SOURCES.values())
        clips, statistics, mano = self.out / "clips", self.out / "statistics", needs["mano"]
        epic = ImportEpic(
            csv=needs["csv"], visor=needs["visor"], frames=needs["frames"], cad=needs["cad"], focal=VISOR_FOCAL_PX,
            priors=needs["priors"],
        )  # fmt: skip
        good = self.step("import epic", Import[ImportEpic](dataset=epic, out=clips, share=self.share, debug=self.debug))
        hamer, frankmocap = (EPIC_HAND_SOURCES[name].find(self.roots) for name in ("hamer", "frankmocap"))
        if hamer is None:
            print_note(f"missing: {EPIC_HAND_SOURCES['hamer'].advice}")
            print_note(f"next: run an estimator on {clips}/*/frames, and call this again")
            return 1
        hands = ImportHands(
            paths=(hamer,), source="hamer", trackers=Trackers(), clips=clips, mano=mano, debug=self.debug
        )
        good &= self.step("import hands: HaMeR's", hands)
        search = SearchOptions(init="priors", priors=PriorsFile(needs["priors"]), priors_only=True, hands="as-given")
        runs = {
            "methods": ComparisonOptions(methods=(*(EPIC_PAPER_METHODS | EPIC_BASELINES | OWN_METHODS).values(),)),
            "physical": ComparisonOptions(ablation="physical", methods=("paper", "soft-hinge")),
            "occlusion": ComparisonOptions(ablation="occlusion", methods=("paper", "soft-hinge")),
        }
        if frankmocap is None:
            print_note(f"left out: Table 4 and 9. Missing: {EPIC_HAND_SOURCES['frankmocap'].advice}")
        else:
            files = self.out / "frankmocap"
            good &= not self._hand_files(frankmocap, files, mano)
            sources = (f"frankmocap={files}", f"hamer={clips}")
            runs["hands"] = ComparisonOptions(hands=sources, methods=("paper", "paper-homan", *OWN_METHODS.values()))
        for name, compared in runs.items():
            good &= self.bench(name, search, compared)
        table = Stats(source="epic-grasps", csv=needs["csv"], out=statistics, json=statistics / "stats.json")
        good &= self.step("stats", table)
        about = [
            f"the paper's settings: focal length {VISOR_FOCAL_PX:.0f} px (HaMeR's), initial poses only the authors'",
            "the paper's groups have its energy, optimiser and choice; the others are ours, with the same input",
            "in brackets the paper's printed numbers; bold and underlined: the best and the second of ours",
        ]
        return self.write(self._tables(frankmocap is not None), good, about)

    def _hand_files(self, source: Path, out: Path, mano: Path) -> list[Outcome]:
        """Write FrankMocap's hands of every clip as ``out/<clip>.npz``; print and return the failures."""
        from getagrip.batch.clips import print_outcome
        from getagrip.batch.job import failed_outcome
        from getagrip.cli.import_hands import ImportHands, NewFrames, Trackers
        from getagrip.clip.read import read_header
        from getagrip.geometry.lens import Lens

        failed = []
        out.mkdir(parents=True, exist_ok=True)
        for path in sorted((self.out / "clips").glob("*/clip.json")):
            name = path.parent.name
            if (out / f"{name}.npz").exists():
                continue
            try:
                header = read_header(path.parent)
                first, last, K = int(header.frames[0]), int(header.frames[-1]), header.K[0]
                lens = Lens(K=(K[0, 0], K[1, 1], K[0, 2], K[1, 2]))
                new = NewFrames(side=header.fields["side"], frames=(first, last), size=header.size, lens=lens)
                ImportHands(
                    paths=(source / name,), source="frankmocap", trackers=Trackers(), new=new, mano=mano,
                    out=out / f"{name}.npz",
                ).run()  # fmt: skip
            except Exception as error:  # an error in one clip must not end the others
                failed.append(failed_outcome(name, error))
                print_outcome(failed[-1], self.debug)
        return failed

    def _tables(self, frankmocap: bool) -> list[PaperTable]:
        """Make the paper's tables from the benchmarks' numbers."""
        from getagrip.cli.reproduce.paper_tables import PaperTable, bench_values, describe_clip_count, read_durations

        def table(number: str, name: str, groups: dict[str, str], also: str = "") -> PaperTable:
            values = {group: bench_values(self.page(name), label, EPIC_COLUMNS) for group, label in groups.items()}
            return PaperTable(number, values, describe_clip_count(self.page(name)) + also)

        def settings(number: str, name: str, labels: dict[str, str]) -> PaperTable:
            groups = {"1-DoF": "paper", "soft hinge": "soft-hinge"}
            values = {
                group: {
                    row: bench_values(self.page(name), f"{method}, {label}", EPIC_COLUMNS).get("All", {})
                    for row, label in labels.items()
                }
                for group, method in groups.items()
            }
            return PaperTable(number, values, describe_clip_count(self.page(name)))

        tables = [
            table("Table 3", "methods", EPIC_PAPER_METHODS | EPIC_BASELINES | OWN_METHODS),
            settings("Table 5", "physical", {weight: weight for weight in ("0", "0.1", "1")}),
            settings("Table 6", "occlusion", {word: word for word in ("off", "on")}),
            PaperTable("Table 7", read_durations(self.out / "statistics" / "stats.json")),
        ]
        if frankmocap:
            both = {
                "HOMan + FrankMocap": "paper-homan, frankmocap", "1-DoF + FrankMocap": "paper, frankmocap",
                "1-DoF + HaMeR": "paper, hamer", "soft hinge + FrankMocap": "soft-hinge, frankmocap",
                "soft hinge + HaMeR": "soft-hinge, hamer",
            }  # fmt: skip
            tables.insert(1, settings("Table 4", "hands", {"FrankMocap": "frankmocap", "HaMeR": "hamer"}))
            tables.append(table("Table 9", "hands", both, " Only frames that have both hands."))
        return tables
