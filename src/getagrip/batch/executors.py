"""The executors that a call can choose by ``--engine``, each from its own file."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from getagrip.batch.executor import Start
from getagrip.batch.pool import cores
from getagrip.batch.processes import Processes
from getagrip.errors import UsageError


def _local(workers: int | None, address: str | None) -> Start[object, object]:
    _without(address)
    return partial(Processes, workers or cores())


def _ray(workers: int | None, address: str | None) -> Start[object, object]:
    from getagrip.batch.on_ray import RayExecutor

    return partial(RayExecutor, workers, address)


def _slurm(workers: int | None, address: str | None) -> Start[object, object]:
    from getagrip.batch.on_slurm import SlurmExecutor

    _without(address)
    return partial(SlurmExecutor, workers)


def _without(address: str | None) -> None:
    if address is not None:
        raise UsageError("--address cannot be used without --engine ray")


ENGINES: dict[str, Callable[[int | None, str | None], Start[object, object]]] = {
    "local": _local, "ray": _ray, "slurm": _slurm,
}  # fmt: skip
"""By name: from the number of workers and the cluster's address, each None if not said, to the start of an executor."""
