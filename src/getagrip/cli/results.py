"""Commands from clips to results, and those that evaluate and show results."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import arg

from getagrip.cli.command import (
    Clips,
    ClipsFolder,
    Command,
    Inits,
    Method,
    Results,
    Seed,
    Sources,
    hands_of,
    masks_of,
    mesh_of,
    priors_of,
)  # fmt: skip
from getagrip.cli.sharing import Sharing
from getagrip.errors import UsageError
from getagrip.fitting.options import Init, Options
from getagrip.io.arguments import File, Flag, Folder, OptionalFile, OptionalFolder, one_of, placed
from getagrip.io.storage import Place, on_disk


@dataclass(frozen=True, kw_only=True)
class Demo(Command):
    """Make a clip, reconstruct it, evaluate it, and draw a report."""

    out: Folder = Path("out/demo")
    """Where the clip, the result, report.png and report.html go."""

    def run(self) -> int:
        from getagrip.commands import demo

        demo.run(self.out)
        return 0


@dataclass(frozen=True, kw_only=True)
class Reconstruct(Command):
    """Find the pose of the object in the hand, in the frames of each clip."""

    clips: Sources = ()
    """Clip folders, folders of clips, or patterns in quotes; also in object stores: s3://BUCKET/FOLDER, gs://..."""
    out: Annotated[Place, placed("DIR"), arg(metavar="DIR")]
    """Where the results go: a folder for each clip, of the clip's name. Good ones that are there already are kept.
    Several calls may share it at the same time. It may be in an object store, too."""
    method: Method = "soft-hinge"
    """How the object may move in the hand. soft-hinge: about one axis, with small deviations; one-dof: about one axis
    exactly; static: not at all; dynamic: freely in each frame. paper is the paper's method to the letter, slow;
    paper-static and paper-dynamic likewise. The others are baselines."""
    inits: Inits = 50
    """Number of initial poses, twice as many where the scale is free: more is slower and safer."""
    init: Init = "uniform"
    """Rotations spread evenly (uniform); or first those that init learn has found (clusters) or that a folder holds by
    category and side, as the authors of the paper keep theirs (priors), and even ones for the rest."""
    priors: OptionalFile = None
    """For clusters, the file that init learn has written; for priors, the folder."""
    priors_only: Flag = False
    """Start from these poses alone, at most --inits, with no even rotations for the rest, as the paper does. A clip of
    an object that has none fails."""
    thorough: Flag = False
    """Search two to three times as long, for the methods that fit all frames at once."""
    axis: Literal["free", "hand"] = "free"
    """Where the latent axis of one-dof and soft-hinge may lie: anywhere (free), or through the origin of the hand frame
    (hand), as the paper's Eq. 3 has it."""
    given_hands: Flag = False
    """Keep the hands where they are given. Else they are turned and moved to where their own pixels (masks/hand, else
    masks/ignore) are, if they disagree, and put between their neighbours in frames in which they jump."""
    given_masks: Flag = False
    """Believe all masks. Else soft-hinge leaves out those that contradict the masks of other frames."""
    given_mesh: Flag = False
    """Take the mesh as it is. Else soft-hinge deforms it where it is only of the object's kind, as the masks show."""
    seed: Seed = 0
    """Seed of all that is random."""
    frames: Annotated[int, arg(metavar="N")] = 30
    """Fit N frames together, sampled evenly from the clip. More is slower, and safer where the motion is fast."""
    sampled_only: Flag = False
    """Leave it at these frames. Otherwise the others follow: each is fitted to its own mask, what all frames share held
    still, or interpolated where no mask shows the object."""
    threads: Annotated[int, arg(metavar="N")] = 1
    """Threads for each clip, for one that is waited for; many clips are done sooner by --workers. Results are the same
    to the last bit."""
    find_grasps: Flag = False
    """Clips are not cut: find first, as segment --from-masks does, when the object lies still and when it is held;
    then reconstruct the whole interaction as a timeline. Clips with their segments go to DIR/clips."""
    cut_grasps: Flag = False
    """Find segments likewise, but reconstruct each stable grasp by itself, as if it had been cut by hand. The grasps'
    own clips go to DIR/clips, results to DIR/<clip>--1, --2 and so on."""
    overwrite: Flag = False
    """Make results again that are there already, of the same clip, options and code."""
    strict: Flag = False
    """Exit with 1 also where a check finds something serious (the result is probably worthless), or a result is less
    probable than --min-probability."""
    min_probability: Annotated[float, arg(metavar="P")] = 0.5
    """With --strict, the least probability that poses are right in the hand, 0 to 1. Results without a probability
    pass, if no finding is serious."""
    sharing: Annotated[Sharing, arg(name="")] = field(default_factory=Sharing)

    def run(self) -> int:
        from getagrip.batch.clips import Batch, reconstruct_clips

        options = Options(
            method=self.method, inits=self.inits, seed=self.seed, frames=self.frames, thorough=self.thorough,
            init=self.init, priors=priors_of(self.priors, self.init, self.priors_only),
            hands=hands_of(self.given_hands), masks=masks_of(self.given_masks), mesh=mesh_of(self.given_mesh),
            axis=self.axis, every_frame=not self.sampled_only,
        )  # fmt: skip
        batch = Batch(self.sharing.share(), self.threads, self.overwrite, self.strict, self.min_probability)
        if self.find_grasps or self.cut_grasps:
            from getagrip.commands.reconstruct_found import reconstruct_found

            name = "--cut-grasps" if self.cut_grasps else "--find-grasps"
            clips, out = [on_disk(name, clip) for clip in self.clips], on_disk(name, self.out)
            return reconstruct_found(clips, out, options, batch, self.cut_grasps, self.debug)
        return reconstruct_clips(self.clips, self.out, options, batch, self.debug)


