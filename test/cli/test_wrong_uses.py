"""More than two hundred wrong uses: each ends in one sentence of ours, and none of a library's reaches the user."""

from __future__ import annotations

import io
import json
import pickle
import re
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lime_planner.cli import main as cli

#: What only a library, or an exception that nobody meant to show, would say.
FOREIGN = re.compile(
    r"allow_pickle|pickle|Traceback|\[Errno|numpy|np\.|dtype|has no attribute|NoneType|\b\w+Error\b(?<!BAD_INPUT)|zipfile|BadZip|"
    r"open3d|TensorMap|<class|<built-in|could not convert|invalid literal|unpack|argument of type|codec can't|Expecting \w+|line 1 column|"
    r"AnyReader|RecursionError|subscriptable|RCL|Warning:"
)


def npz(**arrays: Any) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


def npy(array: Any) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


P, L = np.full((3, 3), 0.4, np.float32), np.array([0, 1, 1], np.uint8)
GOOD = npz(points=P, labels=L)
OBJECTS = np.array([{"a": 1}, None, [1]], dtype=object)


def zipped(**members: bytes) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, content in members.items():
            archive.writestr(f"{name}.npy", content)
    return stream.getvalue()


PLY = b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nproperty int label\nend_header\n"
PCD = b"VERSION .7\nFIELDS x y z label\nSIZE 4 4 4 4\nTYPE F F F U\nCOUNT 1 1 1 1\nWIDTH 1\nHEIGHT 1\nPOINTS 1\nDATA ascii\n"

