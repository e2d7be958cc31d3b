"""Every kind of figure shows what it is to show, and refuses results that it cannot show together."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from getagrip.bench.figures import StoredResult
from getagrip.bench.figures.aligned import ANGLE_COLOURS, Aligned, _blend_surfaces
from getagrip.bench.figures.contact_figure import Contact
from getagrip.bench.figures.gallery import Gallery
from getagrip.bench.figures.ihoi import Ihoi
from getagrip.bench.figures.kind import summarise_view
from getagrip.bench.figures.rows import Hands, Methods, row_metrics
from getagrip.clip import Clip, Masks, input_sha256, write_clip
from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.metrics.contact import ContactDefinition
from getagrip.metrics.evaluate import evaluate
from getagrip.metrics.evaluate.external import evaluate_meshes, read_meshes
from getagrip.metrics.evaluate.metric import ADD_MM, IOU, SCA
from getagrip.provenance import assumed
from getagrip.report.pictures.panels import AXIS_COLOUR, HAND_LINE_COLOUR, RESULT_COLOUR, look_at
from getagrip.report.pictures.result_view import View
from getagrip.result import Reconstruction, write_result
from getagrip.result.findings import Finding
from getagrip.synthetic.scene_options import SceneOptions
from helpers.clips import box
from helpers.environment import Run
from helpers.pages import panel, pixels, pixels_of, texts
from helpers.results import true_result
from helpers.scenes import scene, scene_with_axis

DPI, LINES = 60, 110
"""Pixels an inch: few, and enough for lines to have their colours."""
SMALL = SceneOptions(frames=4, size=(160, 120), focal=150.0)


@pytest.fixture(scope="module")
def made(tmp_path_factory: Any) -> Path:
    """Clips and results of them, true or moved; nothing in it is changed by tests."""
    root: Path = tmp_path_factory.mktemp("figures")
    clip, masks, axis = scene_with_axis("mug", 0, SMALL)
    wrong = replace(clip.hand, T_cam_hand=se3.rigid(t=np.array([0.0, 0.02, 0.0])) @ clip.hand.T_cam_hand)
    _write(root, "clips", clip, masks, {"true": true_result(clip, axis), "moved": _moved(true_result(clip, None))})
    _write(root, "other-hands", replace(clip, hand=wrong), masks, {"shifted-hands": true_result(clip, axis)})
    can, can_masks = scene("can", 0, SMALL)
    _write(root, "clips", replace(can, truth=None), can_masks, {"cans": true_result(can, None)})
    return root


def _write(root: Path, clips: str, clip: Clip, masks: Masks, results: dict[str, Reconstruction]) -> None:
    folder = write_clip(clip, masks, root / clips / clip.name)
    for name, result in results.items():
        write_result(result, root / name / clip.name, input_sha256(folder), clip_folder=folder)


def _moved(result: Reconstruction) -> Reconstruction:
    """The object 30 mm off, and turned: as bad as results are."""
    T = se3.rigid(se3.exp_so3(np.array([0.0, 0.0, 0.8])), np.array([0.03, 0.0, 0.0])) @ result.T_hand_obj
    return replace(result, T_hand_obj=T, method="dynamic")


def given(root: Path, *names: str) -> list[StoredResult]:
    return [StoredResult(folder) for name in names for folder in sorted((root / name).iterdir())]


def never(error: Exception) -> None:
    raise error


def red(picture: np.ndarray) -> int:
    """Pixels that are red in any light."""
    r, g, b = np.moveaxis(picture.astype(int), -1, 0)
    return int(((r > 1.8 * g) & (r > 1.8 * b) & (r > 60)).sum())


def drawn(figure: Figure) -> list[np.ndarray]:
    """The pictures of the figure's axes, in the order in which they were made."""
    picture = pixels(figure)
    border = np.concatenate([picture[:3].reshape(-1, 3), picture[-3:].reshape(-1, 3), picture[:, -3:].reshape(-1, 3)])
    assert (border == 255).all()  # nothing is cut off
    return [panel(picture, axes) for axes in figure.axes]