@dataclass(frozen=True, kw_only=True)
class Evaluate(Command):
    """Print the metrics of results, and of another system's poses or meshes beside them."""

    results: Results = ()
    """Result folders, or folders of results."""
    clips: ClipsFolder = None
    """A clip, or the folder that holds the clips by name."""
    poses: Annotated[Path | None, arg(metavar="PATH", help_behavior_hint="")] = None
    """Another system's poses of the clip's mesh: one 4x4 for each frame (.npz, .npy, .json, .txt, or a file for each
    frame in a folder), or BOP's results (.csv). Of many clips: a folder of such files or folders, named like the clips.
    They need --clips, and appear under the name of PATH."""
    meshes: OptionalFolder = None
    """Another system's meshes, one for each frame, in metres: DIR/<clip>/<frame>.obj (.ply, .stl, .glb). They need
    --clips and --mesh-frame, and appear under the name of DIR."""
    mesh_frame: Annotated[Literal["camera", "hand"] | None, one_of("camera", "hand"), arg(help_behavior_hint="")] = None
    """The frame of their vertices: the clip's camera frame, or its hand frame."""
    first: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: the frame's)")] = None
    """The number of the first frame's pose or mesh in these files. Needed where they are counted from another start."""
    contact: Flag = False
    """Print stable contact by nine definitions of contact, too: within 0, 5 and 10 mm, of the object's vertices, the
    hand's, and points of the object's surface."""
    json: OptionalFile = None
    """Write every number here, unrounded."""

    def run(self) -> int:
        from getagrip.commands.evaluate import evaluate_results
        from getagrip.commands.evaluate_meshes import Meshes
        from getagrip.commands.evaluate_poses import OtherPoses

        poses = None
        if self.poses is not None:
            if self.clips is None:
                raise UsageError("--poses: got no --clips, expected the clip, or the folder that holds the clips")
            poses = OtherPoses(self.poses, self.clips, self.first)
        meshes = None
        if self.meshes is not None:
            if self.clips is None or self.mesh_frame is None:
                raise UsageError("--meshes: got no --clips or no --mesh-frame, expected both")
            meshes = Meshes(self.meshes, self.mesh_frame, self.clips, self.first)
        elif self.mesh_frame is not None:
            raise UsageError(f"--mesh-frame: got {self.mesh_frame}, expected none without --meshes")
        return evaluate_results(self.results, self.clips, meshes, poses, self.contact, self.json, self.debug)


