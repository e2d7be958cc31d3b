"""Work in the background: the new ends the old."""

from __future__ import annotations

import threading
import time

from getagrip.errors import GetagripError
from getagrip.studio.jobs import BackgroundJob, BackgroundQueue


def test_new_work_on_a_grasp_ends_the_old_and_errors_are_reported() -> None:
    background, begun = BackgroundQueue(), threading.Event()

    def forever(job: BackgroundJob) -> str:
        begun.set()
        while True:
            job.report(1, 2)
            time.sleep(0.005)

    def wrong(job: BackgroundJob) -> str:
        raise GetagripError("no joints")

    def broken(job: BackgroundJob) -> str:
        raise ZeroDivisionError

    background.start("a", "propagate", forever)
    old = background.job("a")
    assert begun.wait(5)
    background.start("a", "propagate", wrong)
    background.start("b", "files", broken)
    background.start("c", "files", lambda job: "made")
    background.start("d", "files", forever)
    for _ in range(1000):
        if (job := background.job("d")) and job.state == "running":
            break
        time.sleep(0.005)
    assert old is not None
    assert old.state == "cancelled"
    jobs = {key: background.job(key) for key in "abc"}
    assert [job.state for job in jobs.values() if job] == ["failed", "failed", "done"]
    assert [job.message for job in jobs.values() if job][0::2] == ["no joints", "made"]
    background.close()  # ends what runs for ever