@pytest.mark.slow
def test_contact_is_red_where_hand_and_object_touch(made: Path) -> None:
    source = given(made, "true")
    figure = Contact(dpi=DPI, frames=2).draw(source, never)
    tiles = drawn(figure)
    assert all(red(tile) == 0 for tile in (tiles[0], tiles[3]))  # the results themselves
    assert all(red(tile) > 50 for tile in (*tiles[1:3], *tiles[4:6]))  # object and hand, in two frames
    shares = tiles[6:10]
    assert red(shares[0]) > red(shares[1])  # the object, where most contact is and from the other side
    view = source[0].read()
    sca = evaluate(view.result, view.clip, wanted=[SCA]).metrics["sca_object_10mm"]
    assert any(f"(SCA) {100 * sca:.1f} %" in words for words in texts(figure))
    words = {"on the object", "on the hand", "frame 000000", "frame 000003", "object vertices within 10 mm"}
    assert words <= texts(figure)


@pytest.mark.slow
def test_an_object_far_from_the_hand_has_no_red(made: Path, tmp_path: Path) -> None:
    (source,) = given(made, "true")
    view = source.read()
    T = se3.rigid(t=np.array([0.0, 0.0, 0.5])) @ view.result.T_hand_obj
    result = replace(view.result, T_hand_obj=T)
    write_result(result, tmp_path / "far", input_sha256(view.clip.origin), clip_folder=view.clip.origin)
    figure = Contact(dpi=DPI, frames=1).draw([StoredResult(tmp_path / "far")], never)
    assert sum(red(tile) for tile in drawn(figure)[:7]) == 0
    assert any("(SCA) 0.0 %" in words for words in texts(figure))


@pytest.mark.slow
def test_aligned_frames_have_axis_angles_and_colours(made: Path) -> None:
    source = given(made, "true")
    figure = Aligned(dpi=LINES, frames=2).draw(source, never)
    tiles = drawn(figure)
    assert len(figure.axes) == 2 + 4 + 1
    assert all(pixels_of(tile, AXIS_COLOUR) > 10 for tile in tiles[:6])
    for tile in tiles[2:6]:
        assert all(pixels_of(tile, colour) > 5 for colour in (ANGLE_COLOURS[0], ANGLE_COLOURS[-1]))
    axis = source[0].read().result.axis
    assert axis is not None
    widest = np.degrees(axis.angle.max() - axis.angle.min())
    assert any(words.startswith(f"{widest:+.1f}°") for words in texts(figure))
    assert {"hand fixed, along the axis", "object fixed, across the axis"} <= texts(figure)


@pytest.mark.slow
def test_a_clip_is_drawn_by_its_ground_truth(made: Path, tmp_path: Path, run: Run) -> None:
    """The true axis of an exact hinge is that of the result that has it, and the figures are its own."""
    clip, result = next((made / "clips").glob("mug*")), next((made / "true").glob("mug*"))
    true, found = StoredResult(clip).read(), StoredResult(result).read()
    assert true.of_truth
    assert true.result.axis is not None
    assert found.result.axis is not None
    assert abs(true.result.axis.direction @ found.result.axis.direction) > 0.999
    np.testing.assert_allclose(true.result.T_hand_obj, found.result.T_hand_obj, atol=1e-9)
    for kind in (Contact(dpi=DPI, frames=2), Aligned(dpi=DPI, frames=2)):
        assert any("ground truth" in text for text in texts(kind.draw([StoredResult(clip)], pytest.fail)))
    for kind_name, status in (("contact", 0), ("gallery", 1)):
        assert run("figure", kind_name, clip, "--out", tmp_path / "x.png", "--dpi", DPI)[0] == status
    without = next((made / "clips").glob("can*"))
    with pytest.raises(InputError, match=r"truth\.npz"):
        StoredResult(without).read()


@pytest.mark.slow
def test_results_without_axis_are_aligned_too(made: Path) -> None:
    figure = Aligned(dpi=DPI, frames=2).draw(given(made, "moved"), never)
    assert sum(pixels_of(tile, AXIS_COLOUR) for tile in drawn(figure)) == 0
    assert any("no latent axis" in words for words in texts(figure))
    assert {"frame 000000", "frame 000003"} <= texts(figure)


