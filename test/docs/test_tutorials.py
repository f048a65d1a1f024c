"""The tutorials run as they are written: their blocks in order, in a folder of their own, within a bounded time.

A fenced block's language and title say what happens to it:

- `bash`, `python` without a title: run, in the page's folder; the Python blocks of a page share their names. Commands `lime-planner`
  that stand alone run in this process, through the command's own entry, which saves their imports;
- any language with a file's name as its title: written to that file, and checked as far as its language can be;
- a title of `NOT_RUN`, which readers see above the block: not run, but its syntax is checked;
- `text`, right after what is run: all that it prints, in which `...` stands for any words. It is compared: words, and numbers to their last
  digit, but for the time that planning took. What Python prints is always shown.
"""

from __future__ import annotations

import ast
import os
import re
import shlex
import signal
import subprocess
import sys
import time
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import yaml
from domains import DOMAIN
from shown import is_shown

from lime_planner.cli import main as cli

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted((ROOT / "docs" / "tutorials").glob("*.md"))
NOT_RUN = ("once", "needs the arm", "needs the network", "needs a ROS 2 desktop", "opens a page in the browser", "takes a minute")
BLOCK_S = 300.0  # a fresh checkout compiles kernels for a minute or two


@dataclass(frozen=True)
class Block:
    page: Path
    line: int
    language: str
    title: str
    text: str

    @property
    def where(self) -> str:
        return f"{self.page.name}:{self.line}"


def blocks_of(page: Path) -> list[Block]:
    found, lines = [], page.read_text(encoding="utf-8").splitlines()
    start: tuple[int, str, str] | None = None
    for number, line in enumerate(lines, 1):
        if not line.startswith("```"):
            continue
        if start is None:
            match = re.fullmatch(r'```(\w+)(?: title="([^"]+)")?', line)
            assert match, f"{page.name}:{number}: a block says its language, and a title or nothing: {line}"
            start = (number, match[1], match[2] or "")
        else:
            found.append(Block(page, start[0], start[1], start[2], "\n".join(lines[start[0] : number - 1]) + "\n"))
            start = None
    assert start is None, f"{page.name}: a block without an end"
    return found


