"""Random messages, scene files and command lines: every one is taken or refused in a sentence, and nothing else happens.

    python test/ros/test_fuzz.py --examples 20000

runs the same tests for longer.
"""

from __future__ import annotations

import contextlib
import io
import os
import sys
import tempfile
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from ros_fakes import JOINTS, cloud, never
from sensor_msgs.msg import JointState, PointCloud2, PointField

from lime_planner.cli import main as cli
from lime_planner.core.errors import Refusal, SceneError
from lime_planner.core.parameters import NODE_PARAMETERS, PARAMETERS
from lime_planner.ros.convert import to_pose
from lime_planner.ros.inputs.frames import StaticFrames
from lime_planner.ros.inputs.latest import Inputs
from lime_planner.ros.inputs.scene_source import SceneSource
from lime_planner.ros.parameters import snapshot_from
from lime_planner.scene.from_clouds import CLOUDS
from lime_planner.scene.scene import Scene

EXAMPLES = int(os.environ.get("FUZZ_EXAMPLES", "60"))
fuzzed = settings(max_examples=EXAMPLES, deadline=None, suppress_health_check=list(HealthCheck), database=None)
NUMBERS = st.floats(allow_nan=True, allow_infinity=True, width=64)
FIELDS = st.lists(
    st.builds(
        PointField,
        name=st.sampled_from(["x", "y", "z", "label", "permeability_cost", "rgb", ""]),
        offset=st.integers(0, 40),
        datatype=st.integers(0, 9),
        count=st.integers(0, 3),
    ),
    max_size=7,
)


@st.composite
def clouds(draw: st.DrawFn) -> PointCloud2:
    """A cloud that is nearly right, or not at all."""
    count = draw(st.integers(0, 9))
    msg = cloud(count, label=np.arange(count, dtype=np.uint8)) if draw(st.integers(0, 4)) else PointCloud2()
    if draw(st.integers(0, 3)) == 0:
        msg.fields = draw(FIELDS)
    for name, values in (("width", 12), ("height", 4), ("point_step", 48), ("row_step", 200)):
        if draw(st.integers(0, 3)) == 0:
            setattr(msg, name, draw(st.one_of(st.integers(0, values), st.just(2**32 - 1))))
    msg.is_bigendian = draw(st.booleans())
    if draw(st.integers(0, 2)) == 0:
        msg.data = type(msg.data)("B", draw(st.binary(max_size=600)))
    msg.header.frame_id = draw(st.sampled_from(["base", "/base", "base", "mast", "", "moon", "ä b"]))
    msg.header.stamp.sec = draw(st.sampled_from([0, 1000, 1000, -5, 2**31 - 1]))
    return msg


@fuzzed
@given(name=st.sampled_from(CLOUDS), msg=clouds(), more=clouds())
def test_clouds(name: str, msg: PointCloud2, more: PointCloud2) -> None:
    inputs = Inputs(lambda: 1000.0, lambda sentence: None)
    source = SceneSource(inputs, StaticFrames(["base mast 0 0 1 0 0 0 1"]), "base", lambda scene, q, padding: scene)
    snapshot = snapshot_from({"max_cloud_age_s": 50.0, "max_cloud_skew_s": 50.0, "leaf_labels": [3, 4]})
    for topic, each in ((name, msg), ("stem_cloud", more)):
        inputs.on_cloud(topic, each)
        for look in (source.scene, source.stems):
            try:
                scene = look(snapshot, never)
            except Refusal as refusal:
                assert str(refusal)
            else:
                assert np.isfinite(scene.stem_points).all()
                assert scene.frame_id == "base"
    for slot in inputs.slots.values():
        assert slot.received >= slot.used + slot.superseded + slot.refused