def test_surfaces_that_agree_keep_their_own_colour() -> None:
    mesh = box(0.1, 0.1, 0.1)
    eye = look_at(2.0 * mesh.vertices, np.array([0.3, 0.2, 1.0]), np.array([0.0, 1.0, 0.0]), 40)
    front = (se3.transform(eye.T_view_frame, mesh.vertices), mesh.faces)
    behind = (front[0] + [0.0, 0.0, 1.0], mesh.faces)
    other = (front[0] + [0.02, 0.0, 0.0], mesh.faces)
    whole, colours = ((0.9, 0.7, 0.6), (0.4, 0.6, 0.7)), np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])

    def overlay(*moved: Any, colours: np.ndarray = colours) -> np.ndarray:
        return _blend_surfaces(behind, moved, whole, colours, eye)

    np.testing.assert_array_equal(overlay(front, front), overlay(front, front, colours=colours[::-1]))
    assert (overlay(front, other) != overlay(front, other, colours=colours[::-1])).any()
    np.testing.assert_array_equal(overlay(front, other), overlay(other, front, colours=colours[::-1]))


@pytest.mark.slow
def test_methods_stand_under_one_another_with_their_numbers(made: Path) -> None:
    source = given(made, "true", "moved")
    figure = Methods(dpi=LINES, frames=2).draw(source, never)
    tiles = drawn(figure)
    assert len(figure.axes) == 3 * 2 * 2 + 1
    assert {"1-DoF, ours", "Dynamic", "ground truth", "over the masks", "from the side"} <= texts(figure)
    for row in range(3):
        for k in range(2):
            over, side = tiles[4 * row + 2 * k : 4 * row + 2 * k + 2]
            assert pixels_of(over, RESULT_COLOUR) > 20
            assert (pixels_of(side, AXIS_COLOUR) > 5) == (row == 0)
    for one in source:
        view = one.read()
        known = evaluate(view.result, view.clip, view.masks, wanted=[IOU, SCA, ADD_MM]).metrics
        shares = f"crop IOU {100 * known['iou']:.1f} %\nSCA {100 * known['sca_object_10mm']:.1f} %"
        assert any(words.startswith(f"{shares}\nADD {known['add_mm']:.1f} mm") for words in texts(figure))


@pytest.mark.slow
def test_hands_are_where_the_result_has_them(made: Path) -> None:
    view = given(made, "true")[0].read()
    truth = view.clip.truth
    assert truth is not None
    away = np.array([0.0, 0.0, 0.1])
    moved = se3.rigid(t=away) @ view.clip.hand.T_cam_hand
    corrected = View.of(replace(view.result, T_cam_hand=moved), view.clip, view.masks).at(view.result.frames[1:3])
    np.testing.assert_allclose(corrected.hand(0), view.hand(1) + away)
    np.testing.assert_allclose(corrected.object(0), view.object(1) + away)
    true = corrected.true()
    assert true is not None
    np.testing.assert_allclose(true.hand(0), se3.transform(truth.T_cam_hand[1], truth.hand_vertices[1]))
    np.testing.assert_allclose(true.object(0), se3.transform(truth.T_cam_obj[1], truth.scale * view.clip.mesh.vertices))
    contact = ContactDefinition("object", 0.01)
    assert row_metrics(true, contact)[:2] == row_metrics(view.at(view.result.frames[1:3]), contact)[:2]


@pytest.mark.slow
def test_guesses_and_findings_are_named(made: Path) -> None:
    view = given(made, "true")[0].read()
    assert summarise_view(view) == "1-DoF, ours  ·  mug in a right hand  ·  4 frames"
    clip = replace(view.clip, scale="free", provenance={"camera": assumed("a guess"), "hands": "true"})
    findings = tuple(Finding("small", serious, 1.0, 2.0, "the object is small") for serious in (True, False))
    unsure = replace(view, clip=clip, result=replace(view.result, findings=findings))
    assert summarise_view(unsure).endswith("  ·  guessed: scale, camera")
    assert row_metrics(unsure, ContactDefinition("object", 0.01))[-1] == "2 findings, 1 serious"