def check_syntax(block: Block) -> None:
    """Check what is not run."""
    if block.language == "bash":
        done = subprocess.run(["bash", "-n"], input=block.text, capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"{block.where}: {done.stderr}"
    elif block.language == "python":
        ast.parse(block.text, block.where)
    elif block.language == "yaml":
        assert yaml.safe_load(block.text), block.where
    elif block.language == "xml":
        ET.fromstring(block.text)


def environment() -> dict[str, str]:
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    python = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH", "")]))
    return {**os.environ, "PATH": path, "PYTHONPATH": python, "ROS_DOMAIN_ID": str(DOMAIN), "PYTHONUNBUFFERED": "1"}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_page_runs_as_written(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    (tmp_path / "config").symlink_to(ROOT / "config")
    names: dict[str, object] = {"__name__": "__main__"}
    groups: list[int] = []
    blocks = blocks_of(page)
    ran, wrong = 0, []
    printed: str | None = None  # by the block before
    try:
        for number, block in enumerate(blocks):
            if block.language == "text":
                assert printed is not None, f"{block.where}: output of what is not run"
                if not is_shown(block.text, printed):
                    wrong.append(f"{block.where} shows\n{block.text}\nand printed is\n{printed}")
                continue
            printed = None
            if block.title in NOT_RUN or (block.title and "." in block.title):
                check_syntax(block)
                if block.title not in NOT_RUN:
                    (tmp_path / block.title).write_text(block.text, encoding="utf-8")
            elif block.language == "python":
                assert not block.title, f"{block.where}: unknown title {block.title!r}"
                capsys.readouterr()
                exec(compile(block.text, block.where, "exec"), names)
                printed = capsys.readouterr().out
                shown = number + 1 < len(blocks) and blocks[number + 1].language == "text"
                assert shown or not printed, f"{block.where}: what it prints is not shown:\n{printed}"
                ran += 1
            elif block.language == "bash":
                assert not block.title, f"{block.where}: unknown title {block.title!r}"
                capsys.readouterr()
                printed = capsys.readouterr().out if run_here(block) else run_bash(block, groups)
                ran += 1
            else:
                raise AssertionError(f"{block.where}: {block.language} is neither run, nor a file, nor output")
    finally:
        for group in groups:
            end_group(group)
    assert not wrong, "\n".join(wrong)
    assert ran >= 1


def run_here(block: Block) -> bool:
    """Run a block of nothing but `lime-planner` commands through the command's own entry; False if there is anything else in it."""
    commands = [shlex.split(line, comments=True) for line in block.text.replace("\\\n", " ").splitlines()]
    if not all(words and words[0] == "lime-planner" and not {"|", "||", "&&", "&", ">"} & set(words) for words in commands):
        return False
    before = [(number, signal.getsignal(number)) for number in (signal.SIGINT, signal.SIGTERM)]
    try:
        for words in commands:
            assert cli.main(words[1:]) == 0, f"{block.where}: {shlex.join(words)}"
    finally:
        for number, handler in before:  # a plan puts its own in their place
            signal.signal(number, handler)
    return True


def run_bash(block: Block, groups: list[int]) -> str:
    """Run a block in a process group of its own, which may outlive it: background processes stay until the page's end. What it printed."""
    log = Path(f"block-{block.line}.log")
    with log.open("w") as out:
        process = subprocess.Popen(
            ["bash", "-euo", "pipefail", "-c", block.text], env=environment(), stdout=out, stderr=subprocess.STDOUT, start_new_session=True
        )
    groups.append(process.pid)
    try:
        code = process.wait(BLOCK_S)
    except subprocess.TimeoutExpired:
        code = None
    logs = "\n".join(path.read_text(encoding="utf-8", errors="replace") for path in sorted(Path().glob("*.log")))
    assert code == 0, f"{block.where}: {'took too long' if code is None else f'exit status {code}'}\n{logs}"
    return log.read_text(encoding="utf-8", errors="replace")


def end_group(group: int) -> None:
    """End what a block left running, and wait until it is gone."""
    for number, patience_s in ((signal.SIGTERM, 10.0), (signal.SIGKILL, 2.0)):
        deadline = time.monotonic() + patience_s
        try:
            os.killpg(group, number)
            while time.monotonic() < deadline:
                os.killpg(group, 0)
                time.sleep(0.05)
        except ProcessLookupError:
            return


def test_what_is_shown_is_what_is_printed_to_the_last_digit_but_for_times() -> None:
    shown = "SUCCEEDED: 13 waypoints over 4.61 rad, 0.141 rad\nof it among leaves, planned in 0.91 s\n"
    assert is_shown(shown, "SUCCEEDED: 13 waypoints over 4.61 rad, 0.141 rad of it among leaves, planned in 1.2 s")
    assert is_shown(shown, shown.replace("4.61", "4.62"))  # rounded the other way
    for now in ("4.63", "4.6", "5.61"):
        assert not is_shown(shown, shown.replace("4.61", now)), now
    assert not is_shown(shown, shown.replace("13", "14"))
    assert not is_shown(shown, shown.replace("SUCCEEDED", "NO_PATH"))
    assert not is_shown(shown, shown + "and more")
    assert not is_shown(shown, "SUCCEEDED:")
    assert not is_shown(shown, "")
    assert is_shown("a ┃ 0.50\n━━━╇━━━━", "a   0.51")
    assert is_shown("SUCCEEDED: ... leaves, ...\nGOAL_IN_STEM: ...", "SUCCEEDED: 3 leaves, 4\nGOAL_IN_STEM: 5")
    assert not is_shown("SUCCEEDED: ... leaves, ...\nGOAL_IN_STEM: ...", "SUCCEEDED: 3 leaves, 4\nNO_PATH: 5")
    assert is_shown("... b", "a b") and is_shown("a ... b", "a b") and not is_shown("a b ... b", "a b") and not is_shown("... b", "a b c")


def test_commands_of_blocks_that_are_not_run_name_what_exists() -> None:
    """Topics, services, launch files and parameters of the pages are the product's."""
    from lime_planner.core.parameters import NODE_PARAMETERS, PARAMETERS

    interfaces = (ROOT / "docs" / "reference" / "interfaces.md").read_text(encoding="utf-8")
    launched, named = 0, 0
    for block in [block for page in PAGES for block in blocks_of(page) if block.language == "bash"]:
        for launch in re.findall(r"ros2 launch lime_planner (\S+)", block.text):
            assert (ROOT / "launch" / launch).is_file(), f"{block.where}: {launch}"
            launched += 1
        for service in re.findall(r"ros2 service call /lime_planner/(\w+)", block.text):
            assert f"`~/{service}`" in interfaces, f"{block.where}: {service}"
            named += 1
        for parameter in re.findall(r"ros2 param set /lime_planner (\w+)", block.text):
            assert parameter in {**PARAMETERS, **NODE_PARAMETERS}, f"{block.where}: {parameter}"
            named += 1
        if block.title in NOT_RUN:
            for command in re.findall(r"^lime-planner (.+)$", block.text.replace("\\\n", " "), flags=re.MULTILINE):
                words = shlex.split(command, comments=True)
                assert cli.build_parser(words).parse_args(words), f"{block.where}: {command}"
                named += 1
    assert launched and named


def test_parameter_files_of_the_pages_are_accepted() -> None:
    from lime_planner.ros.parameters import snapshot_from

    files = [block for page in PAGES for block in blocks_of(page) if block.language == "yaml"]
    for block in files:
        snapshot = snapshot_from(yaml.safe_load(block.text)["/**/lime_planner"]["ros__parameters"])
        assert snapshot.node.motion_enabled is False, block.where
    assert files


def test_no_block_forbids_motion_while_one_runs() -> None:
    """Services that move the arm answer when the motion is sent, and forbidding motion stops it: the reader waits in between."""
    moving = 0
    for block in [block for page in PAGES for block in blocks_of(page) if block.language == "bash"]:
        may_move = False
        for line in block.text.splitlines():
            if re.search(r"(lime_planner/|call\.py )(plan|execute|retreat)\b(?! \|\|)", line):
                may_move, moving = True, moving + 1
            elif re.search(r"(lime_planner/|call\.py )stop\b", line):
                may_move = False
            assert not (may_move and re.search(r"motion_enabled false", line)), f"{block.where}: {line}"
    assert moving >= 3


def test_the_kinova_pages_target_is_in_the_arms_frame_and_within_reach() -> None:
    """What readers paste: published again and again, for it ages, and where the arm can go by the page's own parameters."""
    from lime_planner.core.geometry import pose_to_matrix
    from lime_planner.robot.ik import solve_ik
    from lime_planner.robot.model import load_robot
    from lime_planner.ros.parameters import snapshot_from

    blocks = blocks_of(ROOT / "docs" / "tutorials" / "real-kinova.md")
    [published] = [block.text for block in blocks if "topic pub" in block.text]
    assert "ros2 topic pub -r 1 /grasp_target geometry_msgs/msg/PoseStamped" in published
    msg = yaml.safe_load(re.search(r'"(\{.*\})"', published, flags=re.DOTALL)[1])  # type: ignore[index]
    [file] = [block.text for block in blocks if block.title == "my_arm.yaml"]
    values = yaml.safe_load(file)["/**/lime_planner"]["ros__parameters"]
    settings = snapshot_from(values).plan
    assert msg["header"]["frame_id"] == settings.planning_frame == "j2s6s200_link_base"
    position, turn = ([msg["pose"][key].get(name, 0.0) for name in names] for key, names in (("position", "xyz"), ("orientation", "xyzw")))
    low, high = settings.workspace_box[:3], settings.workspace_box[3:]
    assert all(a < p < b for a, p, b in zip(low, position, high, strict=True))
    for model in ("j2s6s200", "j2n6s300"):
        robot = load_robot(f"kinova_{model}", planning_frame=f"{model}_link_base")
        T_base_tool = pose_to_matrix([*position, *turn])
        assert T_base_tool[1, 2] < -0.999  # the palm looks ahead
        assert len(solve_ik(robot, T_base_tool, robot.home, np.random.default_rng(0)).solutions), model
        home = robot.forward(robot.home)[:3, 3]
        assert all(a < p < b for a, p, b in zip(low, home, high, strict=True)), model


def test_the_rehearsals_plant_stands_where_the_demos_does() -> None:
    """The plant is in the model's root frame, the planner in the driver's: one static transform, the model's own turn, joins them."""
    from lime_planner.robot.model import load_robot
    from lime_planner.ros.inputs.frames import StaticFrames

    [script] = [block.text for block in blocks_of(ROOT / "docs" / "tutorials" / "real-kinova.md") if block.title == "rehearse.sh"]
    [transform] = yaml.safe_load(re.search(r"static_transforms:='(.*)'", script)[1])  # type: ignore[index]
    T_arm_base = StaticFrames([transform]).find("j2s6s200_link_base", "base")
    assert T_arm_base is not None
    at_root, at_arm = load_robot("kinova_j2s6s200"), load_robot("kinova_j2s6s200", planning_frame="j2s6s200_link_base")
    np.testing.assert_allclose(T_arm_base @ at_root.forward(at_root.home), at_arm.forward(at_arm.home), atol=1e-6)


def test_the_kinova_page_the_launch_file_and_the_configurations_agree() -> None:
    """One driver, one set of names."""
    page = (ROOT / "docs" / "tutorials" / "real-kinova.md").read_text(encoding="utf-8")
    launch = (ROOT / "launch" / "kinova.launch.py").read_text(encoding="utf-8")
    for topic in ("_driver/out/joint_state", "_driver/trajectory_controller/command"):
        assert f"/j2s6s200{topic}" in page
        assert f"/{{model}}{topic}" in launch
        for model in ("j2s6s200", "j2n6s300"):
            text = (ROOT / "config" / f"kinova_{model}.yaml").read_text(encoding="utf-8")
            assert f"/{model}{topic}" in text
            values = yaml.safe_load(text)["/**/lime_planner"]["ros__parameters"]
            assert values["motion_enabled"] is False and values["controller"] == "kinova"
            assert values["arm_joints"] == [f"{model}_joint_{i}" for i in range(1, 7)]
