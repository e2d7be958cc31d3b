"""WiLoR's hands as a hand file. Run where WiLoR-mini is installed (github.com/warmshao/WiLoR-mini):

    python wilor.py CLIP/frames --K 1200 1200 960 540 --near near.json --out hand.npz

Its own detector finds the hands. ``near.json``: {"000743": [x0, y0, x1, y1], ...}, the object's box in the images in
which it is known [px]: the hand at it is taken, then the nearest to that; without it the largest. ``--side`` states
which hand it is, else most images decide. ``--guess-focal`` instead of ``--K`` takes the longer side of the image for
the focal length: a guess. WiLoR-mini has a weak-perspective camera of its own; its translation is converted to the
given camera.
"""

import argparse
import json
import re
from pathlib import Path

import cv2
import hand_file
import numpy as np
import torch
from wilor_mini.pipelines.wilor_hand_pose3d_estimation_pipeline import WiLorHandPose3dEstimationPipeline


def taken_hands(pipeline, paths, near, side):
    """Detect the hand at the object, by image."""
    taken, last = {}, None
    for path in paths:
        hands = pipeline.predict(cv2.imread(str(path))[..., ::-1])
        boxes, rights = ([hand[key] for hand in hands] for key in ("hand_bbox", "is_right"))
        chosen = hand_file.at_object(boxes, rights, side, near.get(path.stem), last)
        if chosen is None:
            print(f"{path.name}: no hand")
            continue
        taken[path], last = hands[chosen], hands[chosen]["hand_bbox"]
        if len(hands) > 1:
            print(f"{path.name}: {len(hands)} hands, that at {[round(x) for x in last]} is taken")
    return taken


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("frames", type=Path)
    parser.add_argument("--side", choices=("left", "right"))
    parser.add_argument("--near", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    camera = parser.add_mutually_exclusive_group(required=True)
    camera.add_argument("--K", type=float, nargs=4, metavar=("FX", "FY", "CX", "CY"))
    camera.add_argument("--guess-focal", action="store_true")
    args = parser.parse_args()

    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    pipeline = WiLorHandPose3dEstimationPipeline(device=device, dtype=torch.float32, verbose=False)
    mano = pipeline.wilor_model.mano
    near = json.loads(args.near.read_text()) if args.near else {}
    paths = sorted([*args.frames.glob("*.jpg"), *args.frames.glob("*.png")])
    taken = taken_hands(pipeline, paths, near, args.side)
    if not taken:
        raise SystemExit("WiLoR's detector finds no hand in any image")
    side = hand_file.side_of([hand["is_right"] for hand in taken.values()], args.side)
    numbers, vertices, joints, poses, K = [], [], [], [], None
    for path, found in taken.items():
        image = cv2.imread(str(path))[..., ::-1]
        height, width = image.shape[:2]
        fx, fy, cx, cy = args.K or (max(width, height), max(width, height), width / 2, height / 2)
        K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        hand = found["wilor_preds"]
        if (found["is_right"] > 0.5) != (side == "right"):  # detected as the other side in this image
            boxes = np.array([found["hand_bbox"]], dtype=float)
            hand = pipeline.predict_with_bboxes(image, boxes, [float(side == "right")])[0]["wilor_preds"]
        full, assumed = hand["pred_cam_t_full"].reshape(3), float(hand["scaled_focal_length"])
        scale = assumed / full[2]
        origin = np.array([width, height]) / 2.0 + scale * full[:2]
        t = hand_file.translation(np.array([1.0, 0.0, 0.0]), origin, 2.0 * scale, K)
        # WiLoR-mini has turned left hands back; hand_frame expects the network's own numbers
        mirror = hand_file.MIRROR if side == "left" else np.ones(3)
        R = cv2.Rodrigues(hand["global_orient"].reshape(3).astype(float))[0]
        R, points = mirror[:, None] * R * mirror, hand["pred_keypoints_3d"].reshape(21, 3) * mirror
        flat, T = hand_file.hand_frame(hand["pred_vertices"].reshape(778, 3) * mirror, points[0], R, t, side)
        numbers.append(int(re.findall(r"\d+", path.stem)[-1]))
        vertices.append(flat)
        joints.append(hand_file.hand_frame(points, points[0], R, t, side)[0])
        poses.append(T)
    template = mano.v_template.detach().cpu().numpy()
    rest = (mano.J_regressor @ mano.v_template).detach().cpu().numpy()
    faces, weights = np.asarray(mano.faces), mano.lbs_weights.detach().cpu().numpy()
    regions = hand_file.contact_regions(template, rest, faces.astype(int), weights)
    camera = "given to the script" if args.K else "a guess: the focal length is the longer side of the image"
    hand_file.write(args.out, vertices, joints, poses, faces, regions, side, numbers, K, camera)
    print(f"{args.out}: {len(numbers)} frames")


if __name__ == "__main__":
    main()
