"""The two networks' files: fetched once, by pip, from a release of MediaPipe on the user's package index.

The files are Apache-2.0 (Google). Each is checked by its hash whenever it is loaded, wherever it comes from.
"""

from __future__ import annotations

import os
import subprocess
import zipfile
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryDirectory

from getagrip.errors import InputError, UsageError
from getagrip.io import files, own_python, user_folders
from getagrip.landmarks.nets import Nets, open_nets

MODEL_FILE_HASHES = {
    "palm_detection_full.tflite": "1b14e9422c6ad006cde6581a46c8b90dd573c07ab7f3934b5589e7cea3f89a54",
    "hand_landmark_full.tflite": "11c272b891e1a99ab034208e23937a8008388cf11ed2a9d776ed3d01d0ba00e3",
}
"""Names and SHA-256."""
MEDIAPIPE_RELEASE = "mediapipe==0.10.21"
MEDIAPIPE_WHEEL = ("manylinux_2_28_x86_64", "3.11", "05dc4a9e593655a79558d05d6227d31018c2537a4bd3362b51e230cf22aecfe3")
"""Platform, Python and SHA-256 of the wheel. It is unpacked, never installed, so one wheel serves every machine."""
MAX_MODEL_BYTES = 16 * 2**20
"""Bytes of a file."""
MODEL_INSTALL_HINT = "getagrip doctor --fetch hands, or --models FOLDER with these files"


def model_folder() -> Path:
    """Return the folder of the files: ``GETAGRIP_MODELS``, else in the user's cache."""
    own = os.environ.get("GETAGRIP_MODELS")
    return Path(own) if own else user_folders.cache_folder() / "models"


def missing_model_files(folder: Path | None = None) -> list[str]:
    """List the files that a folder lacks; without one, the cache."""
    return [name for name in MODEL_FILE_HASHES if not ((folder or model_folder()) / name).is_file()]


def load_models(folder: Path | None = None) -> Nets:
    """Load the networks, from files in a folder or from the cache.

    Raises ``InputError`` for a missing file or one with another hash, ``UsageError`` if nothing can run the networks.
    """
    palm, hand = (
        _read_model_file((folder or model_folder()) / name, expected) for name, expected in MODEL_FILE_HASHES.items()
    )
    return open_nets(palm, hand)


def _read_model_file(path: Path, expected: str) -> bytes:
    """Read and check a file of the table. Raises ``InputError``."""
    if not path.is_file():
        raise InputError(path, "", "no such file", f"MediaPipe's hand model; {MODEL_INSTALL_HINT}")
    content = files.read_bytes(path, MAX_MODEL_BYTES)
    if (found := sha256(content).hexdigest()) != expected:
        raise InputError(
            path,
            "",
            f"another file (SHA-256 {found[:12]}...)",
            f"{path.name} of {MEDIAPIPE_RELEASE} ({MODEL_INSTALL_HINT})",
        )
    return content


def download_models() -> list[Path]:
    """Put the files into the cache and return their paths. Existing files are kept.

    pip downloads the wheel from the package index that it is configured for; the hash must be the one above. Raises
    ``UsageError`` with pip's message if the download fails, ``InputError`` for another wheel.
    """
    folder = model_folder()
    if missing_model_files(folder):
        with TemporaryDirectory() as temporary:
            wheel = _download_wheel(Path(temporary))
            folder.mkdir(parents=True, exist_ok=True)
            unpack_wheel(wheel, folder)
    for name, expected in MODEL_FILE_HASHES.items():
        _read_model_file(folder / name, expected)
    return [folder / name for name in MODEL_FILE_HASHES]


def _download_wheel(folder: Path) -> Path:
    platform, python, expected = MEDIAPIPE_WHEEL
    requirement = folder / "wheel.txt"
    requirement.write_text(f"{MEDIAPIPE_RELEASE} --hash=sha256:{expected}\n")
    options = ["--no-deps", "--only-binary", ":all:", "--platform", platform, "--python-version", python]
    words = own_python.python_command("-m", "pip", "--disable-pip-version-check", "--quiet", "download", *options)
    words += ["--require-hashes", "-r", str(requirement), "--dest", str(folder)]
    done = subprocess.run(words, capture_output=True, text=True, errors="replace", check=False)
    wheels = sorted(folder.glob("*.whl"))
    if done.returncode or not wheels:
        said = (done.stderr.strip() or "it said nothing").splitlines()[-1]
        advice = "or copy the two files by hand and name their folder with --models"
        raise UsageError(f"pip could not download {MEDIAPIPE_RELEASE}: {said}; try again with a network, {advice}")
    return wheels[0]


def unpack_wheel(wheel: Path, folder: Path) -> None:
    """Take the files out of a wheel; each one's hash is checked before it is written. Raises ``InputError``."""
    try:
        with zipfile.ZipFile(wheel) as archive:
            inside = {Path(member.filename).name: member for member in archive.infolist()}
            for name, expected in MODEL_FILE_HASHES.items():
                if name not in inside or inside[name].file_size > MAX_MODEL_BYTES:
                    raise InputError(wheel, name, "no such file in it", f"the wheel of {MEDIAPIPE_RELEASE}")
                content = archive.read(inside[name])
                if sha256(content).hexdigest() != expected:
                    raise InputError(wheel, name, "another file", f"the one of {MEDIAPIPE_RELEASE}")
                with files.new_file(folder / name) as path:
                    path.write_bytes(content)
    except zipfile.BadZipFile as error:
        raise InputError(wheel, "", "a damaged file", f"the wheel of {MEDIAPIPE_RELEASE}") from error
