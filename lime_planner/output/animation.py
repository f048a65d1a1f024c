"""A plan as a moving picture: the arm on its way, the leaves it touches, and the tool's path behind it."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lime_planner.core.atomic_files import replacing
from lime_planner.core.errors import ParameterError, Refusal
from lime_planner.core.geometry import matrix_to_pose
from lime_planner.core.status import Status
from lime_planner.core.types import Array, Bool, Float32, Int64, UInt8
from lime_planner.output.approach_lines import APPROACH_COLOURS, APPROACH_WORDS, LENGTH_M, approach_lines
from lime_planner.output.picture import ARM, FREE_PATH, LEAFY_PATH, LIME, STEM, arm_mesh, fruit_layer, in_sight, leaf_layer
from lime_planner.output.render import Layer, View, cloud_layer, compose, halved, mesh_layer
from lime_planner.output.timeline import Timeline, timeline_of
from lime_planner.pipeline import Pipeline
from lime_planner.pipeline.goals import FREE
from lime_planner.pipeline.result import PlanRecord
from lime_planner.robot.model import Robot
from lime_planner.scene.scene import Scene

SUFFIXES = (".gif", ".mp4")

#: Cameras: above the horizon; beside the direction from the base to the target, seen from above.
_ELEVATIONS_RAD = np.radians((18.0, 30.0))
_BESIDE_RAD = np.radians((-62.0, 62.0, -85.0, 85.0))
_MARGIN_M = 0.05
_CAPTION_PIXELS = 44
_LEAF_OVER_ARM = 0.5
_TOUCHED_BEFORE = (0.96, 0.72, 0.48)
_HELD_S = (0.5, 1.2)  # first and last picture of the motion
_CHOICE_S = 1.6  # each of the two before: the approaches that were tried, and the one that was chosen
_APPROACHES_SHOWN = 250
CHOSEN = (0.05, 0.25, 0.75)
_LINE_M, _CHOSEN_M = 0.0012, 0.004  # half the thickness of the lines
_COMMON_COLOURS = 66
_IN_FRONT_M = 10.0
_FINER = 0.004  # spacing of the points that the path is drawn with [m]

Picture = UInt8


def check_format(path: Path) -> None:
    """Refuse an animation that could not be written, before minutes of drawing.

    Raises:
        ParameterError: a suffix that is not supported.
        Refusal: NOT_INSTALLED, what writes films is missing.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise ParameterError(f"{path}: an animation ends in one of {', '.join(SUFFIXES)}, not in {path.suffix or 'nothing'!r}")
    missing = [name for name in ("imageio", "imageio_ffmpeg") if importlib.util.find_spec(name) is None]
    if path.suffix.lower() == ".mp4" and missing:
        what = missing[0].replace("_", "-")
        sentence = f"a film needs {what}, which is not installed: pip install 'lime_planner[video]' brings it; a .gif needs nothing"
        raise Refusal(Status.NOT_INSTALLED, sentence)


