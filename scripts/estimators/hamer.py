"""HaMeR's hands as a hand file. Put this and hand_file.py into HaMeR's folder (github.com/geopavlakos/hamer), there:

    python hamer_hands.py CLIP/frames --K 1200 1200 960 540 --boxes boxes.json --near near.json --out hand.npz

Both files: {"000743": [x0, y0, x1, y1], ...}, boxes in the images [px]; each may be left out. ``--boxes`` are the
hand's, from whatever detector there is. In images without one, that of HaMeR's demo (detectron2 and ViTPose) looks for
hands, if it is installed, and the one at the object's box, ``--near``, is taken, or the nearest to the one before;
where it finds none, the hand is looked for about the object's box. ``--side`` states which hand it is, else most images
of the detector decide. ``--guess-focal`` instead of ``--K`` takes the longer side of the image for the focal length: a
guess. Name it other than hamer.py there, which is HaMeR's own.
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

VITDET = (
    "https://dl.fbaipublicfiles.com/detectron2/ViTDet/COCO/cascade_mask_rcnn_vitdet_h/f328730692/model_final_f05665.pkl"
)
WIDER = 0.25
"""Margin around the object's box to search for the hand, relative to its longer side."""


def detector(device):
    """Return the detector of HaMeR's demo: from a BGR image, boxes (n, 4), and 1 for right hands; None if missing."""
    try:
        import hamer
        from detectron2.config import LazyConfig
        from hamer.utils.utils_detectron2 import DefaultPredictor_Lazy
        from vitpose_model import ViTPoseModel
    except ImportError as error:
        print(f"HaMeR's own detector is not installed ({error}): hands are only looked for in the boxes")
        return None
    config = LazyConfig.load(str(Path(hamer.__file__).parent / "configs" / "cascade_mask_rcnn_vitdet_h_75ep.py"))
    config.train.init_checkpoint = VITDET
    for each in config.model.roi_heads.box_predictors:
        each.test_score_thresh = 0.25
    people, keypoints = DefaultPredictor_Lazy(config), ViTPoseModel(device)

    def detect(image):
        found = people(image)["instances"]
        sure = (found.pred_classes == 0) & (found.scores > 0.5)
        boxes, scores = found.pred_boxes.tensor[sure].cpu().numpy(), found.scores[sure].cpu().numpy()
        hands = []
        for person in keypoints.predict_pose(image[:, :, ::-1], [np.column_stack([boxes, scores])]):
            for right, points in ((0, person["keypoints"][-42:-21]), (1, person["keypoints"][-21:])):
                seen = points[points[:, 2] > 0.5, :2]
                if len(seen) > 3:
                    hands.append(([*seen.min(axis=0), *seen.max(axis=0)], right))
        return hands

    return detect


def chosen_boxes(paths, boxes, near, detect, side):
    """Return the hand's box in each image that shows it, and whether it is a right hand, if detected."""
    taken, rights, last = {}, [], None
    for path in paths:
        hands = [] if path.stem in boxes or detect is None else detect(cv2.imread(str(path)))
        seen = [box for box, _ in hands], [right for _, right in hands]
        chosen = hand_file.at_object(*seen, side, near.get(path.stem), last)
        if path.stem in boxes:
            last = boxes[path.stem]
        elif chosen is not None:
            last, right = hands[chosen]
            rights.append(right)
        elif path.stem in near:
            x0, y0, x1, y1 = near[path.stem]
            margin = WIDER * max(x1 - x0, y1 - y0)
            taken[path] = [x0 - margin, y0 - margin, x1 + margin, y1 + margin]
            continue
        else:
            print(f"{path.name}: no box")
            continue
        taken[path] = last
    return taken, rights


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("frames", type=Path)
    parser.add_argument("--side", choices=("left", "right"))
    parser.add_argument("--boxes", type=Path)
    parser.add_argument("--near", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    camera = parser.add_mutually_exclusive_group(required=True)
    camera.add_argument("--K", type=float, nargs=4, metavar=("FX", "FY", "CX", "CY"))
    camera.add_argument("--guess-focal", action="store_true")
    args = parser.parse_args()

    download_models(CACHE_DIR_HAMER)
    model, config = load_hamer(DEFAULT_CHECKPOINT)
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    model = model.to(device).eval()
    boxes, near = (json.loads(each.read_text()) if each else {} for each in (args.boxes, args.near))
    paths = sorted([*args.frames.glob("*.jpg"), *args.frames.glob("*.png")])
    detect = None if all(path.stem in boxes for path in paths) else detector(device)
    taken, rights = chosen_boxes(paths, boxes, near, detect, args.side)
    side = hand_file.side_of(rights, args.side)
    if not taken or side is None:
        raise SystemExit(
            "no hand is found in any image" if not taken else "give --side: no detector tells which hand it is"
        )
    right = np.array([float(side == "right")])
    numbers, vertices, joints, poses, K = [], [], [], [], None
    for path, box in taken.items():
        image = cv2.imread(str(path))
        height, width = image.shape[:2]
        fx, fy, cx, cy = args.K or (max(width, height), max(width, height), width / 2, height / 2)
        K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        dataset = ViTDetDataset(config, image, np.array([box], dtype=float), right, rescale_factor=2.0)
        batch = recursive_to(next(iter(torch.utils.data.DataLoader(dataset, batch_size=1))), device)
        with torch.no_grad():
            out = model(batch)
        cam = out["pred_cam"][0].cpu().numpy().astype(float)
        cam[1] *= 2.0 * right[0] - 1.0  # the crop of a left hand is mirrored
        centre, length = batch["box_center"][0].cpu().numpy(), float(batch["box_size"][0])
        t = hand_file.translation(cam, centre, length, K)
        R = out["pred_mano_params"]["global_orient"][0].cpu().numpy().reshape(3, 3)
        points = out["pred_keypoints_3d"][0].cpu().numpy()
        flat, T = hand_file.hand_frame(out["pred_vertices"][0].cpu().numpy(), points[0], R, t, side)
        numbers.append(int(re.findall(r"\d+", path.stem)[-1]))
        vertices.append(flat)
        joints.append(hand_file.hand_frame(points, points[0], R, t, side)[0])
        poses.append(T)
    mano = model.mano
    template = mano.v_template.detach().cpu().numpy()
    rest = (mano.J_regressor @ mano.v_template).detach().cpu().numpy()
    faces, weights = np.asarray(mano.faces), mano.lbs_weights.detach().cpu().numpy()
    regions = hand_file.contact_regions(template, rest, faces.astype(int), weights)
    camera = "given to the script" if args.K else "a guess: the focal length is the longer side of the image"
    hand_file.write(args.out, vertices, joints, poses, faces, regions, side, numbers, K, camera)
    print(f"{args.out}: {len(numbers)} frames")


if __name__ == "__main__":
    main()
