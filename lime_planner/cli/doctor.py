"""`lime-planner doctor`: what is installed, what is missing, whether DDS works here, and what is heard of the arm and the clouds."""

from __future__ import annotations

import argparse
import importlib.util
import textwrap
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from lime_planner.cli.parser import closest
from lime_planner.core.errors import LimePlannerError, ParameterError
from lime_planner.core.parameters import PARAMETERS, parse_assignment, settings_from

if TYPE_CHECKING:
    from lime_planner.cli.parameter_file import ParameterFile
    from lime_planner.doctor.findings import Finding
    from lime_planner.ros.tools.live_checks import Arm

GROUPS = {
    "libraries": "Python libraries",
    "machine": "this machine",
    "robot": "parameters and arm",
    "dds": "ROS 2 and DDS",
    "live": "what is heard",
}

_CHECK_WIDTH = 20
_MARGIN = " " * (8 + _CHECK_WIDTH)

_EPILOG = """\
Each check is one line: ok, warning (works, but worse than it could) or fault,
with what to do. The exit status is 1 if there is a fault. Where no robot is
expected, silence is a warning; with --live, or where a planner node runs, it is
a fault.

examples:
  lime-planner doctor
  lime-planner doctor --live --params config/kinova_j2s6s200.yaml \\
      --joint-states /j2s6s200_driver/out/joint_state
  lime-planner doctor --only libraries,machine
  lime-planner doctor --json | jq '.findings[] | select(.level != "ok")'
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    from lime_planner.cli.arguments import add_parameters, add_topics
    from lime_planner.cli.json_output import add_json

    parser.epilog = _EPILOG
    groups = ", ".join(GROUPS)
    parser.add_argument("--only", type=_groups, default=tuple(GROUPS), metavar="GROUP", help=f"only these, by commas: {groups}")
    parser.add_argument("--live", action="store_true", help="a robot runs: what is not heard is a fault")
    parser.add_argument("--wait", type=float, default=3.0, metavar="S", help="how long to listen to those who publish [s] (default 3)")
    add_parameters(parser)
    add_topics(parser)
    add_json(parser, "the findings")


def _groups(text: str) -> tuple[str, ...]:
    names = tuple(part.strip() for part in text.split(","))
    unknown = [name for name in names if name not in GROUPS]
    if unknown:
        meant = "".join(f"did you mean {name}? There" for name in closest(unknown[0], GROUPS)) or "there"
        raise argparse.ArgumentTypeError(f"there is no group {unknown[0]!r}; {meant} are {', '.join(GROUPS)}")
    return names


def run(args: argparse.Namespace) -> int:
    """Run the checks; 1 if there is a fault."""
    from lime_planner.doctor.findings import healthy
    from lime_planner.output.console import working

    if not 0.0 <= args.wait <= 600.0:
        raise ParameterError(f"--wait is {args.wait:g}; allowed: 0 to 600 s")
    doctor = _Doctor(args)
    steps: dict[str, Callable[[], list[Finding]]] = {name: getattr(doctor, name) for name in GROUPS if name in args.only}
    found: dict[str, list[Finding]] = {}
    with working("checking", total=len(steps)) as progress:
        for name, step in steps.items():
            progress.say(GROUPS[name])
            found[name] = step()
            progress.advance()
    return _report(args, found, healthy([finding for findings in found.values() for finding in findings]))


class _Doctor:
    """The groups of checks, in order; later ones build on what earlier ones found."""

    def __init__(self, args: argparse.Namespace) -> None:
        self._args = args
        self._file: ParameterFile | None = None
        self._file_trouble = ""
        self._dds_works = True
        self._arm: Arm | None = None
        if args.params is not None:
            from lime_planner.cli.parameter_file import read_parameter_file

            try:
                self._file = read_parameter_file(args.params, args.namespace)
            except ParameterError as error:
                self._file_trouble = str(error)
        self._values: dict[str, Any] = dict(self._file.values) if self._file is not None else {}
        self._values.update(parse_assignment(text) for text in args.assignments)
        self._settings = settings_from({name: value for name, value in self._values.items() if name in PARAMETERS})

    def libraries(self) -> list[Finding]:
        from lime_planner.doctor.libraries import library_findings

        return library_findings()

    def machine(self) -> list[Finding]:
        from lime_planner.doctor.machine import machine_findings

        return machine_findings()

    def robot(self) -> list[Finding]:
        from lime_planner.cli.arguments import load_arm
        from lime_planner.doctor.findings import fault, ok, warning

        if self._file_trouble:
            return [fault("parameters", self._file_trouble, "correct the file; `lime-planner parameters` lists what is allowed")]
        path = self._args.params
        where = f"{path}: {len(self._values)} set, all allowed" if path else "the defaults (--params FILE checks a file)"
        findings = [ok("parameters", where)]
        cure = "set it for its own node, or leave it where other nodes have a use for it"
        findings += [warning("parameters", sentence, cure) for sentence in (self._file.warnings if self._file is not None else ())]
        if self._settings.robot == "topic":
            return [*findings, ok("robot", "comes from the topic robot_description")]
        try:
            robot = load_arm(self._settings)
        except ImportError as error:
            return [*findings, fault("robot", f"cannot be loaded: {error}", "see the libraries above")]
        except LimePlannerError as error:
            return [*findings, fault("robot", str(error), "correct the parameters robot, arm_joints, planning_frame or tool_frame")]
        about = f"{robot.name}: {robot.n} joints, reach {robot.reach_m:.2f} m, plans in {robot.planning_frame!r}"
        doubts = [warning("robot", sentence, "correct the description if it is not meant so") for sentence in robot.warnings]
        return [*findings, ok("robot", about), *doubts]

    def dds(self) -> list[Finding]:
        from lime_planner.doctor.findings import fault, healthy, ok, warning
        from lime_planner.doctor.machine import environment_findings

        findings = environment_findings()
        if importlib.util.find_spec("rclpy") is None:
            self._dds_works = False
            silence = fault if self._args.live else warning
            cure = "pip install 'lime_planner[ros]', or source a ROS 2 Jazzy; scene files are planned without"
            return [*findings, silence("ROS 2", "rclpy is not installed: no nodes", cure)]
        if not healthy(findings):
            self._dds_works = False
            return [*findings, warning("DDS", "not tried", "correct the lines above first")]
        from lime_planner.ros.tools.dds_round_trip import BIG_CLOUDS, BIG_POINTS, measure

        trip = measure()
        self._dds_works = trip.heard
        if trip.trouble:
            cure = "correct RMW_IMPLEMENTATION and the environment named above, or install ROS 2 again"
            return [*findings, fault("DDS", trip.trouble, cure)]
        if not trip.heard:
            cure = "check the lines above, a firewall on loopback, and FASTRTPS profiles; on a sourced ROS: fastdds shm clean"
            return [*findings, fault("DDS", "two processes on this machine do not hear each other within 10 s", cure)]
        findings.append(ok("DDS", f"two processes found each other in {trip.discovery_s:.2f} s; there and back {trip.small_ms:.1f} ms"))
        clouds = f"{trip.big_answered} of {BIG_CLOUDS} best-effort clouds of {BIG_POINTS} points arrived"
        if trip.big_answered < BIG_CLOUDS:
            return [*findings, warning("big clouds", clouds, "set the cloud profile above for the nodes that publish clouds")]
        return [*findings, ok("big clouds", clouds)]

    def live(self) -> list[Finding]:
        from lime_planner.doctor.findings import warning

        if self._file_trouble:
            return [warning("listening", "skipped: the parameters cannot be used", "see above")]
        if importlib.util.find_spec("rclpy") is None or not self._dds_works:
            return [warning("listening", "skipped: ROS 2 does not work here", "see above")]
        from lime_planner.cli.arguments import topics_of
        from lime_planner.ros.parameters import snapshot_from
        from lime_planner.ros.tools.listener import Listener
        from lime_planner.ros.tools.live_checks import live_findings

        snapshot = snapshot_from(self._values)
        simulated = self._file is not None and self._file.use_sim_time
        arm = self._known_arm()
        joint_names = arm.joint_names if arm is not None else ()
        with Listener(
            snapshot, joint_names, topics=topics_of(self._args), namespace=self._args.namespace, use_sim_time=simulated
        ) as listener:
            return live_findings(listener, snapshot, arm, expected=self._args.live, wait_s=self._args.wait, use_sim_time=simulated)

    def _known_arm(self) -> Arm | None:
        """Return joints and frame of the arm; those of a built-in model without loading it."""
        from lime_planner.cli.arguments import load_arm
        from lime_planner.robot.builtin import BUILTIN_ARMS
        from lime_planner.ros.tools.live_checks import Arm
        from lime_planner.scene.scene import DEFAULT_FRAME

        settings = self._settings
        if settings.robot in BUILTIN_ARMS:
            names = settings.arm_joints or BUILTIN_ARMS[settings.robot].joint_names
            return Arm(settings.robot, tuple(names), settings.planning_frame or DEFAULT_FRAME)
        try:
            robot = load_arm(settings)
        except LimePlannerError:
            return None
        return Arm(robot.name, tuple(robot.joint_names), robot.planning_frame)


def _report(args: argparse.Namespace, found: dict[str, list[Finding]], well: bool) -> int:
    from lime_planner.cli.json_output import emit_json, is_stdout
    from lime_planner.doctor.findings import Level

    flat = [(group, finding) for group, findings in found.items() for finding in findings]
    if args.json is not None:
        emit_json(args.json, {"ok": well, "findings": [{"group": group, **finding.figures()} for group, finding in flat]})
    if not is_stdout(args.json):
        _print(found)
        counts = {level: sum(finding.level is level for _, finding in flat) for level in Level}
        print(f"{counts[Level.FAULT]} faults, {counts[Level.WARNING]} warnings, {counts[Level.OK]} ok")
    return 0 if well else 1


def _print(found: dict[str, list[Finding]]) -> None:
    """Print columns on a terminal; elsewhere one line for each check, for grep."""
    from lime_planner.output.console import console, print_wrapped

    out = console()
    if not out.is_terminal:
        for findings in found.values():
            for finding in findings:
                cure = f" -> {finding.cure}" if finding.cure else ""
                print_wrapped(f"{finding.level.value:<8} {finding.check}: {finding.sentence}{cure}")
        return
    from rich.text import Text

    styles = {"ok": "green", "warning": "yellow", "fault": "bold red"}
    for group, findings in found.items():
        out.print(Text(GROUPS[group], style="bold"))
        for finding in findings:
            level, *lines = finding.level.value, *_wrapped(finding.sentence)
            head = Text(f"{level:<8}", style=styles[level]).append(f"{finding.check:<{_CHECK_WIDTH}}", style="default")
            out.print(head.append(f"\n{_MARGIN}".join(lines), style="default"), soft_wrap=True)
            for line in _wrapped(f"→ {finding.cure}") if finding.cure else ():
                out.print(Text(_MARGIN + line, style="italic"), soft_wrap=True)
        out.print()


def _wrapped(text: str) -> list[str]:
    # Long words stay whole: they are paths, and commands to be copied.
    return textwrap.wrap(text, 80 - len(_MARGIN), break_long_words=False, break_on_hyphens=False)