def animate(
    path: str | os.PathLike[str],
    pipeline: Pipeline,
    shown: PlanRecord,
    *,
    fps: float = 15.0,
    width: int = 560,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Path:
    """Write a moving picture of a plan; a reader never sees half of it.

    Args:
        path: the file; its suffix (`SUFFIXES`) chooses the format.
        pipeline: of the arm.
        shown: a plan with a path.
        fps: pictures a second, in the motion's own time.
        width: of a picture [pixels].
        progress: told how many of how many pictures are drawn.

    Raises:
        ParameterError: a suffix that is not supported, a plan without a path, or a file that cannot be written.
        Refusal: NOT_INSTALLED, see `check_format`.
    """
    path = Path(path)
    check_format(path)
    if not shown.found:
        raise ParameterError(f"the plan has no path to animate: {shown.result.message}")
    timeline = timeline_of(pipeline, shown)
    count = max(2, round(timeline.duration_s * fps) + 1)
    times = np.linspace(0.0, timeline.duration_s, count)
    stage = _Stage(pipeline.robot, shown, timeline, width)
    pictures = stage.choice()
    held = [round(_CHOICE_S * fps)] * len(pictures)
    for number, t_s in enumerate(times):
        pictures.append(stage.picture(float(t_s)))
        progress(number + 1, count)
    held += [1 + round(_HELD_S[0] * fps), *[1] * (count - 2), 1 + round(_HELD_S[1] * fps)]
    try:
        with replacing(path) as temporary:
            write = _write_gif if path.suffix.lower() == ".gif" else _write_mp4
            write(temporary, pictures, held, fps)
    except OSError as error:
        raise ParameterError(f"{path}: cannot be written ({error.strerror or error})") from error
    return path


class _Stage:
    """The plant as one camera sees it, before which the arm moves."""

    def __init__(self, robot: Robot, shown: PlanRecord, timeline: Timeline, width: int) -> None:
        self._robot, self._timeline, self._scene = robot, timeline, shown.scene
        seen = in_sight(shown.scene, robot)
        arms = [arm_mesh(robot, q)[0] for q in timeline.configurations[:: max(1, len(timeline.configurations) // 8)]]
        self._view = _view([*seen.values(), *arms], timeline.tool[-1], _touched_corners(shown.scene, timeline.leaf_points), width)
        self._planner = shown.result.planner
        self._plant = [
            leaf_layer(self._view, seen["leaf"], shown.scene),
            cloud_layer(self._view, seen["stem"], STEM, (0.0022, 0.0045)),
            fruit_layer(self._view, seen["fruit"], self._scene),
        ]
        self._touched: dict[bytes, Layer] = {}
        self._result = shown.result

    def choice(self) -> list[Picture]:
        """Draw the approaches that were tried, then the one that was chosen; nothing where there was nothing to choose."""
        poses, outcomes, chosen = self._result.approaches, self._result.approach_outcomes, self._result.T_base_tool
        if not len(poses) or chosen is None:
            return []
        tried = np.unique(np.linspace(0, len(poses) - 1, _APPROACHES_SHOWN).round().astype(int))
        lines = {outcome: approach_lines(poses[tried[outcomes[tried] == outcome]]) for outcome in APPROACH_COLOURS}
        arm = (mesh_layer(self._view, *arm_mesh(self._robot, self._timeline.configuration(0.0)), ARM), 1.0)
        solid = [(_strokes(self._view, ends, APPROACH_COLOURS[outcome], _LINE_M), 1.0) for outcome, ends in lines.items() if len(ends)]
        way = approach_lines(matrix_to_pose(chosen)[None], 0.0, max(self._result.straight_approach_m, LENGTH_M))
        one = _strokes(self._view, way, CHOSEN, _CHOSEN_M)
        legend = [(APPROACH_WORDS[outcome], APPROACH_COLOURS[outcome]) for outcome, ends in lines.items() if len(ends)]
        free = int((outcomes == FREE).sum())
        words = (f"{len(poses)} approaches tried, {free} free", "the one that is chosen")
        return [
            self._framed(halved(compose(self._plant, [arm, *layers], _LEAF_OVER_ARM)), text, entries)
            for text, layers, entries in ((words[0], solid, legend), (words[1], [(one, 1.0)], [("straight last stretch", CHOSEN)]))
        ]

    def picture(self, t_s: float) -> Picture:
        """Draw the moment."""
        timeline = self._timeline
        sample = timeline.at(t_s)
        now = timeline.touched[sample]
        before = timeline.touched[: sample + 1].any(axis=0) & ~now
        plant = [*self._plant, self._lit(before, _TOUCHED_BEFORE, 0.001)]
        vertices, triangles = arm_mesh(self._robot, timeline.configuration(t_s))
        # What is touched is shown whatever stands before it.
        solid = [(mesh_layer(self._view, vertices, triangles, ARM), 1.0), (self._lit(now, LEAFY_PATH, _IN_FRONT_M), 0.92)]
        for touching, colour in ((False, FREE_PATH), (True, LEAFY_PATH)):
            points = _dense(timeline.tool[: sample + 1], (timeline.leaf[: sample + 1] > 0.0) == touching)
            if len(points):
                solid.append((_flat(self._view, points, colour), 1.0))
        image = halved(compose(plant, solid, _LEAF_OVER_ARM))
        return self._captioned(image, t_s, now)

    def _lit(self, marks: Bool, colour: tuple[float, float, float], lift_m: float) -> Layer:
        key = marks.tobytes() + bytes(str(colour), "ascii")
        if key not in self._touched:
            self._touched[key] = _leaves(self._view, self._scene, self._timeline.leaf_points[marks], colour, lift_m)
        return self._touched[key]

    def _captioned(self, image: Float32, t_s: float, now: Bool) -> Picture:
        ids = self._scene.leaf_ids
        touched = self._timeline.leaf_points[now]
        count = len(touched) if ids is None else len(np.unique(ids[touched]))
        words = (
            f"{count} {'leaf point' if ids is None else 'leaf'}" if count == 1 else f"{count} {'leaf points' if ids is None else 'leaves'}"
        )
        clock = f"{t_s:4.1f} s" if self._timeline.timed else f"{t_s:4.1f} rad"
        legend = [("tool's path, free", FREE_PATH), ("touching leaves", LEAFY_PATH), ("touched before", _TOUCHED_BEFORE)]
        return self._framed(image, f"{clock}   touching {words}", legend)

    def _framed(self, image: Float32, words: str, legend: list[tuple[str, tuple[float, float, float]]]) -> Picture:
        """Put words and a legend over a picture (H, W, 3) of 0 to 1."""
        from matplotlib import get_data_path
        from PIL import Image, ImageDraw, ImageFont

        height, width = image.shape[0] // 2 * 2 + _CAPTION_PIXELS, image.shape[1] // 2 * 2  # video codecs want even numbers
        canvas = Image.new("RGB", (width, height), "white")
        canvas.paste(Image.fromarray((255.0 * image).clip(0, 255).astype(np.uint8)), (0, _CAPTION_PIXELS))
        draw = ImageDraw.Draw(canvas)
        font = ImageFont.truetype(str(Path(get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"), 14)
        draw.text((12, 6), words, fill=(30, 30, 30), font=font)
        small, left = font.font_variant(size=11), 12
        for text, colour in legend:
            draw.rectangle((left, 30, left + 10, 40), fill=tuple(int(255 * c) for c in colour))
            draw.text((left + 15, 28), text, fill=(70, 70, 70), font=small)
            left += 33 + int(small.getlength(text))
        return np.asarray(canvas)


def _touched_corners(scene: Scene, points: Int64) -> Float32:
    """Return the triangles (T, 3, 3) of the leaves that some leaf points lie on; none where leaves are not known."""
    if scene.leaf_ids is None or scene.leaf_triangles is None or scene.leaf_triangle_ids is None:
        return np.zeros((0, 3, 3), np.float32)
    return scene.leaf_triangles[np.isin(scene.leaf_triangle_ids, np.unique(scene.leaf_ids[points]))]


def _view(clouds: list[npt.NDArray[Any]], goal: Array, touched: Float32, width: int) -> View:
    """Choose a camera: beside the way to the goal, a little above it, where most of the touched leaves is seen; all in sight."""
    ahead = float(np.arctan2(goal[1], goal[0]))
    normals = np.cross(touched[:, 1] - touched[:, 0], touched[:, 2] - touched[:, 0])
    best: tuple[float, Array, Array] | None = None
    for elevation in _ELEVATIONS_RAD:
        for turn in ahead + _BESIDE_RAD:
            back = np.array([np.cos(turn), np.sin(turn), 0.0])  # from the plant towards the eye, seen from above
            up = np.cos(elevation) * np.array([0.0, 0.0, 1.0]) - np.sin(elevation) * back
            right = np.cross(np.array([0.0, 0.0, 1.0]), back)
            area = float(np.abs(normals @ np.cross(right, up)).sum())
            if best is None or area > 1.2 * best[0]:
                best = (area, right, up)
    assert best is not None
    _, right, up = best
    flat = np.concatenate([np.asarray(cloud, dtype=np.float64) for cloud in clouds if len(cloud)]) @ np.stack([right, up]).T
    low, high = flat.min(axis=0) - _MARGIN_M, flat.max(axis=0) + _MARGIN_M
    return View(right, up, (low[0], high[0], low[1], high[1]), float(high[0] - low[0]) / (2 * width))


def _leaves(view: View, scene: Scene, points: Int64, colour: tuple[float, float, float], lift_m: float) -> Layer:
    """Draw whole leaves where they are known, else points, a little nearer to the eye than they are."""
    if scene.leaf_ids is not None and scene.leaf_triangles is not None and scene.leaf_triangle_ids is not None:
        corners = _touched_corners(scene, points).reshape(-1, 3)
        layer = mesh_layer(view, corners, np.arange(len(corners)).reshape(-1, 3), colour)
    else:
        layer = cloud_layer(view, scene.leaf_points[points], colour, (0.003, 0.006))
    return Layer(layer.colour, layer.height_m + np.float32(lift_m))


def _flat(view: View, points: Array, colour: tuple[float, float, float]) -> Layer:
    """Draw points in one colour, without shading."""
    layer = cloud_layer(view, points, colour, (0.004, 0.004))
    layer.colour[np.isfinite(layer.height_m)] = colour
    return layer


def _strokes(view: View, ends: Array, colour: tuple[float, float, float], half_m: float) -> Layer:
    """Draw lines (A, 2, 3) in one colour, in front of everything."""
    shares = np.linspace(0.0, 1.0, 40)[:, None]
    points = (ends[:, None, 0] + shares * (ends[:, None, 1] - ends[:, None, 0])).reshape(-1, 3)
    layer = cloud_layer(view, points, colour, (half_m, half_m))
    layer.colour[np.isfinite(layer.height_m)] = colour
    return Layer(layer.colour, layer.height_m + np.float32(_IN_FRONT_M))


def _dense(line: Array, wanted: Bool) -> Array:
    """Return points close together along the parts of a line (K, 3) whose ends are wanted (K,)."""
    pieces = [np.zeros((0, 3))]
    for a, b, yes in zip(line[:-1], line[1:], wanted[1:], strict=True):
        if yes:
            steps = max(1, int(np.ceil(np.linalg.norm(b - a) / _FINER)))
            pieces.append(a + np.linspace(0.0, 1.0, steps, endpoint=False)[:, None] * (b - a))
    return np.concatenate(pieces)


def _held(pictures: list[Picture], held: list[int]) -> Iterator[Picture]:
    for picture, times in zip(pictures, held, strict=True):
        yield from [picture] * times


def _write_gif(path: Path, pictures: list[Picture], held: list[int], fps: float) -> None:
    from PIL import Image

    # One palette for all, so that nothing flickers: common colours, and those that mean something however rare they are.
    sample = Image.fromarray(np.concatenate([pictures[0], pictures[len(pictures) // 2], pictures[-1]]))
    common = (sample.quantize(_COMMON_COLOURS, method=Image.Quantize.MEDIANCUT).getpalette() or [])[: 3 * _COMMON_COLOURS]
    colours = np.array([LEAFY_PATH, _TOUCHED_BEFORE, FREE_PATH, LIME, CHOSEN, *APPROACH_COLOURS.values()])
    meaning = np.round(255 * colours[:, None] * np.array([1.0, 0.8, 0.6])[:, None]).astype(int).ravel().tolist()
    palette = Image.new("P", (1, 1))
    palette.putpalette([*common, *meaning])
    frames = [Image.fromarray(picture).quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    step_ms = round(1000.0 / fps / 10.0) * 10  # GIF counts in hundredths of a second
    durations = [times * step_ms for times in held]
    frames[0].save(path, format="GIF", save_all=True, append_images=frames[1:], duration=durations, loop=0, optimize=False)


def _write_mp4(path: Path, pictures: list[Picture], held: list[int], fps: float) -> None:
    import imageio

    writer: Any

    with imageio.get_writer(path, format="FFMPEG", fps=fps, codec="libx264", quality=8, macro_block_size=2) as writer:
        for picture in _held(pictures, held):
            writer.append_data(picture)