#: Files that are no scenes.
FILES: dict[str, bytes] = {
    "empty.npz": b"",
    "text.npz": b"x y z\n1 2 3\n",
    "random.npz": np.random.default_rng(0).bytes(5000),
    "half.npz": GOOD[: len(GOOD) // 2],
    "array.npz": npy(P),
    "dumped.npz": pickle.dumps({"points": [1, 2, 3]}),
    "objects.npz": npz(points=OBJECTS, labels=L),
    "object_labels.npz": npz(points=P, labels=OBJECTS),
    "object_target.npz": npz(points=P, labels=L, target_pose=OBJECTS),
    "nothing.npz": npz(other=P),
    "no_labels.npz": npz(points=P),
    "flat.npz": npz(points=P.ravel(), labels=L),
    "planar.npz": npz(points=P[:, :2], labels=L),
    "fewer.npz": npz(points=P, labels=L[:2]),
    "words.npz": npz(points=np.full((3, 3), "a"), labels=L),
    "word_labels.npz": npz(points=P, labels=np.array(["leaf", "stem", "stem"])),
    "complex.npz": npz(points=P.astype(complex), labels=L),
    "half_labels.npz": npz(points=P, labels=L + 0.5),
    "six.npz": npz(points=P, labels=L, target_pose=np.zeros(6)),
    "nan_target.npz": npz(points=P, labels=L, target_pose=np.full(7, np.nan)),
    "zero_target.npz": npz(points=P, labels=L, target_pose=np.zeros(7)),
    "costs.npz": npz(points=P, labels=L, permeability_cost=np.ones(2)),
    "negative_costs.npz": npz(points=P, labels=L, permeability_cost=-np.ones(3)),
    "bad_member.npz": zipped(points=b"not an array", labels=npy(L)),
    "truncated_member.npz": zipped(points=npy(P)[:-5], labels=npy(L)),
    "no_ply.ply": b"solid thing\n",
    "empty.ply": b"",
    "headless.ply": PLY[:60],
    "short.ply": PLY,
    "word.ply": PLY + b"a b c 1\n",
    "no_label.ply": PLY.replace(b"property int label\n", b"") + b"1 2 3\n",
    "float_label.ply": PLY.replace(b"int label", b"float label") + b"1 2 3 0.5\n",
    "no_vertex.ply": PLY.replace(b"vertex", b"face"),
    "strange.ply": PLY.replace(b"ascii 1.0", b"runes 1.0") + b"1 2 3 1\n",
    "type.ply": PLY.replace(b"float x", b"quaternion x") + b"1 2 3 1\n",
    "count.ply": PLY.replace(b"vertex 1", b"vertex many") + b"1 2 3 1\n",
    "binary.ply": PLY.replace(b"ascii", b"binary_little_endian") + b"1",
    "empty.pcd": b"",
    "no_pcd.pcd": b"hello\n",
    "short.pcd": PCD,
    "word.pcd": PCD + b"a b c 1\n",
    "no_label.pcd": PCD.replace(b" label", b"").replace(b" 4\nTYPE", b"\nTYPE").replace(b" U\n", b"\n").replace(b" 1\nWIDTH", b"\nWIDTH")
    + b"1 2 3\n",
    "count.pcd": PCD.replace(b"POINTS 1", b"POINTS many") + b"1 2 3 1\n",
    "scene.txt": b"1 2 3 0\n",
    "scene": GOOD,
}

#: Options that do not fit a good scene, or one another.
OPTIONS = [
    "--target 1 2", "--target a b c d e f g", "--target nan 0 0 0 0 0 1", "--target 0.4 0 0.4 0 0 0 0", "--target /a/topic", "--start 1 2 3",
    "--start a", "--time -1", "--time nan", "--time soon", "--iterations -5", "--iterations 1.5", "--seed x", "--seed -3",
    "--planner best", "--time 1 --iterations 5", "--scale 0", "--scale nan", "--scale big", "--offset 1 2", "--offset a b c", "--picture plan.doc",
    "--picture plan", "--set", "--set voxel_m", "--set voxel_m=", "--set voxel_m=big", "--set voxel_m=9", "--set voxel_m=nan", "--set voxel_m=[1]",
    "--set =1", "--set robot=topic", "--set robot=missing.urdf", "--set robot=good.npz", "--set keep_out_boxes=[1,2]",
    "--set keep_out_boxes=[1,1,1,0,0,0]", "--set keep_out_boxes={", "--set leaf_labels=[0.5]", "--set leaf_labels=[a]", "--set leaf_labels=[0] --set stem_labels=[0]",
    "--set controller=jtc", "--set tool_frame=nose", "--set planning_frame=moon", "--set arm_joints=[a,b]", "--bag missing", "--bag .", "--at 3",
    "--leaf /a", "--json .", "--picture /proc/a.png", "--nonsense", "--fruit 0", "--fruit x", "--fruit 0 --freedom roll", "--freedom any",
    "--candidates missing.json", "--candidates broken.json", "--candidates deep.json", "--candidates good.npz", "--candidates rows.csv",
    "--candidates poses.npy", "--candidates text.npy", "--candidates .", "--target 0.4 0 0.4 --candidates rows.csv", "--params missing.yaml",
    "--params broken.yaml", "--params good.npz", "--params list.yaml", "--params values.yaml", "--namespace 9/&", "--seed 99999999999999999999",
    "--time 1e400", "--offset inf 0 0", "--scale 1e300", "--set class_costs=[5]", "--set static_transforms=[1]", "--set planner=", "--debugg",
]  # fmt: skip

#: Robot descriptions, as `--set robot=arm.urdf`.
ROBOTS = {
    "empty.urdf": b"", "text.urdf": b"hello", "random.urdf": np.random.default_rng(1).bytes(300), "html.urdf": b"<html/>", "bare.urdf": b"<robot name='a'/>",
    "one.urdf": b"<robot name='a'><link name='b'/></robot>", "loop.urdf": b"<robot name='a'><link name='b'/><joint name='j' type='fixed'/></robot>",
    "latin.urdf": "<robot name='ä'/>".encode("latin-1"), "doctype.urdf": b"<!DOCTYPE a><robot/>", "xacro.urdf": b"<robot><xacro:a/></robot>",
}  # fmt: skip

#: What else lies in the folder.
TEXTS = {
    "broken.json": "{", "deep.json": "[" * 100_000, "rows.csv": "1,2,3\n", "text.npy": "hello", "broken.yaml": "a:\n\t- 1", "list.yaml": "- 1\n",
    "values.yaml": "lime_planner:\n  ros__parameters:\n    voxel_m: big\n", "text.mcap": "hello", "empty.mcap": "", "text.db3": "hello",
}  # fmt: skip

#: Further commands.
COMMANDS = [
    "animate good.npz --out a.gif", "animate plan.json --out a.gif", "animate missing.json --out a.gif", "animate broken.json --out a.gif",
    "animate plan.json --out a.doc", "scene plant --out a.doc", "scene plant --out a.npz --seed -1", "scene plant --out a.npz --seed x",
    "scene plant --out a.npz --density lush", "scene plant --out a.npz --height -1", "scene plant --out a.npz --leaves -4", "scene plant",
    "scene plant --out .", "scene", "scene nothing", "scene info", "parameters --nothing", "parameters zzzzzz", "completion fish", "nothing",
    "doctor --only nothing", "record", "record a.npz --bag missing", "record a.npz --bag . --at x", "plan",
    "plan --bag text.mcap", "plan --bag empty.mcap", "plan --bag text.db3", "plan --bag bag", "record a.npz --bag text.mcap", "record a.npz --bag bag",
    "record a.npz --leaf 9bad/&topic", "scene plant --out a.npz --position nan 0 0", "scene plant --out a.npz --position 1e300 0 0",
    "scene see good.npz --from 1e300 0 1 --out a.npz", "scene see good.npz --from 1 0 1 --at 1 0 1 --out a.npz", "scene clean", "view deep.json",
    "view good.npz --host 999.1.1.1 --no-browser", "view good.npz --port 0", "animate deep.json --out a.gif", "animate plan.json --out a.gif --fps 0",
    "experiment wall --out o --jobs 0", "experiment wall --out o --wall broken.json", "experiment wall --out o --option x", "bench nothing",
    "experiment lime --out o --jobs x", "demo --looks -1", "demo --scene missing.npz", "Plan good.npz",
    "record a.doc --bag .", "experiment", "experiment nothing", "view missing.npz", "view broken.json", "plan good.npz extra.npz",
]  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        "lime_planner.pipeline.pipeline.Pipeline.warm_up", lambda _: pytest.fail("this use is wrong, and was about to be planned")
    )
    for name, content in {**ROBOTS, "good.npz": npz(points=P, labels=L, target_pose=[0.4, 0, 0.4, 0, 0, 0, 1.0])}.items():
        (tmp_path / name).write_bytes(content)
    for name, text in TEXTS.items():
        (tmp_path / name).write_text(text)
    (tmp_path / "poses.npy").write_bytes(npy(np.zeros((2, 6))))
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "metadata.yaml").write_text("rosbag2_bagfile_information: 3\n")
    (tmp_path / "plan.json").write_text(json.dumps({"status": "SUCCEEDED"}))
    return tmp_path


