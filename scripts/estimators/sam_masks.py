"""An object's masks by SAM 2 or SAM 3, in their own environment (github.com/facebookresearch/sam2, .../sam3):

    python sam_masks.py sam2 FRAMES --box 250 300 420 560 --out masks
    python sam_masks.py sam3 FRAMES --text mug --out masks

FRAMES is a folder of .jpg whose names are numbers; ``--box`` (left, top, width, height) [px] is about the object in the
first. SAM 3 takes the box, the text or both, and the box alone where it finds nothing with the text; of several objects
the one nearest to the box is taken, without a box the largest. A .png is written for each frame, 255 where the object
is. Frames are kept in the computer's memory, not in the GPU's.
"""

import argparse
from pathlib import Path

import cv2
import numpy as np
import torch

SAM2 = "facebook/sam2.1-hiera-large"


def sam2(frames, box, text):
    from sam2.sam2_video_predictor import SAM2VideoPredictor

    if box is None:
        raise SystemExit("SAM 2 needs --box")
    device = "cuda" if torch.cuda.is_available() else "cpu"
    predictor = SAM2VideoPredictor.from_pretrained(SAM2, device=device)
    state = predictor.init_state(str(frames), offload_video_to_cpu=True)
    x, y, w, h = box
    predictor.add_new_points_or_box(state, frame_idx=0, obj_id=1, box=np.array([x, y, x + w, y + h], np.float32))
    for n, _, logits in predictor.propagate_in_video(state):
        yield n, (logits[0, 0] > 0.0).cpu().numpy()


def sam3(frames, box, text):
    from sam3.model_builder import build_sam3_video_predictor

    if box is None and text is None:
        raise SystemExit("SAM 3 needs --box or --text")
    predictor = build_sam3_video_predictor()
    start = {"type": "start_session", "resource_path": str(frames), "offload_video_to_cpu": True}
    session = predictor.handle_request(start)["session_id"]
    height, width = cv2.imread(str(min(frames.glob("*.jpg"), key=lambda path: int(path.stem)))).shape[:2]
    ask = {"type": "add_prompt", "session_id": session, "frame_index": 0}
    about = {}
    if box is not None:  # relative to the image size
        x, y, w, h = np.array(box) / [width, height, width, height]
        x0, y0, x1, y1 = np.clip([x, y, x + w, y + h], 0.0, 1.0).tolist()
        about = {"bounding_boxes": [[x0, y0, x1 - x0, y1 - y0]], "bounding_box_labels": [1]}
    first = predictor.handle_request(ask | about | ({} if text is None else {"text": text}))["outputs"]
    if not len(first["out_obj_ids"]) and text is not None and about:
        print(f"SAM 3 sees no {text} in the box: whatever is in it is taken")
        first = predictor.handle_request(ask | about)["outputs"]
    if not len(first["out_obj_ids"]):
        raise SystemExit(f"SAM 3 sees {'nothing in the box' if about else f'no {text}'} in the first frame")
    chosen = first["out_obj_ids"][int(np.argmax([overlap(mask, box) for mask in first["out_binary_masks"]]))]
    for one in predictor.handle_stream_request({"type": "propagate_in_video", "session_id": session}):
        for key, mask in zip(one["outputs"]["out_obj_ids"], one["outputs"]["out_binary_masks"], strict=True):
            if key == chosen:
                yield one["frame_index"], mask


def overlap(mask, box):
    """Compute the IOU of a mask and a box (left, top, width, height); without a box, the mask's area."""
    if box is None:
        return float(mask.sum())
    x, y, w, h = (round(number) for number in box)
    inside = float(mask[max(0, y) : y + h, max(0, x) : x + w].sum())
    return inside / (mask.sum() + w * h - inside)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("network", choices=("sam2", "sam3"))
    parser.add_argument("frames", type=Path)
    parser.add_argument("--box", type=float, nargs=4, metavar=("X", "Y", "W", "H"))
    parser.add_argument("--text")
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    names = sorted((path.stem for path in args.frames.glob("*.jpg")), key=int)
    args.out.mkdir(parents=True, exist_ok=True)
    device = "cuda" if torch.cuda.is_available() else "cpu"
    network, count = {"sam2": sam2, "sam3": sam3}[args.network], 0
    with torch.inference_mode(), torch.autocast(device, dtype=torch.bfloat16):
        for n, mask in network(args.frames, args.box, args.text):
            (args.out / f"{names[n]}.png").write_bytes(cv2.imencode(".png", 255 * mask.astype(np.uint8))[1].tobytes())
            count += 1
    print(f"{args.out}: {count} of {len(names)} frames")


if __name__ == "__main__":
    main()
