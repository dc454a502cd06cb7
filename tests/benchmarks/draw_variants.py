"""The variants of docs/change-one-layer.md: what each answers to moving cubes, and what it costs.

    python tests/benchmarks/draw_variants.py docs/pictures/change-one-layer.png

Draws the figure of the page, and prints the time of a frame of 480x270, of each variant and of the
plain path, as times of set 9's. It is the processor's time; the least of three medians.
"""

import re
import statistics
import sys
import time
from itertools import islice
from pathlib import Path

import cv2
import matplotlib.pyplot as plt

import dlgmd_cli
from dlgmd_cli.models.base import create_model

ROOT = Path(__file__).parents[2]
NAMES = ("Contrast", "Latency", "Divisive", "Leaky")
CLIPS = {"looming-cube": "Looming", "receding-cube": "Receding", "translating-cubes": "Translating"}
SIZE_WH, N_FRAMES = (480, 270), 30


class Plain(dlgmd_cli.DLGMD):
    """Set 9, layer by layer."""

    def combine(self, e, i):
        """As it is."""
        return super().combine(e, i)


def variants():
    """The classes that the page shows."""
    page = (ROOT / "docs/change-one-layer.md").read_text(encoding="utf-8")
    code = re.search(r"<!-- file: variants.py -->\n```python\n(.*?)^```$", page, re.S | re.M)[1]
    names = {"__name__": "variants"}
    exec(code, names)
    return {"set 9": dlgmd_cli.DLGMD} | {name: names[name] for name in NAMES}


def params_of(label, model):
    """The parameters of a variant; with the bands, a latency of 3 frames would be cut."""
    return model.params_class(**({"latency": "nearest"} if label == "Latency" else {}))


def draw(models, out):
    """Draw the membrane potentials of all models, a panel for each clip."""
    figure, axes = plt.subplots(1, len(CLIPS), figsize=(10, 3), layout="constrained", sharey=True)
    results = {
        (clip, label): dlgmd_cli.run(ROOT / f"sample_videos/{clip}.mp4", params_of(label, model))
        for clip in CLIPS
        for label, model in models.items()
    }
    for place, (clip, title) in zip(axes, CLIPS.items(), strict=True):
        for label in models:
            result = results[clip, label]
            peak = max(results[each, label].summary["mp_max"] or 0.0 for each in CLIPS)
            style = {"color": "black", "lw": 1.8} if label == "set 9" else {"lw": 1.2}
            place.plot(result.time_s, result.mp / peak, label=label, **style)
        place.set(title=f"{title} cube{'s' * (title == 'Translating')}", xlabel="Time (s)")
    axes[0].set_ylabel("MP / the model's highest")
    axes[0].legend(frameon=False, fontsize=8)
    figure.savefig(out, dpi=96)


def frame_ms(model, frames):
    """Time of a frame in ms of the processor."""
    medians = []
    for _ in range(3):
        times = []
        for frame in frames + frames[::-1]:
            start = time.process_time()
            model.step(frame)
            times.append(time.process_time() - start)
        medians.append(1e3 * statistics.median(times[10:]))
    return min(medians)


def main(out):
    """Draw and measure."""
    models = variants()
    draw(models, out)
    cv2.setNumThreads(1)
    with dlgmd_cli.open_video(ROOT / "sample_videos/group2.mp4", size_wh=SIZE_WH) as video:
        frames = [frame.grey.copy() for frame in islice(video.frames(), N_FRAMES)]
    usual = None
    for label, model in (models | {"layer by layer": Plain}).items():
        ms = frame_ms(create_model(params_of(label, model)), frames)
        usual = usual or ms
        print(f"{label:15} {ms:.2f} ms  {ms / usual:.2f}")


if __name__ == "__main__":
    main(*sys.argv[1:])
