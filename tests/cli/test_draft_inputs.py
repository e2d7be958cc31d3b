"""A draft takes hands and masks of a user's files, and of estimators, which are scripts in their own environments."""

from __future__ import annotations

import json
import shlex
import sys
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from getagrip.cli import calls
from getagrip.cli.annotate import DATABASE
from getagrip.cli.calls import run_call
from getagrip.cli.import_hands import HandFile
from getagrip.clip import Clip
from getagrip.clip.read_arrays import read_hand
from getagrip.io.images import write_mask
from getagrip.studio.jobs import CommandCall, NewClipCall
from getagrip.studio.store.mark_store import Store
from helpers.environment import Run
from helpers.hand_files import Known
from helpers.labelled_scene import HEIGHT, POINTS, RADIUS, WIDTH, SceneNets, middle, write_scene
from helpers.labelled_scene import K as GUESSED

FRAMES = 8
DRAFT = ("draft", "scene.mp4", "--object", "cup", "--no-page", "--out")
SIDE = ("--side", "left")


@pytest.fixture
def scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("getagrip.studio.hands.load_models", lambda _: SceneNets())
    monkeypatch.setattr(calls, "run_call", lambda call: " ".join(call.words))
    relift = "getagrip.studio.store.export_clip.write_relifted_hands"  # takes most of the time
    monkeypatch.setattr(relift, lambda found, out, *_: out.write_bytes(found.read_bytes()))
    write_scene(tmp_path / "scene.mp4", FRAMES)
    return tmp_path


def disc(n: int) -> np.ndarray:
    v, u = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    return np.hypot(u - middle(n)[0], v - middle(n)[1]) < RADIUS


