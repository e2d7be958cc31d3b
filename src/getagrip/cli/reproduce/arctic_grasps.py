"""``getagrip reproduce arctic-grasps``: Tables 2 and 8 of the paper, and its study."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from getagrip.cli.reproduce.reproduction import MANO_DOWNLOAD, OWN_METHODS, Reproduce, RequiredFile, find_required

ARCTIC_REQUIREMENTS = {
    "root": RequiredFile(
        "ARCTIC, the folder of raw_seqs and meta", (".", "arctic", "arctic/data", "arctic_data/data", "data"),
        "https://arctic.is.tue.mpg.de, after registration", ("raw_seqs/*/*.object.npy",),
    ),
    "mano": MANO_DOWNLOAD,
}  # fmt: skip
ARCTIC_COLUMNS = {"IOU": "IOU", "SCA-IOU": "SCA-IOU 0.8", "ADD": "ADD", "SCA-ADD": "SCA-ADD"}
ARCTIC_PAPER_METHODS = {
    "Single Frame": "paper-single-frame", "HOMan": "paper-homan", "Static": "paper-static", "Dynamic": "paper-dynamic",
    "1-DoF": "paper",
}  # fmt: skip
"""The paper's groups with their methods, which use its energy and optimiser."""
ARCTIC_BASELINES = {"Single Frame, ours": "single-frame", "HOMan, ours": "homan"}
"""The paper's baselines with our energy and solver."""


@dataclass(frozen=True, kw_only=True)
class ReproduceArctic(Reproduce):
    """The paper's tables of ARCTIC-Grasps: methods, statistics, and the study of rotation within grasps."""

    def run(self) -> int:
        """Import, learn initial poses, compare, study, and write the tables; 1 if a step failed, else 0.

        Raises ``UsageError`` with a list of missing files before the first step.
        """
        from getagrip.bench.options import ComparisonOptions
        from getagrip.cli.datasets import Import
        from getagrip.cli.learn_poses import LearnPoses
        from getagrip.cli.reproduce import paper_tables as paper
        from getagrip.cli.study import Stats, Study
        from getagrip.fitting.options import PriorsFile, SearchOptions
        from getagrip.readers.datasets.arctic import Arctic

        needs, clips, whole = find_required(ARCTIC_REQUIREMENTS, self.roots), self.out / "clips", self.out / "whole"
        cut = Arctic(root=needs["root"], mano=needs["mano"])
        good = self.step("import arctic", Import[Arctic](dataset=cut, out=clips, share=self.share, debug=self.debug))
        uncut = replace(cut, whole=True)
        good &= self.step("import arctic --whole", Import[Arctic](dataset=uncut, out=whole, share=self.share))
        starts, priors = self.out / "starts.npz", self.out / "starts"
        if not priors.exists():
            learn = LearnPoses(clips=(clips,), out=starts, as_folder=priors, way="axis-angle", debug=self.debug)
            good &= self.step("init learn", learn)
        search = SearchOptions(init="priors", priors=PriorsFile(priors), priors_only=True, hands="as-given")
        groups = ARCTIC_PAPER_METHODS | ARCTIC_BASELINES | OWN_METHODS
        compared = ComparisonOptions(methods=(*groups.values(),), contact=(0.0,))
        good &= self.bench("methods", search, compared)
        statistics, studied = self.out / "statistics.json", self.out / "study.json"
        good &= self.step("stats", Stats(source=str(clips), json=statistics))
        study = Study(
            clips=(whole,), grasps=cut.grasps, out=self.out / "study", json=studied, workers=self.share.workers
        )
        if not studied.exists():
            good &= self.step("study", study)
        page = self.page("methods")
        methods = {group: paper.bench_values(page, method, ARCTIC_COLUMNS) for group, method in groups.items()}
        tables = [
            paper.PaperTable("Table 2", methods, paper.describe_clip_count(page)),
            paper.PaperTable("Table 8", paper.read_durations(statistics)),
            paper.PaperTable("Sec. 3", {"grasps": {paper.ALL_ROW_LABEL: self._errors()}}),
        ]
        about = [
            "the paper's settings: true hands, contact at 0 mm, all initial poses learnt from the same grasps",
            f"grasps as the authors' published code finds them: {cut.grasps.definition().description}",
            "the paper's groups have its energy, optimiser and choice; the others are ours, with the same input",
            "in brackets the paper's printed numbers; bold and underlined: the best and the second of ours",
        ]
        return self.write(tables, good, about)

    def _errors(self) -> dict[str, float]:
        """Return the study's mean rotation errors within all grasps [deg]."""
        from getagrip.io import files

        path = self.out / "study.json"
        rows = [row for row in files.read_json(path)["summary"] if row["where"] == "inside"] if path.exists() else []
        last = rows[-1]["object"] if rows else ""  # the row of all objects, or of the only one
        means = {row["measure"]: row["mean"] for row in rows if row["object"] == last}
        keys = {"static": "static_rotation", "1-DoF": "one_dof_rotation"}
        return {name: math.degrees(means[key]) for name, key in keys.items() if means.get(key) is not None}
