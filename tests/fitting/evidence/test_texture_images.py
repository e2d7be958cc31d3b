"""Images are evidence beside a mesh with colours or of revolution: a clip's checksum depends on them only there."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from getagrip.checks import Evidence, run_checks
from getagrip.checks.evidence import TextureVote
from getagrip.clip import Clip, Segment, input_sha256, read_clip, with_evidence, write_clip
from getagrip.fitting.evidence.texture import TEXTURE_KEY, Texture, reads_images
from getagrip.io.images import write_image
from helpers.clips import box, small_clip


def checksums(clip: Clip, folder: Path) -> tuple[str, str, str]:
    """Write a clip; return its checksums without images, with them, and with another one."""
    write_clip(clip, small_clip()[1], folder)
    out = [input_sha256(folder)]
    (folder / "frames").mkdir()
    for grey in (80, 90):
        for name in clip.frames:
            write_image(folder / "frames" / f"{name}.jpg", np.full((*clip.size[::-1], 3), grey, np.uint8))
        out.append(input_sha256(folder))
    return out[0], out[1], out[2]


def painted(clip: Clip) -> Clip:
    return replace(clip, mesh=replace(clip.mesh, colours=np.full(clip.mesh.vertices.shape, 9, np.uint8)))


def test_the_checksum_depends_on_images_where_they_are_evidence(tmp_path: Path) -> None:
    clip, _ = small_clip()
    assert len({*checksums(painted(clip), tmp_path / "painted")}) == 3
    assert len({*checksums(clip, tmp_path / "bare")}) == 1
    square = replace(clip, mesh=box(0.05, 0.05, 0.11))  # its moments are those of a body of revolution
    assert len({*checksums(square, tmp_path / "square")}) == 3
    timeline = replace(painted(clip), segments=(Segment("grasp", 0, len(clip) - 1, clip.side),))
    assert len({*checksums(timeline, tmp_path / "timeline")}) == 1
    for name, evidence in (("painted", True), ("square", True), ("bare", False), ("timeline", False)):
        assert reads_images(tmp_path / name) == evidence
        read = with_evidence(read_clip(tmp_path / name))
        assert (read.evidence[TEXTURE_KEY] is not None) == evidence
        assert read.take(np.array([1])).frames == clip.frames[1:2]


def test_a_pose_that_texture_contradicts_is_serious_and_an_unrelated_texture_a_note() -> None:
    clip, masks = small_clip()
    colours = np.random.default_rng(0).integers(0, 256, clip.mesh.vertices.shape).astype(np.uint8)
    clip = replace(clip, mesh=replace(clip.mesh, colours=colours))
    for vote, names in {
        TextureVote(0.5, 0.0, 0.0): {},
        TextureVote(0.5, 0.0, 20.0): {"texture-contradicts": True},
        TextureVote(0.5, 20.0, 0.0): {"texture-turned": False},
        TextureVote(0.05, 0.0, 0.0): {"texture-elsewhere": False},
        TextureVote(unread=2): {"texture-unread": False},
    }.items():
        _, findings = run_checks(Texture.result_checks, Evidence(clip, masks, texture=vote))
        assert {finding.check: finding.serious for finding in findings} == names
    plain = replace(clip, mesh=replace(clip.mesh, colours=np.full_like(colours, 9)))
    assert not run_checks(Texture.result_checks, Evidence(plain, masks, texture=TextureVote(0.05, 0.0, 0.0)))[1]