def script(folder: Path, body: str, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """An estimator whose script sees its arguments in ``args`` and writes into ``out``."""
    path = folder / f"{name}_script.py"
    head = "import sys; from pathlib import Path; args = sys.argv[1:]; out = Path(args[args.index('--out') + 1])\n"
    path.write_text(f"{head}images = sorted(Path(args[0]).glob('*.jpg'))\n{body}\n")
    monkeypatch.setenv(f"GETAGRIP_{name.upper()}", shlex.join([sys.executable, str(path)]))


def mark(out: Path, n: int) -> np.ndarray:
    (masks,) = out.glob("draft-*/masks")
    return np.asarray(cv2.imread(str(masks / f"{n + 1:06d}.png"), cv2.IMREAD_UNCHANGED))


@pytest.mark.slow
def test_masks_of_files_become_those_of_the_draft(scene: Path, run: Run) -> None:
    (scene / "masks").mkdir()
    labels = [disc(n) + 2 * (np.arange(WIDTH) > 300)[None, :] for n in range(FRAMES)]
    for n, mask in enumerate(labels):
        assert cv2.imwrite(str(scene / "masks" / f"{n + 1:06d}.png"), mask.astype(np.uint8))
    status, _, err = run(*DRAFT, "a", "--masks", "masks")
    assert status == 1
    assert "the object's named by --mask-object" in err
    status, out, err = run(*DRAFT, "a", "--masks", "masks", "--mask-object", "1")
    assert status == 0, err
    assert "reconstruct a/clips/" in out
    for n in range(FRAMES):
        found, given = mark(scene / "a", n) == 1, disc(n)
        assert (found & given).sum() > 0.95 * (found | given).sum()


def test_masks_beside_the_hand_are_said_and_so_are_older_ones(scene: Path, run: Run) -> None:
    for name, frames in (("late", (7, 8)), ("first", (1,)), ("next", (2,))):
        (scene / name).mkdir()
        for n in frames:
            write_mask(scene / name / f"{n:06d}.png", disc(n - 1))
    assert run(*DRAFT, "a", "--interval", "1", "4")[0] == 0
    words = ("--hands", "a/found/hand.npz", "--masks")
    status, _, err = run(*DRAFT, "b", *words, "late")
    assert status == 1
    assert "no mask is in the frames with a hand" in err
    assert "already" not in run(*DRAFT, "c", *words, "first")[2]
    assert "c has labels of 1 other frame already, which count, too" in run(*DRAFT, "c", *words, "next")[2]


def test_an_estimator_is_run_and_its_masks_are_read(scene: Path, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    assert "missing --object-box" in run(*DRAFT, "a", "--masks", "sam2")[2]
    box = ("--object-box", "90,70,80,80")
    status, _, err = run(*DRAFT, "a", "--masks", "sam2", *box)
    assert status == 2
    assert "missing GETAGRIP_SAM2: the command that runs sam2; GETAGRIP_SAM2='" in err
    assert not (scene / "a").exists()
    monkeypatch.setenv("GETAGRIP_SAM2", "python nowhere.py")
    assert (
        "GETAGRIP_SAM2 must be a command that is there (got nowhere.py)" in run(*DRAFT, "a", "--masks", "sam2", *box)[2]
    )
    script(scene, "raise SystemExit('out of memory')", "sam2", monkeypatch)
    status, _, err = run(*DRAFT, "a", "--masks", "sam2", *box)
    assert status == 2
    assert "sam2 failed with status 1: out of memory" in err
    (scene / "made").mkdir()
    for n in range(FRAMES):
        write_mask(scene / "made" / f"{n + 1:06d}.png", disc(n))
    body = f"""import shutil
assert args[1:6] == ['--box', '90.0', '70.0', '80.0', '80.0'], args
for each in images: shutil.copy(Path({str(scene / "made")!r}) / f'{{each.stem}}.png', out)"""
    script(scene, body, "sam2", monkeypatch)
    status, _, err = run(*DRAFT, "a", "--masks", "sam2", *box)
    assert status == 0, err
    assert (mark(scene / "a", 3) == 1).sum() > 0.9 * disc(3).sum()
    assert "a/sam2: exists already: --masks a/sam2 reads it" in run(*DRAFT, "a", "--masks", "sam2", *box)[2]


def test_hands_of_files_are_those_of_the_draft(scene: Path, run: Run) -> None:
    assert run(*DRAFT, "a")[0] == 0
    status, _, err = run(*DRAFT, "b", "--hands", "a/found/hand.npz")
    assert status == 0, err
    first, again = (read_hand(scene / out / "found" / "hand.npz", FRAMES) for out in ("a", "b"))
    np.testing.assert_allclose(again.T_cam_hand, first.T_cam_hand)
    np.testing.assert_allclose(again.joints_2d, first.joints_2d)
    assert "the hand file's" in str(HandFile.of(scene / "b" / "found" / "hand.npz").provenance["camera"])
    seen = {"joints_2d": np.tile(POINTS, (FRAMES, 1, 1)).tolist(), "frames": list(range(1, FRAMES + 1))}
    (scene / "seen.json").write_text(json.dumps(seen))
    assert "missing --hands-from" in run(*DRAFT, "c", "--hands", "seen.json")[2]
    assert "missing --side" in run(*DRAFT, "c", "--hands", "seen.json", "--hands-from", "landmarks")[2]
    assert run(*DRAFT, "c", "--hands", "seen.json", "--hands-from", "landmarks", *SIDE)[0] == 0
    status, _, err = run(*DRAFT, "c", "--hands", "seen.json", "--hands-from", "mano", *SIDE)
    assert status == 2
    assert "missing --pose" in err
    assert "getagrip import hands has this option" in err


@pytest.mark.slow
def test_estimators_of_hands_are_told_side_boxes_and_camera(
    scene: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert run(*DRAFT, "a")[0] == 0
    copy = f"import shutil; shutil.copy({str(scene / 'a' / 'found' / 'hand.npz')!r}, out)"
    boxes = "import json; boxes = json.loads(Path(args[args.index('--boxes') + 1]).read_text())"
    box = [*POINTS.min(axis=0).tolist(), *POINTS.max(axis=0).tolist()]
    script(scene, f"{boxes}; assert boxes['{1:06d}'] == {box}\n{copy}", "hamer", monkeypatch)
    script(
        scene,
        f"assert args[1:6] == '--K 320.0 320.0 160.0 120.0'.split(), args\n{copy}",
        "wilor",
        monkeypatch,
    )
    for name in ("hamer", "wilor"):
        status, _, err = run(*DRAFT, name, "--hands", name)
        assert status == 0, err
        assert len(HandFile.of(scene / name / "found" / "hand.npz").numbers or ()) == FRAMES
    monkeypatch.setattr("getagrip.studio.hands.load_models", lambda _: SceneNets(hands=False))
    near = "json.loads(Path(args[args.index('--near') + 1]).read_text())['000001'] == [90, 70, 170, 150]"
    alone = f"import json; assert '--boxes' not in args and '--side' not in args, args; assert {near}"
    (scene / "masks").mkdir()
    for n in range(FRAMES):
        write_mask(scene / "masks" / f"{n + 1:06d}.png", disc(n))
    about = ("--object-box", "90,70,80,80", "--masks", "masks")
    for name in ("hamer", "wilor"):
        script(scene, f"{alone}\n{copy}", name, monkeypatch)
        status, _, err = run(*DRAFT, f"{name}-alone", "--hands", name, *about)
        assert status == 0, err
        assert ("hamer looks for the hand itself: no hand" in err) == (name == "hamer")
    known = Known("left", None, FRAMES)
    z = known.t[:, 2]
    record = {
        "init_root_orient": known.R,
        "init_hand_pose": np.broadcast_to(np.eye(3), (FRAMES, 15, 3, 3)),
        "init_betas": known.betas,
        "init_trans": np.column_stack([0.0 * z, 0.0 * z, z]),
    }
    text = json.dumps({key: value.tolist() for key, value in record.items()})
    body = f"(out / '0').mkdir(); (out / '0' / '0_{FRAMES - 1}.json').write_text({text!r})"
    script(scene, body, "hawor", monkeypatch)
    monkeypatch.setattr("getagrip.studio.hands.load_models", lambda _: pytest.fail("the side is stated"))
    status, _, err = run(*DRAFT, "hawor-alone", "--hands", "hawor")
    assert status == 0, err
    assert HandFile.of(scene / "hawor-alone" / "found" / "hand.npz").side == "left"
    status, _, err = run(*DRAFT, "hawor", "--hands", "hawor", *SIDE)
    assert status == 0, err
    found = HandFile.of(scene / "hawor" / "found" / "hand.npz")
    assert found.K is not None
    np.testing.assert_allclose(found.K, GUESSED)
    assert "HaWoR" in str(found.provenance["hands"])


def test_what_does_not_fit_is_said_before_any_work(scene: Path, run: Run) -> None:
    for words, said in {
        ("--masks", "sam4"): "unknown --masks 'sam4'; choose from sam2, sam3, a file or folder that exists",
        ("--hands", "nowhere.npz"): "unknown --hands 'nowhere.npz'; choose from hamer, wilor, hawor, ",
        ("--hands-from", "hamer"): "missing --hands FILE",
        ("--find-grasps",): "missing --masks or --object-box",
        ("--mask-object", "1"): "missing --masks FILE",
        ("--mask-word", "mug"): "missing --masks sam3",
        ("--find-grasps", "--all-frames", "--object-box", "9,9,9,9"): "choose one of --all-frames and --find-grasps",
        ("--depth", "."): "missing --depth-from NAME",
        ("--depth-from", "realsense"): "missing --depth PATH",
        ("--depth-first", "0"): "missing --depth PATH",
    }.items():
        status, _, err = run(*DRAFT, "a", *words)
        assert status == 2
        assert said in err
        assert not (scene / "a").exists()


def test_an_object_that_is_neither_a_file_nor_a_kind_is_said_before_any_work(scene: Path, run: Run) -> None:
    status, _, err = run(*DRAFT, "a", "--object", "boat")
    assert status == 1
    assert "boat: mesh: no such file; must be a triangle mesh" in err
    assert "bowl, box" in err
    assert not (scene / "a").exists()


@pytest.mark.slow
def test_grasps_are_found_and_marked(scene: Path, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """The clip of the whole interval is searched as by ``segment``; frames of its grasps are those of the video."""
    assert run(*DRAFT, "a")[0] == 0
    (scene / "masks").mkdir()
    for n in range(FRAMES):
        write_mask(scene / "masks" / f"{n + 1:06d}.png", disc(n))

    def found(grasps: list[tuple[int, int]]) -> None:
        def find(clip: Clip) -> SimpleNamespace:
            assert clip.category == "cup"
            assert len(clip) == FRAMES - 1
            return SimpleNamespace(grasps=grasps, notes=("a note",))

        monkeypatch.setattr("getagrip.studio.detect_grasps.find_segments", find)

    def only_clips(call: CommandCall) -> str:
        return run_call(call) if isinstance(call, NewClipCall) else ""

    monkeypatch.setattr(calls, "run_call", only_clips)

    for grasps, said, marked in (
        ([(1, 3), (4, 6)], "2 stable grasps found: frames 3 to 5, frames 6 to 8;", [(2, 4), (5, 7)]),
        ([], "warning: no stable grasp found; the whole interval is marked", [(1, 7)]),
    ):
        found(grasps)
        words = ("--interval", "2", "8", "--masks", "masks", "--hands", "a/found/hand.npz", "--find-grasps")
        status, _, err = run(*DRAFT, said[:2], *words)
        assert status == 0, err
        assert said in err
        store = Store(scene / said[:2] / DATABASE)
        assert [mark.interval for mark in store.marks.standing()] == marked
        store.close()
