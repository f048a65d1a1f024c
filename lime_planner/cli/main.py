"""`lime-planner`: planning, scenes and experiments without a ROS graph. Commands live in modules of their own and load when called.

A command's module provides `add_arguments(parser)` and `run(args) -> exit status`, and imports nothing heavy at module level.
"""

from __future__ import annotations

import argparse
import contextlib
import errno
import importlib
import os
import sys
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lime_planner import __version__
from lime_planner.cli.parser import Parser, sentence
from lime_planner.core.atomic_files import check_writable
from lime_planner.core.cache_folder import cache_root
from lime_planner.core.errors import LimePlannerError, Refusal, UsageError
from lime_planner.core.status import Status
from lime_planner.core.terminal import prepare_streams, silence

_CHECKOUT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Command:
    """A command: its words, the module that carries it out, one line of help, and an example where the module gives none.

    The module has `add_arguments` and `run`; one that carries out several commands, given as `module:name`, `add_NAME_arguments` and
    `run_NAME` for each.
    """

    words: tuple[str, ...]
    module: str
    summary: str
    example: str = ""


COMMANDS = (
    Command(("plan",), "lime_planner.cli.plan", "plan the arm's reach to a target in a scene file or a recording"),
    Command(("view",), "lime_planner.cli.view", "the 3-D page: plan, look, and move a simulated or a real arm"),
    Command(("animate",), "lime_planner.cli.animate", "turn a saved plan into a moving picture"),
    Command(("demo",), "lime_planner.ros.demo.demo", "scene, arm and planner as ROS nodes; a simulated arm carries the plan out"),
    Command(("scene", "plant"), "lime_planner.cli.scene:plant", "grow a lime plant from a seed"),
    Command(("scene", "tomatowur"), "lime_planner.cli.scene:tomatowur", "obtain public scans of real tomato plants"),
    Command(("scene", "see"), "lime_planner.cli.scene:see", "keep of a scene what depth cameras see of it"),
    Command(("scene", "info"), "lime_planner.cli.scene:info", "say what a scene file holds"),
    Command(("record",), "lime_planner.cli.record", "a scene and a start, from live topics or a recording, into a file"),
    Command(("doctor",), "lime_planner.cli.doctor", "check the installation, ROS 2, the arm and the clouds"),
    Command(("parameters",), "lime_planner.cli.parameters", "list every parameter that --set and the node understand"),
    Command(("compile",), "lime_planner.cli.compile", "compile everything, so that the first plan need not wait for it"),
    Command(("completion",), "lime_planner.cli.completion", "print the script that completes commands in your shell"),
    Command(
        ("experiment", "wall"), "lime_planner.experiments.wall.command", "the paper's experiment on the plane", "--trials 20 --out wall"
    ),
    Command(
        ("experiment", "lime"), "lime_planner.experiments.lime.command", "the paper's experiment with the arm", "--trials 20 --out lime"
    ),
    Command(
        ("experiment", "damage"), "lime_planner.experiments.damage.command", "leaves that the arm really touches", "--plants 2 --out damage"
    ),
    Command(
        ("experiment", "hidden"), "lime_planner.experiments.hidden.command", "stems that no camera saw, touched", "--plants 2 --out hidden"
    ),
    Command(("experiment", "report"), "benchmarks.results_page.command", "write the results page from what runs found", "lime damage"),
    Command(("bench", "kernels"), "benchmarks.kernels.command", "time of the compiled kernels"),
    Command(("bench", "planners"), "benchmarks.planners.command", "the package's own planners, as published and to use", "--out planners"),
    Command(("bench", "peers"), "benchmarks.planners.peers_command", "the default planner against OMPL and others", "--out peers"),
    Command(("bench", "scale"), "benchmarks.scale.command", "how cost grows with points, leaves, joints, budget", "--out scale"),
)

GROUPS = {"scene": "make, obtain and inspect scenes", "experiment": "the paper's tables and figures", "bench": "measurements"}

#: The extra of the package that brings a library.
_EXTRAS = {
    "rclpy": "ros",
    "pingouin": "experiments",
    "pandas": "experiments",
    "distributed": "cluster",
    "ompl": "bench",
    "rosbags": "bags",
    "shtab": "completion",
    "viser": "viewer",
    "imageio": "video",
    "imageio_ffmpeg": "video",
}

#: How standard output refuses what is printed: the disk or the quota is full, the device or the descriptor bad.
_UNWRITABLE = (errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EBADF)

_EXAMPLES = """\
examples:
  lime-planner scene plant --seed 2 --out plant.npz
  lime-planner plan plant.npz --picture plan.png
  lime-planner plan scan.ply --offset 0.55 0 0.05 --target 0.5 0.1 0.4
  lime-planner plan plant.npz --time 2 --json plan.json --set leaf_cost=graded
  lime-planner doctor                           is everything there and heard?
  lime-planner record now.npz                   what the cameras see now

A command's own help: lime-planner plan --help. Completion in this shell:
  source <(lime-planner completion bash)
What goes wrong is one line on standard error, and what to try a second one;
--debug adds the traceback.
"""


def _exists(command: Command) -> bool:
    # What measures the product from outside is not installed with it: those commands are offered in a checkout alone.
    if not command.module.startswith("benchmarks."):
        return True
    return _CHECKOUT.joinpath(*command.module.split(".")).with_suffix(".py").is_file()


