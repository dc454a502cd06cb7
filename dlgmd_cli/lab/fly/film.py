"""A closed loop: a flight that brakes at an alarm, filmed beside the same flight without one."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes

import dlgmd_cli
from dlgmd_cli.errors import ParameterError
from dlgmd_cli.lab.fly import gl
from dlgmd_cli.lab.fly.builder import SCENERY, TARGET
from dlgmd_cli.lab.fly.fly import table
from dlgmd_cli.lab.fly.scripts import Options, script_of
from dlgmd_cli.lab.fly.stage import Stage
from dlgmd_cli.lab.fly.textures import GreyImage
from dlgmd_cli.plots.style import BLACK, BLUE, GREY, VERMILION, Figure, house_style
from dlgmd_cli.results import store
from dlgmd_cli.results.outcome import Written
from dlgmd_cli.video.writer import best_codec, video_writer

# From an alarm to the first command.
REACT_S = 0.1
_NAMES = "without", "with"
_COLOURS = {"without": GREY, "with": BLUE}
COLUMNS = (
    *("flight", "frame", "time_s", "distance_m", "closing_m_s"),
    *("expansion", "signal", "mp_abs", "alarm"),
)
# Text is large, so that the film can be read in a third of its width.
_WIDTH, _HEIGHT, _DPI, _TEXT_PT = 1280, 960, 100, 24
_PANEL_WH, _TOP_PX, _MARGIN_PX = (632, 356), 56, 5
# Colours for OpenCV, in BGR order.
_VERMILION, _BLACK, _WHITE, _NOW = (0, 0x5E, 0xD5), (0, 0, 0), (255, 255, 255), (60, 60, 60)
BgrImage = npt.NDArray[np.uint8]


@dataclass(eq=False)
class Loop:
    """One of the two flights of a film.

    Attributes
    ----------
    frames : list of ndarray, (H, W), uint8
    rows : list of tuple
        Time, distance, closing speed, expansion, signal of the rule, membrane potential and alarm
        of each frame.
    contact_s, alarm_s : float or None
        When something touches the hull, and when the drone was told to brake.
    end : str
        How it ends, in words.
    """

    frames: list[GreyImage]
    rows: list[tuple[float, float, float, float, float, float, int]]
    contact_s: float | None = None
    alarm_s: float | None = None
    end: str = ""


# The flights "without" and "with" an alarm.
Loops = dict[str, Loop]


def film(options: Options, model: str, folder: Path, *, overwrite: bool = False) -> Written:
    """Fly a flight without and with an alarm, and film both side by side.

    Parameters
    ----------
    options : Options
    model : str
        What `Alarm` takes: the number of a set, or the name of a preset.
    folder : Path
        Where NAME-film.mp4 and NAME-film.csv go.
    overwrite : bool
        Whether these may be replaced.

    Raises
    ------
    ParameterError
        If the drone hovers, and could not brake; or for what `fly` and `Alarm` refuse.
    """
    gl.require()
    script = script_of(options)
    if script.hovers:
        hint = "Choose hit, pass, door, turn or free."
        raise ParameterError("", f"in {script.name} the drone hovers, and cannot brake", hint)
    names = [f"{script.name}-{options.seed:04d}-film.{end}" for end in ("mp4", "csv")]
    with store.claimed(folder, names=names, overwrite=overwrite) as claim:
        loops = {name: _flown(options, model, brakes=name == "with") for name in _NAMES}
        rule = dlgmd_cli.Alarm(model).rule
        threshold = rule.threshold if rule.column == "expansion" else None
        with claim.staged() as stage:
            shape = _HEIGHT, _WIDTH
            with video_writer(
                stage / names[0], shape, options.fps, codec=best_codec(), is_colour=True
            ) as write:
                for picture in pictures(loops, threshold):
                    write(picture)
            rows = [(name, n, *row) for name in _NAMES for n, row in enumerate(loops[name].rows)]
            (stage / names[1]).write_text(table(COLUMNS, rows))
    lines = tuple(f"{name} the alarm: {loop.end}" for name, loop in loops.items())
    return Written(tuple(folder / name for name in names), lines)


def _flown(options: Options, model: str, *, brakes: bool) -> Loop:
    """Fly a flight frame by frame through an alarm; the drone brakes at the first one, or never."""
    script = script_of(options)
    alarm = dlgmd_cli.Alarm(model, fov=script.fov_deg, camera_tilt=script.camera_tilt_deg)
    loop = Loop([], [])
    with Stage(script, options.seed, options.size_wh) as stage:
        while (time_s := len(loop.frames) / options.fps) <= stage.seconds:
            loop.frames.append(stage.image(len(loop.frames), time_s))
            found = alarm.step(loop.frames[-1], time_s)
            course = stage.course(time_s)
            measured = float(found.expansion), float(found.signal), float(found.mp_abs)
            loop.rows.append((time_s, *course, *measured, int(found.alarm)))
            hit = stage.contact_s is not None and time_s >= stage.contact_s
            if brakes and found.alarm and loop.alarm_s is None and not hit:
                loop.alarm_s = time_s
                stage.brake(time_s + REACT_S)
        loop.contact_s = stage.contact_s
        loop.end = _end(stage, loop, brakes=brakes)
    return loop


def _end(stage: Stage, loop: Loop, *, brakes: bool) -> str:
    """How a flight ends, in words."""
    if stage.contact_s is not None:
        speed = stage.course(stage.contact_s)[1]
        told = "" if not brakes else "no alarm, " if loop.alarm_s is None else "brakes, "
        return f"{told}hits at {speed:.1f} m/s"
    if loop.alarm_s is None:
        return "hits nothing"
    space = stage.clearance(stage.seconds, SCENERY, TARGET)
    return f"stops {space:.2f} m before contact" if stage.script.collides else "stops"


def pictures(loops: Loops, threshold: float | None) -> Iterator[BgrImage]:
    """The images of a film, (960, 1280, 3) BGR; a flight that has ended shows its last one.

    Above are both flights; below, each in the colour of its title, what the alarm compares with
    the threshold, thin behind it the measured expansion, and the membrane potential. Matplotlib
    draws the curves once.

    Parameters
    ----------
    loops : dict of Loop
    threshold : float or None
        Of the expansion in 1/s, if the alarm goes by that.
    """
    with house_style():
        figure = Figure(figsize=(_WIDTH / _DPI, _HEIGHT / _DPI), dpi=_DPI)
        curves = figure.subplots(2, 1, sharex=True)
        figure.subplots_adjust(0.075, 0.1, 0.985, 0.51, hspace=0.35)
        _draw_curves(curves, loops, threshold)
        for x, name in zip((0.25, 0.75), loops, strict=True):
            title = figure.text(x, 0.97, f"{name} the alarm", ha="center", va="center")
            title.set(fontsize=_TEXT_PT, color=_COLOURS[name], weight="bold")
        drawn = BytesIO()
        figure.savefig(drawn, format="png", dpi=_DPI)
    data = np.frombuffer(drawn.getvalue(), np.uint8)
    ground = np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), np.uint8)
    longest = max(loops.values(), key=lambda loop: len(loop.rows))
    for index, (time_s, *_) in enumerate(longest.rows):
        picture = ground.copy()
        for number, loop in enumerate(loops.values()):
            left = _MARGIN_PX + number * (_PANEL_WH[0] + 2 * _MARGIN_PX - 2)
            panel = _panel(loop, min(index, len(loop.frames) - 1))
            picture[_TOP_PX : _TOP_PX + _PANEL_WH[1], left : left + _PANEL_WH[0]] = panel
        for axes in curves:
            box = axes.get_window_extent()
            x = round(float(axes.transData.transform((time_s, 0.0))[0]))
            rows = slice(round(_HEIGHT - box.y1), round(_HEIGHT - box.y0))
            future = picture[rows, x : round(box.x1) + 1]
            future[:] = 255 - (255 - future) // 5
            picture[rows, x - 1 : x + 2] = _NOW
        yield picture


def _panel(loop: Loop, index: int) -> BgrImage:
    """A frame of a flight, with what happens there."""
    image = cv2.resize(loop.frames[index], _PANEL_WH, interpolation=cv2.INTER_LINEAR)
    panel = np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), np.uint8)
    time_s = loop.rows[index][0]
    if loop.contact_s is not None and time_s >= loop.contact_s:
        _badge(panel, loop.end, _BLACK)
    elif loop.alarm_s is not None and time_s >= loop.alarm_s:
        ended = index == len(loop.rows) - 1
        _badge(panel, loop.end if ended else "alarm: brakes", _VERMILION)
    return panel


def _draw_curves(curves: Sequence[Axes], loops: Loops, threshold: float | None) -> None:
    """The expansion and the membrane potential over time, of both flights."""
    expansion, potential = curves
    for name, loop in loops.items():
        time_s, _, _, rate, signal, mp_abs, _ = np.array(loop.rows, float).T
        if threshold is not None:
            expansion.plot(time_s, rate, color=_COLOURS[name], linewidth=1.5, alpha=0.6)
        compared = rate if threshold is None else signal
        for axes, values in ((expansion, compared), (potential, mp_abs)):
            axes.plot(time_s, values, color=_COLOURS[name], linewidth=4)
            if loop.contact_s is not None:
                axes.axvline(loop.contact_s, color=BLACK, linewidth=3)
            if loop.alarm_s is not None:
                axes.axvline(loop.alarm_s, color=VERMILION, linewidth=3)
    if threshold is not None:
        expansion.axhline(threshold, color=GREY, linestyle="--", linewidth=2)
        expansion.text(0, threshold + 0.2, "threshold", color=GREY, fontsize=_TEXT_PT - 4)
    expansion.set(ylim=(-0.5, 4.0))
    potential.set(ylim=(0.0, 1.05), xlabel="Time (s)")
    for axes, title in ((expansion, "Expansion (1/s)"), (potential, "Membrane potential")):
        axes.set_title(title, fontsize=_TEXT_PT, loc="left")
        axes.tick_params(labelsize=_TEXT_PT - 4)
        axes.xaxis.label.set_fontsize(_TEXT_PT)


def _badge(panel: BgrImage, text: str, colour: tuple[int, int, int]) -> None:
    """A word in the upper left corner of an image."""
    font, scale = cv2.FONT_HERSHEY_SIMPLEX, 1.4
    (width, height), _ = cv2.getTextSize(text, font, scale, 3)
    cv2.rectangle(panel, (0, 0), (width + 28, height + 28), colour, cv2.FILLED)
    cv2.putText(panel, text, (14, height + 14), font, scale, _WHITE, 3, cv2.LINE_AA)
