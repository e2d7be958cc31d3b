"""Numbers of strangers' files: what they make numpy warn of, and Python raise, is an error that names the file."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from getagrip.errors import GetagripError, InputError
from getagrip.io import plugins


@contextmanager
def convert_to_input_errors(path: Path) -> Iterator[None]:
    """Turn warnings of numpy, and all errors but those of files, into ``InputError``: what a file holds causes them."""
    try:
        with warnings.catch_warnings(), plugins.convert_base_exceptions():
            for warning in (RuntimeWarning, np.exceptions.ComplexWarning):
                warnings.simplefilter("error", warning)
            yield
    except (GetagripError, OSError):
        raise
    except Exception as error:
        kind = "" if isinstance(error, Warning) else f"{type(error).__name__}: "
        raise InputError(
            path, "", f"content that cannot be right ({kind}{error})", "as its program writes it"
        ) from error