@fuzzed
@given(
    names=st.lists(st.sampled_from([*JOINTS, "finger", ""]), max_size=6),
    positions=st.lists(NUMBERS, max_size=6),
    stamp=st.integers(-(2**31), 2**31 - 1),
    pose=st.lists(NUMBERS, min_size=7, max_size=7),
    frame=st.text(max_size=5),
)
def test_joint_states_and_targets(names: list[str], positions: list[float], stamp: int, pose: list[float], frame: str) -> None:
    from geometry_msgs.msg import PoseStamped

    inputs = Inputs(lambda: 1000.0, lambda sentence: None)
    inputs.set_joints(JOINTS)
    msg = JointState(name=names, position=positions)
    msg.header.stamp.sec = stamp
    state = inputs.on_joint_state(msg)
    if state is not None:
        assert np.isfinite(state.q).all()
        assert inputs.joints.at(float(stamp)) is not None
    target = PoseStamped(pose=to_pose(pose))
    target.header.frame_id, target.header.stamp.sec = frame, stamp
    taken = inputs.on_target(target)
    try:
        found = inputs.target(10.0, 10.0)
    except Refusal as refusal:
        assert str(refusal)
    else:
        assert taken
        assert np.isfinite(found.aim.poses).all()
        assert abs(np.linalg.det(found.aim.poses[0, :3, :3]) - 1.0) < 1e-6
    assert inputs.figures()
    inputs.trouble(0.3)


@cache
def files() -> dict[str, bytes]:
    """A small good scene file of each kind."""
    points = np.random.default_rng(0).uniform(0.2, 0.6, (12, 3))
    scene = Scene.from_points(points, np.arange(12) % 3, frame_id="base")
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        for suffix in (".npz", ".ply", ".pcd"):
            path = Path(folder) / f"scene{suffix}"
            scene.save(path)
            found[suffix] = path.read_bytes()
    return found


@fuzzed
@given(
    suffix=st.sampled_from([".npz", ".ply", ".pcd"]),
    cut=st.floats(0.0, 1.0),
    changes=st.lists(st.tuples(st.floats(0.0, 1.0), st.binary(min_size=1, max_size=6)), max_size=4),
    scale=st.sampled_from([1.0, 1.0, 0.0, -1.0, float("nan"), 1e30]),
)
def test_scene_files(suffix: str, cut: float, changes: list[tuple[float, bytes]], scale: float) -> None:
    content = bytearray(files()[suffix])
    for place, replacement in changes:
        at = int(place * len(content))
        content[at : at + len(replacement)] = replacement
    if cut < 0.5:
        content = content[: int(2.0 * cut * len(content))]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"scene{suffix}"
        path.write_bytes(content)
        try:
            scene = Scene.load(path, scale=scale)
        except SceneError as error:
            assert str(path) in str(error)
            assert "\n" not in str(error)
        else:
            assert scene.n_points > 0
            assert np.isfinite(scene.stem_points).all()


WORDS = st.one_of(
    st.sampled_from(
        [
            *("plan", "parameters", "scene", "info", "--json", "--seed", "--time", "--iterations", "--planner", "--set", "--target"),
            *("--offset", "--scale", "--start", "--picture", "--markdown", "--debug", "--version", "missing.npz", "bad.npz", "bad.ply"),
            *("0", "-1", "1e400", "nan", "7", "stem", "=", "seed=1", "voxel_m=0", "x=1", "keep_out_boxes=[1,2", "leaf_labels=[a]"),
        ]
    ),
    st.text(st.characters(blacklist_categories=["Cs"], blacklist_characters="\x00"), max_size=8),
    st.sampled_from([*PARAMETERS, *NODE_PARAMETERS]).flatmap(lambda name: st.text(max_size=6).map(lambda text: f"{name}={text}")),
)


@fuzzed
@given(
    command=st.sampled_from([["plan"], ["plan", "missing.npz"], ["plan", "bad.npz"], ["parameters"], ["scene", "info"], []]),
    rest=st.lists(WORDS, max_size=6),
)
def test_command_lines(command: list[str], rest: list[str]) -> None:
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        Path("bad.npz").write_bytes(files()[".npz"][:100])
        Path("bad.ply").write_bytes(files()[".ply"][:60])
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            try:
                code = cli.main([*command, *rest])
            except SystemExit as end:  # argparse's way
                code = int(end.code or 0)
    assert code in (0, 1, 2)
    if "--debug" not in rest:
        assert "Traceback" not in err.getvalue()
    assert "INTERNAL_ERROR" not in err.getvalue(), err.getvalue()
    assert code == 0 or err.getvalue().strip() or out.getvalue().strip()


if __name__ == "__main__":
    if "--examples" in sys.argv:
        os.environ["FUZZ_EXAMPLES"] = sys.argv[sys.argv.index("--examples") + 1]
    raise SystemExit(pytest.main(["-q", "-x", __file__]))
