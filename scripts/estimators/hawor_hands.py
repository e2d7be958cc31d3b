"""HaWoR's hands before the camera. Put this into HaWoR's folder (github.com/ThunderVVV/HaWoR), there:

    python hawor_hands.py FRAMES --K 1200 1200 960 540 --out hands

FRAMES is a folder of .jpg. Only detection and motion estimation are run, not SLAM. ``hands/<0 left, 1 right>`` get
HaWoR's own files, which count the images from 0: ``getagrip import hands --from hawor --first 0``, with K's focal
length for ``--estimator-focal``.
"""

import argparse
import shutil
import tempfile
from pathlib import Path
from types import SimpleNamespace

from scripts.scripts_test_video.detect_track_video import detect_track_video
from scripts.scripts_test_video.hawor_video import hawor_motion_estimation

CHECKPOINT = "./weights/hawor/checkpoints/hawor.ckpt"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("frames", type=Path)
    parser.add_argument("--K", type=float, nargs=4, metavar=("FX", "FY", "CX", "CY"), required=True)
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        images = Path(folder) / "video" / "extracted_images"  # existing images are not extracted from a video again
        shutil.copytree(args.frames, images)
        hawor = SimpleNamespace(video_path=f"{folder}/video.mp4", img_focal=args.K[0], checkpoint=CHECKPOINT)
        first, last, where, _ = detect_track_video(hawor)
        hawor_motion_estimation(hawor, first, last, where)
        shutil.copytree(Path(where) / "cam_space", args.out, dirs_exist_ok=True)
    print(args.out)


if __name__ == "__main__":
    main()
