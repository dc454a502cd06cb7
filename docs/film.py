"""Film the flight of the README: `python docs/film.py`; it needs `pip install '.[lab]'`.

`dlgmd lab fly --manner hit --environment outdoors --target person --speed 2 --seed 7 --with flight`
makes the film; its images become those of a GIF, narrower, fewer and with fewer colours.
"""

import tempfile
from pathlib import Path

import cv2
from matplotlib.colors import to_rgb
from PIL import Image

from dlgmd_cli.lab.fly import gl
from dlgmd_cli.lab.fly.scripts import Options
from dlgmd_cli.plots.style import BLUE, VERMILION

GIF = Path(__file__).parent / "_static" / "flight.gif"
# Every third of 30 frames/s, and the last one for longer.
SIZE_WH, EVERY, PAUSE_MS, END_MS = (560, 420), 3, 100, 2500


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


def main() -> None:
    """Write the GIF."""
    gl.require()
    from dlgmd_cli.lab.fly.film import film  # imports MuJoCo

    flight = Options(
        "hit", environment="outdoors", target="person", speed_m_s=2.0, seed=7, size_wh=(480, 270)
    )
    with tempfile.TemporaryDirectory() as folder:
        reader = cv2.VideoCapture(str(film(flight, "flight", Path(folder)).paths[0]))
        pictures = []
        while (read := reader.read())[0]:
            small = cv2.resize(read[1], SIZE_WH, interpolation=cv2.INTER_AREA)
            pictures.append(Image.fromarray(cv2.cvtColor(small, cv2.COLOR_BGR2RGB)))
        reader.release()
    colours, shown = palette(), [*pictures[:-1:EVERY], pictures[-1]]
    frames = [one.quantize(palette=colours, dither=Image.Dither.NONE) for one in shown]
    times = [*[PAUSE_MS] * (len(frames) - 1), END_MS]
    frames[0].save(GIF, save_all=True, append_images=frames[1:], duration=times, loop=0)


if __name__ == "__main__":
    main()
