"""Trials on a Dask cluster: scheduler and workers in processes of their own on loopback, one of them killed midway."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("distributed", reason="the extra `cluster` is not installed")

from lime_planner.core.errors import ParameterError
from lime_planner.experiments.lime.trials import LimeOptions, plan_of
from lime_planner.experiments.runs import cluster
from lime_planner.experiments.runs.cluster import ClusterError, carry_out, run_on_cluster
from lime_planner.experiments.runs.results_file import collect

WORKERS = 3
OPTIONS = LimeOptions(trials=8, plants=0, sensitivity_trials=0, iterations=1500)


class Cluster:
    """A scheduler and its workers."""

    def __init__(self, folder: Path) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        self.folder, self.address = folder, f"tcp://127.0.0.1:{port}"
        self.scheduler = self._start("dask_scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard", "--no-jupyter")
        self.workers = [self.add_worker() for _ in range(WORKERS)]

    def _start(self, module: str, *arguments: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", f"distributed.cli.{module}", *arguments]
        here = Path(__file__).resolve().parent
        environment = {**os.environ, "PYTHONPATH": f"{here.parent}{os.pathsep}{here}"}
        with open(self.folder / "log.txt", "ab") as log:
            return subprocess.Popen(command, stdout=log, stderr=log, cwd=self.folder, env=environment)

    def add_worker(self) -> subprocess.Popen[bytes]:
        where = ("--host", "127.0.0.1", "--local-directory", str(self.folder))
        return self._start("dask_worker", self.address, "--nthreads", "1", "--no-nanny", "--no-dashboard", *where)

    def close(self) -> None:
        for process in (*self.workers, self.scheduler):
            process.kill()
            process.wait()


@pytest.fixture(scope="module")
def dask(tmp_path_factory: Any) -> Iterator[Cluster]:
    running = Cluster(tmp_path_factory.mktemp("dask"))
    try:
        yield running
    finally:
        running.close()


def without_times(results: dict[str, Any]) -> list[dict[str, Any]]:
    return [{k: v for k, v in trial.items() if k != "time_s"} for trial in results["trials"]]


def test_a_killed_worker_changes_nothing(dask: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = plan_of(OPTIONS)
    alone, _ = collect(plan, tmp_path / "alone.json", jobs=1, resume=False)
    original, arrived = cluster.run_on_cluster, []

    def with_accident(function: Any, tasks: Any, on_result: Any, **rest: Any) -> bool:
        def and_kill(result: Any) -> None:
            on_result(result)
            arrived.append(result)
            if len(arrived) == 6:  # three workers are busy with what is left
                dask.workers[0].send_signal(signal.SIGKILL)

        return original(function, tasks, and_kill, **rest)

    monkeypatch.setattr(cluster, "run_on_cluster", with_accident)
    together, complete = collect(plan, tmp_path / "together.json", jobs=1, resume=False, scheduler=dask.address)
    assert complete and together["complete"]
    assert dask.workers[0].wait(10) == -signal.SIGKILL
    assert len(together["trials"]) == 24
    assert without_times(together) == without_times(alone)


def nap(seconds: float) -> tuple[float, int]:
    time.sleep(seconds)
    return seconds, os.getpid()


def fail(number: int) -> int:
    raise ValueError(f"trial {number} is impossible")


def wait_for(*marks: Path) -> None:
    until = time.monotonic() + 30.0
    while not all(mark.exists() for mark in marks) and time.monotonic() < until:
        time.sleep(0.01)


def fail_in_the_middle(task: tuple[Path, int]) -> int:
    """Trial 1 ends first, then trial 0 with an error, then the rest: files say who has ended, so that load changes no order."""
    folder, number = task
    if number != 1:
        wait_for(folder / ("1" if number == 0 else "0"))
        time.sleep(0.3)
    (folder / str(number)).touch()
    if number == 0:
        raise ValueError("trial 0 is impossible")
    return number


def test_an_error_comes_after_what_the_others_finished(dask: Cluster, tmp_path: Path) -> None:
    done: list[int] = []
    tasks = [(tmp_path, number) for number in range(6)]

    def slow(number: int) -> None:
        if not done:  # meanwhile the error arrives, and after it all the rest
            wait_for(*(tmp_path / str(n) for n in range(6)))
            time.sleep(1.0)
        done.append(number)

    with pytest.raises(ValueError, match="trial 0 is impossible"):
        run_on_cluster(fail_in_the_middle, tasks, slow, scheduler=dask.address, description="errors")
    assert done[0] == 1 and sorted(done) == [1, 2, 3, 4, 5]


def die(number: int) -> int:
    os._exit(1)


def test_work_is_shared_and_errors_come_back(dask: Cluster, monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[tuple[float, int]] = []
    assert run_on_cluster(nap, [0.05] * 30, done.append, scheduler=dask.address, description="naps")
    assert len(done) == 30
    assert len({pid for _, pid in done}) >= 2
    assert os.getpid() not in {pid for _, pid in done}
    with pytest.raises(ValueError, match="trial 1 is impossible"):
        run_on_cluster(fail, [1], done.append, scheduler=dask.address, description="errors")
    monkeypatch.setattr(cluster, "__version__", "0.0.0")
    with pytest.raises(ClusterError, match=r"a worker has lime_planner .*, the trials come from 0\.0\.0"):
        run_on_cluster(nap, [0.0], done.append, scheduler=dask.address, description="another version")
    with pytest.raises(ClusterError):
        carry_out("0.0.1", nap, 0.0)


def test_nobody_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "CONNECT_TIMEOUT_S", 0.5)
    with pytest.raises(ParameterError, match="no Dask scheduler answers there"):
        run_on_cluster(nap, [0.0], print, scheduler="tcp://127.0.0.1:1", description="nobody")


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("nonsense", "missing port"),
        ("nonsense://x", "unknown address scheme 'nonsense'"),
        ("tcp://host", "missing port"),
        ("tcp://:8786", "no host"),
        ("host:many", "many"),
        ("tls://host:99999", "port 99999; allowed are 1 to 65535"),
    ],
)
def test_what_is_no_address_is_refused_at_once(address: str, words: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("distributed.Client", lambda *_, **__: pytest.fail("a client was made"))
    with pytest.raises(ParameterError) as refused:
        run_on_cluster(nap, [0.0], print, scheduler=address, description="nobody")
    assert str(refused.value).startswith(f"--scheduler {address}: is no address like tcp://host:8786 (") and words in str(refused.value)
