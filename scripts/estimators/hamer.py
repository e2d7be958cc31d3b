"""HaMeR's hands as a hand file. Put this and hand_file.py into HaMeR's folder (github.com/geopavlakos/hamer), there:

    python hamer_hands.py CLIP/frames --side right --boxes boxes.json --K 1200 1200 960 540 --out hand.npz

``boxes.json``: {"000743": [x0, y0, x1, y1], ...}, the hand's box in each image [px], from whatever detector there is
(HaMeR's demo needs detectron2 and ViTPose for it). Images without a box are left out. ``--guess-focal`` instead of
``--K`` takes the longer side of the image for the focal length: a guess. Name it other than hamer.py there, which is
HaMeR's own.
"""

import argparse
import json
import re
from pathlib import Path

import cv2
import hand_file
import numpy as np
import torch
from hamer.configs import CACHE_DIR_HAMER
from hamer.datasets.vitdet_dataset import ViTDetDataset
from hamer.models import DEFAULT_CHECKPOINT, download_models, load_hamer
from hamer.utils import recursive_to


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("frames", type=Path)
    parser.add_argument("--side", choices=("left", "right"), required=True)
    parser.add_argument("--boxes", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    camera = parser.add_mutually_exclusive_group(required=True)
    camera.add_argument("--K", type=float, nargs=4, metavar=("FX", "FY", "CX", "CY"))
    camera.add_argument("--guess-focal", action="store_true")
    args = parser.parse_args()

    download_models(CACHE_DIR_HAMER)
    model, config = load_hamer(DEFAULT_CHECKPOINT)
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    model = model.to(device).eval()
    boxes = json.loads(args.boxes.read_text())
    right = np.array([float(args.side == "right")])
    numbers, vertices, joints, poses, K = [], [], [], [], None
    for path in sorted([*args.frames.glob("*.jpg"), *args.frames.glob("*.png")]):
        if path.stem not in boxes:
            print(f"{path.name}: no box")
            continue
        image = cv2.imread(str(path))
        height, width = image.shape[:2]
        fx, fy, cx, cy = args.K or (max(width, height), max(width, height), width / 2, height / 2)
        K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        dataset = ViTDetDataset(config, image, np.array([boxes[path.stem]], dtype=float), right, rescale_factor=2.0)
        batch = recursive_to(next(iter(torch.utils.data.DataLoader(dataset, batch_size=1))), device)
        with torch.no_grad():
            out = model(batch)
        cam = out["pred_cam"][0].cpu().numpy().astype(float)
        cam[1] *= 2.0 * right[0] - 1.0  # the crop of a left hand is mirrored
        centre, side = batch["box_center"][0].cpu().numpy(), float(batch["box_size"][0])
        t = hand_file.translation(cam, centre, side, K)
        R = out["pred_mano_params"]["global_orient"][0].cpu().numpy().reshape(3, 3)
        points = out["pred_keypoints_3d"][0].cpu().numpy()
        flat, T = hand_file.hand_frame(out["pred_vertices"][0].cpu().numpy(), points[0], R, t, args.side)
        numbers.append(int(re.findall(r"\d+", path.stem)[-1]))
        vertices.append(flat)
        joints.append(hand_file.hand_frame(points, points[0], R, t, args.side)[0])
        poses.append(T)
    mano = model.mano
    template = mano.v_template.detach().cpu().numpy()
    rest = (mano.J_regressor @ mano.v_template).detach().cpu().numpy()
    faces, weights = np.asarray(mano.faces), mano.lbs_weights.detach().cpu().numpy()
    regions = hand_file.contact_regions(template, rest, faces.astype(int), weights)
    camera = "given to the script" if args.K else "a guess: the focal length is the longer side of the image"
    hand_file.write(args.out, vertices, joints, poses, faces, regions, args.side, numbers, K, camera)
    print(f"{args.out}: {len(numbers)} frames")


if __name__ == "__main__":
    main()