@dataclass(frozen=True, kw_only=True)
class InitCommand(Command):
    """Learn where a search may start, from clips with true poses: rotations of each kind of object in each hand."""

    clips: Clips = ()
    """Clip folders, or folders of clips."""
    out: File
    """Where the grasps go. A clip of a subject among them starts from what is learnt without that subject."""
    k: int = 50
    """Rotations of each kind of object in each hand."""
    leave_out: Annotated[tuple[str, ...], arg(metavar="SUBJECT...", help_behavior_hint="")] = ()
    """Whose hands not to learn from: those on whose clips the poses will be tried."""
    as_folder: OptionalFolder = None
    """Write the poses learnt from all of the grasps into this folder, too, as --init priors reads them: a clip starts
    from those of its own subject as well, as in the paper."""
    way: Annotated[Literal["geodesic", "axis-angle"], arg(name="clusters")] = "geodesic"
    """k-means by the angles between rotations; or, as in the paper, of rotation vectors."""
    seed: Seed = 0
    """Seed of all that is random."""

    def check(self) -> None:
        from getagrip.io import files

        files.check_file("--out", self.out)
        if self.as_folder is not None:
            files.check_folder("--as-folder", self.as_folder)

    def run(self) -> int:
        from getagrip.commands.learn_poses import learn
        from getagrip.fitting.learn_priors import LearntGrasps

        how = LearntGrasps((), self.k, self.way, self.seed)
        return learn(self.clips, self.out, self.as_folder, how, self.leave_out, self.debug)


@dataclass(frozen=True, kw_only=True)
class Export(Command):
    """Write results in other programs' formats: poses, animated scenes, benchmark files."""

    results: Results
    """Result folders, or folders of results."""
    to: Annotated[str, arg(metavar="FORMAT")]
    """csv: a table of poses; npz: arrays; obj: posed meshes, one per frame; glb: glTF, animated, for Blender and
    browsers; bop: files of the BOP benchmark; usd: a USD stage, animated; mujoco: an MJCF scene to
    replay and to simulate; lerobot: a dataset; spider: keypoint trajectories; dex-retargeting: joints and object
    poses, z up."""
    out: OptionalFolder = None
    """Where the exports go, each into a folder named as its result's. Otherwise RESULT/export-FORMAT."""
    clips: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="(default: where they were made from)")] = None
    """A clip, or the folder that holds the clips by name."""
    overwrite: Flag = False
    """Replace exports that are there already."""

    def check(self) -> None:
        from getagrip.export import FORMATS

        super().check()
        if self.to not in FORMATS:
            raise UsageError(f"--to: got {self.to!r}, expected one of {', '.join(FORMATS)}")
        if not self.results:
            raise UsageError("RESULT: name at least one result")

    def run(self) -> int:
        from getagrip.commands.export import export_results

        return export_results(self.results, self.to, self.out, self.clips, self.overwrite, self.debug)


@dataclass(frozen=True, kw_only=True)
class Doctor(Command):
    """Check the installation, and compile what the first run would have to."""

    mano: OptionalFolder = None
    """Folder of your MANO_RIGHT.pkl and MANO_LEFT.pkl, to be tried."""
    address: Annotated[str | None, arg(metavar="ADDR", help_behavior_hint="(default: RAY_ADDRESS)")] = None
    """Ray cluster to be tried."""

    def run(self) -> int:
        from getagrip.commands import doctor

        return doctor.run(self.mano, self.address)
