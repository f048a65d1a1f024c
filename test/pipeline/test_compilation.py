"""Everything compiled ahead: in two processes, noted when it is done, and shown while it goes on."""

from __future__ import annotations

import pytest

from lime_planner.cli import main as commands
from lime_planner.core import kernel_cache
from lime_planner.output import console
from lime_planner.pipeline import compilation


def test_two_processes_compile_and_a_note_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compilation, "all_compiled", lambda: False)  # the cache of the tests may be full already
    told: list[tuple[int, float]] = []
    assert compilation.ensure_compiled(lambda done, elapsed_s: told.append((done, elapsed_s)))
    assert kernel_cache.all_compiled()
    assert told[0] == (0, 0.0) and told == sorted(told)


def test_a_pipe_sees_how_far_the_compiler_is(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def ensure(report: compilation.Report) -> bool:
        for step in range(40):
            report(step, 0.25 * step)
        return True

    monkeypatch.setattr(kernel_cache, "all_compiled", lambda: False)
    monkeypatch.setattr(compilation, "ensure_compiled", ensure)
    assert console.compile_first()
    lines = capsys.readouterr().err.splitlines()
    assert [line.rpartition(": ")[2] for line in lines] == ["looking for what is not compiled yet, 0 s", "20 functions done, 5 s"]
    monkeypatch.setattr(kernel_cache, "all_compiled", lambda: True)
    assert not console.compile_first() and not capsys.readouterr().err
    assert commands.main(["compile"]) == 0 and "everything is compiled already" in capsys.readouterr().out


def test_a_part_that_fails_is_named_and_not_noted(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(compilation, "all_compiled", lambda: False)
    monkeypatch.setattr(compilation, "note_all_compiled", lambda: pytest.fail("it was not compiled"))
    assert compilation.ensure_compiled(robot="no_such_arm")
    assert "arm with 1, planners with 1" in capfd.readouterr().err
