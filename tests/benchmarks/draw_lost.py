"""Frames of the flights whose drone is lost, 0.4 s before the collision, ten at most.

    python tests/benchmarks/draw_lost.py LABELS.csv SCORES lost.png

LABELS.csv is what `dlgmd synth random` wrote, SCORES the folder that `dlgmd evaluate` wrote with
`--config flight`.
"""

import csv
import sys
from pathlib import Path

import cv2
import matplotlib.pyplot as plt


def main(labels, scores, out):
    """Draw the sheet."""
    with open(Path(scores) / "alarms.csv", encoding="utf-8") as file:
        alarms = [row for row in csv.DictReader(file) if row["model"] == "flight"]
    stopped = {row["video"] for row in alarms if row["saved"] == "1"}
    lost = dict.fromkeys(row["video"] for row in alarms if row["saved"] == "0")
    with open(labels, encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["video"] in lost.keys() - stopped]
    figure, axes = plt.subplots(2, 5, figsize=(10, 2.9), layout="constrained")
    for place in axes.flat:
        place.axis("off")
    for place, row in zip(axes.flat, rows, strict=False):
        video = cv2.VideoCapture(str(Path(labels).parent / row["video"]))
        video.set(cv2.CAP_PROP_POS_FRAMES, int(row["collision_frame"]) - 12)
        place.imshow(cv2.cvtColor(video.read()[1], cv2.COLOR_BGR2RGB))
        impacts = [
            a["impact_m_s"] for a in alarms if a["video"] == row["video"] and a["impact_m_s"]
        ]
        place.set_title(f"{row['target']}, hit at {float(impacts[0]):.1f} m/s", fontsize=8)
    figure.savefig(out, dpi=90)


if __name__ == "__main__":
    main(*sys.argv[1:])