@pytest.mark.slow
def test_without_ground_truth_there_is_no_add(made: Path) -> None:
    figure = Methods(dpi=DPI, frames=1).draw(given(made, "cans"), never)
    assert not any("ADD" in words or "truth" in words for words in texts(figure))


@pytest.mark.slow
def test_hands_have_contours_and_the_names_of_folders(made: Path) -> None:
    figure = Hands(dpi=LINES, frames=1).draw(given(made, "true", "shifted-hands"), never)
    tiles = drawn(figure)
    assert {"true", "shifted-hands"} <= texts(figure)
    assert all(pixels_of(tiles[n], HAND_LINE_COLOUR) > 20 for n in (0, 2))
    assert (tiles[0][:160, :160] != tiles[2][:160, :160]).any()


@pytest.mark.parametrize(
    ("kind", "names", "words"),
    [
        (Methods, ("true", "shifted-hands"), "shifted-hands.* must be those .*got a result of other hands or masks"),
        (Methods, ("true", "cans"), r"cans.*result.json: clip must be 'mug-.*', as of .*true.*got 'can-.*'"),
        (Hands, ("true", "moved"), "must be of one method"),
        (Contact, ("true", "moved"), "must be one for the figure 'contact' .got 2: "),
        (Aligned, ("true", "moved"), "must be one for the figure 'aligned' .got 2: "),
    ],
)
def test_results_of_other_clips_hands_or_methods_are_refused(
    made: Path, kind: Any, names: tuple[str, ...], words: str
) -> None:
    with pytest.raises((InputError, UsageError), match=words):
        kind(dpi=DPI).draw(given(made, *names), never)


@pytest.mark.slow
def test_galleries_begin_with_the_worst(made: Path) -> None:
    failed: list[Exception] = []
    source = given(made, "true", "moved", "cans")
    figure = Gallery(dpi=LINES, by="add").draw(source, failed.append)
    (missing,) = failed
    assert "truth.npz: no ground truth; needs some, for --by add" in str(missing)
    assert {"worst", "best", "2 results by ADD"} <= texts(figure)
    headings = [words.get_text() for words in figure.texts if words.get_text().startswith("ADD ")]
    assert [("Dynamic" in words, "1-DoF" in words) for words in headings] == [(True, False), (False, True)]
    assert all(pixels_of(tile, RESULT_COLOUR) > 20 for tile in drawn(figure)[:4:2])
    moved = source[1].read()
    add = evaluate(moved.result, moved.clip, wanted=[ADD_MM]).per_frame["add_mm"]
    assert headings[0].endswith(f"frame {moved.result.frames[int(np.argmax(add))]}")
    best = Gallery(dpi=DPI, by="add", show="best", n=1).draw(source[:2], never)
    assert [words.get_text() for words in best.texts if words.get_text().startswith("ADD ")] == headings[1:]
    with pytest.raises(InputError, match="no ground truth"):
        Gallery(by="add").draw(given(made, "cans"), never)


