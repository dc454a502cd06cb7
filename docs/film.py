"""Film two flights for the pages: `python docs/film.py`; it needs `pip install '.[lab]'`.

`flight.gif` is the film of `dlgmd lab fly --manner hit --environment outdoors --target person
--speed 2 --seed 7 --with flight`, narrower, with fewer images and colours. `way.gif` is such a
flight of seed 3 to its contact, with the points that the rule `corridor` finds in the way.
"""

import tempfile
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from matplotlib.colors import to_rgb
from PIL import Image

from dlgmd_cli.frame import BgrImage
from dlgmd_cli.lab.fly import gl
from dlgmd_cli.lab.fly.scripts import Options
from dlgmd_cli.models.alarm import Alarm
from dlgmd_cli.models.corridor import Motion, Way
from dlgmd_cli.models.windows import Camera
from dlgmd_cli.plots.style import BLUE, VERMILION

STATIC = Path(__file__).parent / "_static"
# Every third of 30 frames/s after the first second. The last one comes first, and stays for longer:
# a page that does not play films shows how the flight ends.
FPS, FIRST, EVERY, PAUSE_MS, END_MS = 30.0, 30, 3, 100, 2500
FOV_DEG, MEASURED_WH, SHOWN_WH, LINE_PX = 80.0, (240, 135), (480, 270), 36


def main() -> None:
    """Write both GIFs."""
    gl.require()
    write(beside(), STATIC / "flight.gif")
    write(in_the_way(), STATIC / "way.gif")


def options(seed: int) -> Options:
    """A flight outdoors into a person."""
    return Options(
        "hit",
        seed,
        environment="outdoors",
        target="person",
        speed_m_s=2.0,
        size_wh=SHOWN_WH,
        fps=FPS,
    )


def beside() -> Iterator[BgrImage]:
    """A flight without the alarm beside the same flight with it."""
    from dlgmd_cli.lab.fly.film import film  # imports MuJoCo

    with tempfile.TemporaryDirectory() as folder:
        reader = cv2.VideoCapture(str(film(options(seed=7), "flight", Path(folder)).paths[0]))
        while (read := reader.read())[0]:
            yield cv2.resize(read[1], (560, 420), interpolation=cv2.INTER_AREA)
        reader.release()


def in_the_way() -> Iterator[BgrImage]:
    """A flight with the points in the drone's way, and what both rules say."""
    from dlgmd_cli.lab.fly.fly import flown  # imports MuJoCo

    flight = flown(options(seed=3))
    motions = [Motion((right, up), *rest) for _, right, up, *rest in flight.headings.tolist()]
    way, window = (
        Alarm("flight", alarm=rule, fov=FOV_DEG, times="capture")
        for rule in ("corridor", "expansion")
    )
    for n, image in enumerate(flight.frames[: flight.collision_frame]):
        way.heading(*motions[n].direction, *motions[n][1:])
        rows = way.step(image, n / FPS), window.step(image, n / FPS)
        # Places are those in the earlier image of each pair, which is shown.
        picture = cv2.cvtColor(flight.frames[max(n - EVERY, 0)], cv2.COLOR_GRAY2BGR)
        if n >= EVERY:
            pair = motions[n - EVERY], motions[n]
            earlier, now = (small(flight.frames[k]) for k in (n - EVERY, n))
            seen = Way(pair, Camera(FOV_DEG), now.shape).seen(earlier, now, EVERY / FPS)
            mark(picture, *(seen or ([], [])))
        line = np.full((LINE_PX, SHOWN_WH[0], 3), 255, np.uint8)
        for left, name, row in zip((10, 280), ("in the way", "window"), rows, strict=True):
            text = f"{name} {row.signal:.2f}/s{'  alarm' if row.alarm else ''}"
            look = cv2.FONT_HERSHEY_SIMPLEX, 0.6, bgr(VERMILION if row.alarm else "black"), 1
            cv2.putText(line, text, (left, 24), *look, cv2.LINE_AA)
        yield np.vstack((picture, line))


def small(image: np.ndarray) -> np.ndarray:
    """An image as the expansion is measured in it."""
    return cv2.resize(image, MEASURED_WH, interpolation=cv2.INTER_AREA)


def mark(picture: BgrImage, points: np.ndarray, rates: np.ndarray) -> None:
    """Draw points, in vermilion those that are reached within 2 s."""
    scale = SHOWN_WH[0] / MEASURED_WH[0]
    for (x, y), rate in zip(points, rates, strict=True):
        place = round((x + 0.5) * scale), round((y + 0.5) * scale)
        colour = bgr(VERMILION if rate >= 0.5 else BLUE)
        cv2.circle(picture, place, 2, colour, cv2.FILLED, cv2.LINE_AA)


def bgr(colour: str) -> tuple[float, ...]:
    """A colour for OpenCV."""
    return tuple(255 * part for part in reversed(to_rgb(colour)))


def palette() -> Image.Image:
    """An image with the colours of the GIF, for `quantize`."""
    greys = [3 * (grey,) for grey in (*range(0, 246, 7), 255)]
    curves = [
        tuple(round(255 * (1 - share * (1 - part))) for part in to_rgb(colour))
        for colour in (BLUE, VERMILION)
        for share in (0.2, 0.4, 0.6, 0.8, 1.0)  # on white, of their edges
    ]
    image = Image.new("P", (1, 1))
    image.putpalette([part for colour in (*greys, *curves) for part in colour])
    return image


def write(pictures: Iterator[BgrImage], path: Path) -> None:
    """Write a GIF."""
    images = [Image.fromarray(cv2.cvtColor(one, cv2.COLOR_BGR2RGB)) for one in pictures]
    colours, shown = palette(), [images[-1], *images[FIRST:-1:EVERY]]
    frames = [one.quantize(palette=colours, dither=Image.Dither.NONE) for one in shown]
    times = [END_MS, *[PAUSE_MS] * (len(frames) - 1)]
    frames[0].save(path, save_all=True, append_images=frames[1:], duration=times, loop=0)


if __name__ == "__main__":
    main()
