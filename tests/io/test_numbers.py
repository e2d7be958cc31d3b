"""Numbers of strangers' files: whatever they cause is one error that names the file."""

from __future__ import annotations

import signal
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from getagrip.errors import InputError, UsageError
from getagrip.io import processes
from getagrip.io.arrays import convert_to_input_errors


class Stop(BaseException):
    """As trio's, or pytest's own."""


@pytest.fixture(autouse=True)
def _as_in_the_program() -> Iterator[None]:
    before = signal.getsignal(signal.SIGINT)
    processes.raise_on_interrupt()
    yield
    signal.signal(signal.SIGINT, before)


def test_where_interrupts_are_not_known_apart_they_stay() -> None:
    signal.signal(signal.SIGINT, signal.default_int_handler)
    with pytest.raises(KeyboardInterrupt), convert_to_input_errors(Path("a.txt")):
        raise KeyboardInterrupt


def leaves(error: BaseException) -> Callable[[], object]:
    def raising() -> None:
        raise error

    return raising


@pytest.mark.parametrize(
    ("work", "says"),
    [
        (lambda: np.zeros(4) / np.linalg.norm(np.zeros(4)), "invalid value encountered"),
        (lambda: np.array([1e300]) ** 2, "overflow"),
        (lambda: np.ones(1, complex).astype(float), "imaginary"),
        (lambda: float(10**400), "OverflowError"),
        (lambda: {}["a"], "KeyError"),
        (lambda: np.mean(np.zeros(0)), "empty"),
        (leaves(RecursionError("deep")), "RecursionError: deep"),
        (leaves(Stop("stopped")), "Stop: stopped"),
        (leaves(SystemExit(3)), "SystemExit: 3"),
        (leaves(KeyboardInterrupt()), "KeyboardInterrupt"),  # nobody has pressed a key
    ],
)
def test_what_goes_wrong_names_the_file(work: Callable[[], object], says: str) -> None:
    before = list(warnings.filters)
    with (
        pytest.raises(InputError, match=r"^a\.txt must be as its program writes it") as caught,
        convert_to_input_errors(Path("a.txt")),
    ):
        work()
    assert says in str(caught.value)
    assert list(warnings.filters) == before


@pytest.mark.parametrize("error", [UsageError("a"), InputError("b.txt", "", "c", "d"), FileNotFoundError("e")])
def test_what_says_enough_stays_as_it_is(error: Exception) -> None:
    with pytest.raises(type(error)) as caught, convert_to_input_errors(Path("a.txt")):
        raise error
    assert caught.value is error


def test_an_interrupt_stays_one() -> None:
    with pytest.raises(KeyboardInterrupt), convert_to_input_errors(Path("a.txt")):
        signal.raise_signal(signal.SIGINT)