def judge(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    try:
        code = cli.main(words)
    except SystemExit as end:
        code = int(end.code or 0)
    said = capsys.readouterr()
    assert code in (1, 2), f"{words}: {code}"
    text = said.err if code == 2 or said.err else said.out
    last = text.strip().splitlines()[-1] if text.strip() else ""
    assert last, f"{words}: says nothing"
    assert not FOREIGN.search(re.sub(r"INTERNAL_ERROR", "", text)), f"{words}: {text}"
    assert "INTERNAL_ERROR" not in text or "standard output" in text, f"{words}: {text}"
    assert code == 2 or not said.err or said.err.count("\n") == 1 or "warning: " in said.err or "\ntry: " in said.err, (
        f"{words}: {said.err}"
    )


Make = Callable[[Path], list[str]]
CASES: list[tuple[str, list[str]]] = [
    *((f"{command} {name}", [*command.split(), name]) for name in FILES for command in ("plan", "scene info")),
    *((f"plan good.npz {options}", ["plan", "good.npz", *options.split()]) for options in OPTIONS),
    *((f"robot {name}", ["plan", "good.npz", "--set", f"robot={name}"]) for name in ROBOTS),
    *((command, command.split()) for command in COMMANDS),
]


def test_there_are_enough() -> None:
    assert len({name for name, _ in CASES}) >= 230


@pytest.mark.parametrize("words", [words for _, words in CASES], ids=[name for name, _ in CASES])
def test_a_wrong_use_is_answered_in_a_sentence(words: list[str], folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, content in FILES.items():
        if name in words:
            (folder / name).write_bytes(content)
    judge(words, capsys)
