"""Where files go: links are followed, pipes and devices written to, modes kept, and nothing is made that was not asked for."""

from __future__ import annotations

import os
import stat
import threading
from pathlib import Path

import pytest

from lime_planner.core.atomic_files import check_writable, make_folder, replacing, write_json
from lime_planner.core.errors import ParameterError


def write(path: Path, text: str = "new") -> None:
    with replacing(path) as temporary:
        assert temporary.suffix == path.suffix
        temporary.write_text(text)


def test_symbolic_links_stay_and_lead_on(tmp_path: Path) -> None:
    (tmp_path / "far").mkdir()
    real = tmp_path / "far" / "real.json"
    real.write_text("old")
    real.chmod(0o640)
    (tmp_path / "one").symlink_to(real)
    (tmp_path / "two.json").symlink_to("one")
    write(tmp_path / "two.json")
    assert (tmp_path / "two.json").is_symlink() and (tmp_path / "one").is_symlink()
    assert real.read_text() == "new"
    assert stat.S_IMODE(real.stat().st_mode) == 0o640
    (tmp_path / "to_come").symlink_to(tmp_path / "far" / "fresh")  # one that leads to a file that is not there yet
    write(tmp_path / "to_come")
    assert (tmp_path / "to_come").is_symlink() and (tmp_path / "far" / "fresh").read_text() == "new"
    assert sorted(path.name for path in (tmp_path / "far").iterdir()) == ["fresh", "real.json"]


def test_new_files_follow_the_umask(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        write(tmp_path / "a.json")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "a.json").stat().st_mode) == 0o640


def test_named_pipes_are_written_to(tmp_path: Path) -> None:
    pipe, got = tmp_path / "pipe.json", []
    os.mkfifo(pipe)
    (tmp_path / "link").symlink_to(pipe)
    for path in (pipe, tmp_path / "link"):
        reader = threading.Thread(target=lambda: got.append(pipe.read_text()))
        reader.start()
        write_json(path, {"a": 1})
        reader.join(10)
    assert got == ['{\n "a": 1\n}\n'] * 2
    assert stat.S_ISFIFO(pipe.stat().st_mode)


def test_open_descriptors_are_written_where_they_stand(tmp_path: Path) -> None:
    with (tmp_path / "log").open("w") as file:
        file.write("before\n")
        file.flush()
        for name in (f"/dev/fd/{file.fileno()}", f"/proc/self/fd/{file.fileno()}"):
            write(Path(name), "x\n")
        file.write("after\n")
    assert (tmp_path / "log").read_text() == "before\nx\nx\nafter\n"
    with pytest.raises(OSError, match="Bad file descriptor"):
        write(Path("/dev/fd/987"))


def test_devices(tmp_path: Path) -> None:
    write(Path("/dev/null"))
    assert stat.S_ISCHR(Path("/dev/null").stat().st_mode)
    with pytest.raises(ParameterError, match=r"/dev/full: cannot be written \(No space left on device\)"):
        write_json("/dev/full", {})


def test_what_cannot_be_written_is_named_and_nothing_is_left(tmp_path: Path) -> None:
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "file").write_text("")
    cases = {
        tmp_path: "it is a folder",
        tmp_path / "loop": "Too many levels of symbolic links",
        tmp_path / "file" / "a.json": "Not a directory",
        tmp_path / ("n" * 300): "File name too long",
    }
    for path, words in cases.items():
        for attempt in (lambda path=path: write_json(path, {}), lambda path=path: check_writable(path)):
            with pytest.raises(ParameterError, match=words):
                attempt()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "loop"]


def test_a_failure_leaves_the_old_file(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text("old")
    check_writable(tmp_path / "a.json")
    with pytest.raises(ZeroDivisionError), replacing(tmp_path / "a.json") as temporary:
        temporary.write_text("half")
        raise ZeroDivisionError
    assert (tmp_path / "a.json").read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["a.json"]
    write(tmp_path / ("n" * 250 + ".json"))  # as long as a name may be


def test_folders_are_made_aloud(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    check_writable(tmp_path / "x" / "y" / "a.json")
    assert not (tmp_path / "x").exists()
    write(tmp_path / "x" / "y" / "a.json")
    assert capsys.readouterr().err == f"made the folder {tmp_path}/x/y\n"
    assert make_folder(tmp_path / "a" / "b").is_dir()
    assert capsys.readouterr().err == f"made the folder {tmp_path}/a/b\n"
    make_folder(tmp_path / "a" / "b")
    assert capsys.readouterr().err == ""
    (tmp_path / "file").write_text("")
    with pytest.raises(FileExistsError):
        make_folder(tmp_path / "file")