@pytest.mark.slow
def test_figures_are_written_whole_or_not_at_all(run: Run, made: Path, tmp_path: Path) -> None:
    mug, can = next((made / "true").iterdir()), next((made / "cans").iterdir())
    for name in ("a.png", "b.png", "a.pdf"):
        status, out, _ = run("figure", "gallery", mug, tmp_path / "none", can, "--out", tmp_path / name, "--dpi", 50)
        assert (status, out.strip()) == (1, str(tmp_path / name))  # one folder is missing, the others are drawn
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    assert (tmp_path / "a.pdf").read_bytes().startswith(b"%PDF")
    assert run("figure", "gallery", mug, "--out", tmp_path / "new" / "er" / "a.png", "--dpi", 50)[0] == 0
    assert (tmp_path / "new" / "er" / "a.png").is_file()
    before = sorted(tmp_path.iterdir())
    for args, code, words in [
        (("contact", mug, "--out", tmp_path / "x.svg"), 2, "must be a file whose name ends in .png or .pdf"),
        (("contact", mug, "--out", tmp_path / "a.png" / "x.png"), 2, "--out must be a folder that can be written"),
        (("contact", mug, "--out", tmp_path / "x.png", "--contact", 90), 2, "got 90 mm"),
        (("contact", "--out", tmp_path / "x.png"), 2, "RESULT: name at least one result"),
        (("aligned", mug, "--out", tmp_path / "x.png", "--frames", 0), 2, "--frames must be 1 to 12"),
        (("gallery", mug, "--out", tmp_path / "x.png", "--n", 0), 2, "--n must be 1 to 60"),
        (("gallery", mug, "--out", tmp_path / "x.png", "--dpi", 5000), 2, "--dpi must be 40 to 600"),
        (("methods", mug, can, "--out", tmp_path / "x.png"), 1, "result.json: clip must be"),
        (("methods", tmp_path / "none", "--out", tmp_path / "x.png"), 1, "none: no such folder"),
    ]:
        status, out, err = run("figure", *args)
        assert (status, out) == (code, "")
        assert words in err
        assert err.count("\n") == 1
    assert sorted(tmp_path.iterdir()) == before


def test_meshes_of_a_system_without_a_cad_model_stand_under_our_result(made: Path, tmp_path: Path) -> None:
    """Our own surfaces, as meshes of each frame, look and score as our result does; a frame without one is said."""
    (result,) = given(made, "true")
    view = result.read()
    for n, name in list(enumerate(view.result.frames))[1:]:
        lines = [f"v {x:.9f} {y:.9f} {z:.9f}" for x, y, z in view.object(n)]
        lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in view.clip.mesh.faces]
        (tmp_path / f"{name}.obj").write_text("\n".join(lines))
    kind = Ihoi(dpi=LINES, frames=2, meshes=(f"iHOI={tmp_path}",))
    kind.check()
    figure = kind.draw([result], never)
    words = texts(figure)
    assert {"1-DoF, ours", "iHOI"} <= words
    assert any("1 frame without" in text for text in words)
    meshes, errors = read_meshes(tmp_path, view.clip, "camera")
    assert (meshes[0], errors) == (None, [])
    drawn = replace(view, frame_meshes=tuple(meshes))
    for n in range(1, len(meshes)):
        np.testing.assert_allclose(drawn.surface(n)[0], view.object(n), atol=1e-7)
    assert len(drawn.surface(0)[1]) == 0
    known = evaluate_meshes(meshes, view.clip, view.masks, "iHOI").per_frame["iou"]
    np.testing.assert_allclose(known[1:], evaluate(view.result, view.clip, view.masks).per_frame["iou"][1:], atol=0.01)


def test_frames_are_drawn_of_which_every_system_has_a_mesh(made: Path, tmp_path: Path) -> None:
    """Without such a frame they are spread evenly."""
    (result,) = given(made, "true")
    frames = result.read().result.frames
    for name, known in {"first": frames[:1], "inner": frames[1:3], "late": frames[1:]}.items():
        (tmp_path / name).mkdir()
        for frame in known:
            (tmp_path / name / f"{frame}.obj").write_text("v 0 0 .5\nv .1 0 .5\nv 0 .1 .5\nf 1 2 3\n")

    def drawn(*names: str) -> set[str]:
        kind = Ihoi(dpi=LINES, frames=2, meshes=tuple(f"{name}={tmp_path / name}" for name in names))
        return texts(kind.draw([result], never)) & {*frames}

    assert drawn("inner", "late") == {*frames[1:3]}
    assert drawn("first", "late") == {frames[0], frames[-1]}


@pytest.mark.parametrize("meshes", [(), ("iHOI",), ("iHOI=nowhere",)])
def test_meshes_must_be_folders_with_names(meshes: tuple[str, ...]) -> None:
    with pytest.raises(UsageError, match="--meshes"):
        Ihoi(meshes=meshes).check()


def test_results_of_which_none_can_be_read_are_an_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="one"):
        Hands().draw([StoredResult(tmp_path / "one"), StoredResult(tmp_path / "two")], never)
