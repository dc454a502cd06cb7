"""Results, sheets and sweeps to draw, and what tests of figures look at."""

from dataclasses import replace

import numpy as np
import yaml
from conftest import judged_anew, result_of_level
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg

from dlgmd_cli.parameters.presets import DlgmdParameters
from dlgmd_cli.results.grid import Axis, Grid
from dlgmd_cli.results.sheet import LayerSheet

NAN = np.nan
UNITS = ("luminance", "luminance", "luminance²")


def make_result(n=40, *, frame_step=1, start_s=0.0, scale=1.0, **options):
    """Spikes at rows 20 to 24 and alarms from row 21 on; nothing passes at rows 10 to 12."""
    level = np.full(n, 0.1)
    level[:3] = NAN
    level[20:25] = [0.5, 0.6, 0.9, 0.7, 0.45]
    attenuation = np.linspace(-30, -5, n)
    attenuation[:3] = NAN
    attenuation[10:13] = -np.inf
    attenuation[30:31] = NAN
    times, frames = start_s + np.arange(n) / 10, np.arange(n) * frame_step
    return result_of_level(
        level * scale, time_s=times, frame=frames, attenuation_db=attenuation, **options
    )


def write_comparison(folder, *rows, labels=("set9", "lgmd")):
    """A folder as `dlgmd compare` writes it, without the expansion, by hand; no signal is known."""
    folder.mkdir(exist_ok=True, parents=True)
    header = "label,frame,time_s,mp,level,spike,attenuation_db,signal"
    lines = [header, *(f"{row}," for row in rows), ""]
    (folder / "compare.csv").write_text("\n".join(lines), encoding="utf-8")
    model = {"model": "dlgmd", "width": 10, "height": 10, **DlgmdParameters().to_dict()}
    record = {
        "input": {"path": "/somewhere/flight.mp4"},
        "options": {},
        "models": [{"label": label, **model} for label in labels],
    }
    (folder / "compare.yaml").write_text(yaml.safe_dump(record), encoding="utf-8")
    return folder


def approach(rule="ttc", n=60, contact_s=5.0):
    """`make_result` with an expansion of the constant approach that ends in a contact."""
    result = make_result(n)
    params = replace(result.params, alarm=rule, ttc_alarm=0.64)
    left_s = contact_s - result.time_s
    result.rows["ttc_s"] = np.where((left_s > 0.0) & (left_s < 4.0), left_s, NAN)
    result.rows["expansion"] = np.nan_to_num(1.0 / result.ttc_s)
    result.rows["expansion_upright"] = result.expansion
    result.rows["expansion_quality"] = 1.0
    result.record["input"]["contact_s"] = contact_s
    record = {**result.record, **params.to_dict()}
    return judged_anew(replace(result, params=params, record=record))


def part(result, rows):
    return result_of_level(
        result.mp_abs[rows],
        time_s=result.time_s[rows],
        frame=result.frame[rows],
        attenuation_db=result.attenuation_db[rows],
    )


def long_result(n=20_000):
    level = 0.2 + 0.1 * np.sin(np.arange(n) / 11)
    level[n // 4 : n // 3] = NAN
    level[[0, n // 16, n // 3 - 100, n - 1]] = [0.91, 0.92, 0.93, 0.94]
    attenuation = -40 * level
    attenuation[n // 2] = -np.inf
    return result_of_level(level, time_s=np.arange(n) / 30, attenuation_db=attenuation)


def legend(figure):
    return [text.get_text() for item in figure.legends for text in item.get_texts()]


def named(figure):
    """Text of each entry of the legends -> its handle."""
    return {
        text.get_text(): handle
        for item in figure.legends
        for text, handle in zip(item.get_texts(), item.legend_handles, strict=True)
    }


def line_named(figure, text, axes=None):
    """The line that looks as the legend's entry of that text does, in all axes or in some."""
    of = named(figure)[text]
    look = of.get_color(), of.get_linestyle(), of.get_linewidth()
    lines = [line for one in ([axes] if axes else figure.axes) for line in one.lines]
    found = [
        one for one in lines if (one.get_color(), one.get_linestyle(), one.get_linewidth()) == look
    ]
    assert found, text
    return found[0]


def written(figure):
    """The names written on lines, and where values lie that are beyond an axis."""
    return [text.get_text() for axes in figure.axes for text in axes.texts]


def frame_axis(figure):
    """The axis of frames above the panels, of the left column if there are two."""
    top, *_ = [child for axes in figure.axes for child in axes.child_axes]
    return top


def boxes(texts):
    return [text.get_window_extent() for text in texts if text.get_text()]


def make_sheet(n=3, shape=(27, 48), *, label="flight", start=0):
    """Frame k has one active cell in each layer, of strength k in P, 10k in S, 100k in G."""
    layers = np.zeros((3, n, *shape), np.float32)
    for k in range(n):
        layers[:, k, shape[0] // 3, shape[1] // 4] = (k, 10 * k, 100 * k)
    frame = start + 10 * np.arange(n)
    grey = np.full((n, *shape), 0.25, np.float32)
    return LayerSheet(frame, frame / 30, grey, *layers, UNITS, label)


def rows(figure):
    """The axes of the rows: input, P, S, G."""
    return [axes for axes in figure.axes if not hasattr(axes, "_colorbar")]


def bars(figure):
    return [axes for axes in figure.axes if hasattr(axes, "_colorbar") and axes.get_visible()]


def pixels(figure):
    """The figure as it is saved, (H, W, 3) in RGB order."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[:, :, :3].astype(int)


def tile_pixels(picture, image):
    """The pixels of one tile, without its rim."""
    box, height = image.get_window_extent(), picture.shape[0]
    return picture[
        round(height - box.y1) + 1 : round(height - box.y0) - 1,
        round(box.x0) + 1 : round(box.x1) - 1,
    ]


def hot(shown):
    """Where the strongest colour is."""
    top = np.array(colormaps["inferno"](1.0)[:3]) * 255
    return np.abs(shown - top).max(axis=2) < 2


def axis(text):
    return Axis.parse(text, DlgmdParameters)


def swept(columns, x="r=2:4:1", y="a=1,2", speeds=(), possible=None):
    """What the figure of a sweep takes."""
    grid = Grid(axis(x), axis(y))
    columns = {key: np.array(c, dtype=float).reshape(-1, *grid.shape) for key, c in columns.items()}
    there = np.ones(grid.shape, dtype=bool) if possible is None else np.array(possible, dtype=bool)
    return grid, columns, there, speeds, "title"


def attenuation(values, speeds=(1.0,), **options):
    return swept({"attenuation_db": values}, speeds=speeds, **options)


def curve(axes, place=0):
    """The values of the line of a result, NaN included."""
    return [line for line in axes.get_lines() if line.get_marker() != "."][place].get_ydata()