def _functions_of(command: Command) -> tuple[Callable[[argparse.ArgumentParser], None], Callable[[argparse.Namespace], int]]:
    """Import what declares a command's arguments and what runs it."""
    if command.module.startswith("benchmarks.") and str(_CHECKOUT) not in sys.path:
        sys.path.append(str(_CHECKOUT))
    name, _, part = command.module.partition(":")
    module = importlib.import_module(name)
    return getattr(module, f"add_{part}_arguments" if part else "add_arguments"), getattr(module, f"run_{part}" if part else "run")


def build_parser(arguments: Sequence[str], *, everything: bool = False) -> argparse.ArgumentParser:
    """Build the parser; only the module of the command that `arguments` name is imported, so that help is quick.

    Args:
        arguments: the command line.
        everything: import all commands.
    """
    words = tuple(word for word in arguments if not word.startswith("-"))
    parser = Parser(
        prog="lime-planner",
        description="Plan the reach of a harvesting arm to a fruit inside a plant:\naround its stems and through as few leaves as it must.",
        epilog=_EXAMPLES,
    )
    parser.add_argument("--version", action="version", version=f"lime-planner {__version__}")
    top = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    groups: dict[str, Any] = {}
    for command in filter(_exists, COMMANDS):
        place = top
        if len(command.words) == 2:
            group = command.words[0]
            if group not in groups:
                own = top.add_parser(group, help=GROUPS[group], description=sentence(GROUPS[group]))
                groups[group] = own.add_subparsers(title="commands", metavar="COMMAND", required=True)
            place = groups[group]
        leaf = place.add_parser(command.words[-1], help=command.summary, description=sentence(command.summary))
        if everything or words[: len(command.words)] == command.words:
            _fill(leaf, command)
    return parser


def _fill(parser: argparse.ArgumentParser, command: Command) -> None:
    add_arguments, run = _functions_of(command)
    add_arguments(parser)
    parser.epilog = parser.epilog or f"example:\n  lime-planner {' '.join(command.words)} {command.example}"
    parser.add_argument("--debug", action="store_true", help="print the traceback of an error")
    parser.set_defaults(run=run)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit status: 0 for success, 1 with `CODE: sentence` on standard error, 2 for wrong usage.

    With `--json` the code and the sentence are there too, as `status` and `message`, unless argparse itself refuses the arguments.
    """
    prepare_streams()
    _give_matplotlib_a_folder()
    arguments = list(sys.argv[1:] if argv is None else argv)
    debug = "--debug" in arguments
    if not arguments:
        build_parser(()).print_help(sys.stderr)
        return 2
    args = argparse.Namespace()
    try:
        try:
            args = build_parser(arguments).parse_args(arguments)
            args.words = arguments  # for the advice after a refusal
            for name in ("json", "picture"):  # before minutes of work whose outcome would be lost
                if getattr(args, name, None) not in (None, "-"):
                    check_writable(getattr(args, name))
            status = int(args.run(args))
        except SystemExit:  # argparse's: help, version, wrong usage
            sys.stdout.flush()
            raise
        sys.stdout.flush()
        return status
    except LimePlannerError as error:
        if debug:
            traceback.print_exc()
        _tell(args, error.status if isinstance(error, Refusal) else Status.BAD_INPUT, str(error))
        return 2 if isinstance(error, UsageError) else 1
    except ModuleNotFoundError as error:
        if debug:
            traceback.print_exc()
        root = (error.name or "").split(".")[0]
        advice = f"; pip install 'lime_planner[{_EXTRAS[root]}]' brings it" if root in _EXTRAS else ""
        # Of what the package itself requires nothing is optional.
        outcome = Status.NOT_INSTALLED if advice else Status.INTERNAL_ERROR
        _tell(args, outcome, f"the library {root!r} is not installed{advice}")
    except KeyboardInterrupt:
        _tell(args, Status.CANCELLED, "stopped by the keyboard")
        return 130
    except BrokenPipeError:  # the reader of our output has had enough (`| head`)
        silence(sys.stdout)
        return 0
    except Exception as error:
        if debug:
            traceback.print_exc()
        if isinstance(error, OSError) and error.filename is None and error.errno in _UNWRITABLE:
            silence(sys.stdout)
            sentence = f"standard output cannot be written: {error.strerror}"
        else:
            text = " ".join(str(error).split()) or "no text"
            sentence = f"{type(error).__name__}: {text} (--debug prints where)"
        _tell(args, Status.INTERNAL_ERROR, sentence)
    return 1


def _give_matplotlib_a_folder() -> None:
    """Keep Matplotlib from complaining, on every start, that it has no home: it gets a folder beside our caches."""
    if "MPLCONFIGDIR" in os.environ:
        return
    base = Path(os.environ.get("XDG_CONFIG_HOME") or Path(os.environ.get("HOME") or "/") / ".config") / "matplotlib"
    existing = next(parent for parent in (base, *base.parents) if parent.exists())
    if not os.access(existing, os.W_OK):
        os.environ["MPLCONFIGDIR"] = str(cache_root() / "matplotlib")


def _tell(args: argparse.Namespace, status: Status, sentence: str) -> None:
    """Say on standard error, and where `--json` is set also there, how a command ended."""
    from lime_planner.cli.json_output import emit_outcome

    message = status.message(sentence)
    with contextlib.suppress(OSError):  # standard error may be full or gone, too
        print(message, file=sys.stderr)
    emit_outcome(args, status.name, message)
