"""How far OpenCV and PyAV differ: in grey levels, and in the peak of the membrane potential.

Not part of the test run. From the repository:

    python tests/benchmarks/bench_decoders.py [--random N] [--seed S]

An object of random texture approaches, once in grey and once in strong colours, in videos of other
pixel formats, colour matrices, ranges and depths. A row is a video: the mean and the greatest
difference of the frames in grey levels of 255, and for some parameter sets the greatest difference
of MP in percent of its peak. With --random, N parameter sets are drawn around the paper's set 9,
and a row has the median and the greatest of their differences instead, without sets whose MP is 0.
"""

import argparse
import subprocess
import tempfile
from pathlib import Path

import cv2
import numpy as np

import dlgmd_cli
from dlgmd_cli import open_video

N_FRAMES, WIDTH, HEIGHT = 60, 320, 180
# Name, codec, pixel format, colour matrix and range of the videos.
VIDEOS = (
    ("8 bits, BT.601", "ffv1", "yuv420p", "smpte170m", "tv"),
    ("8 bits, BT.709", "ffv1", "yuv420p", "bt709", "tv"),
    ("8 bits, BT.709, 4:4:4", "ffv1", "yuv444p", "bt709", "tv"),
    ("8 bits, BT.601, full range", "mjpeg", "yuvj420p", "smpte170m", "pc"),
    ("8 bits, BT.709, full range", "libx264", "yuvj420p", "bt709", "pc"),
    ("10 bits, BT.601", "ffv1", "yuv422p10le", "smpte170m", "tv"),
    ("10 bits, BT.709", "ffv1", "yuv422p10le", "bt709", "tv"),
    ("10 bits, BT.709, full range", "libx264", "yuv420p10le", "bt709", "pc"),
    ("10 bits, BT.2020", "ffv1", "yuv420p10le", "bt2020nc", "tv"),
    ("ProRes, 10 bits, BT.709", "prores_ks", "yuv422p10le", "bt709", "tv"),
    ("RGB", "ffv1", "gbrp", "", ""),
)
# The paper's set 9, what `flight` is, and a small kernel without thresholds.
SETS = ({"model": 9}, {"model": "flight"}, {"model": 9, "param": {"r": 1, "t_mp": 0.1}})


def images(tint):
    """Images of an approach, (n, H, W, 3) BGR; a tint is the share of each channel."""
    random, frames = np.random.default_rng(1), []
    far, near = (
        cv2.GaussianBlur(random.normal(size=(HEIGHT, WIDTH)), (0, 0), 2.0) for _ in range(2)
    )
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    middle = (WIDTH / 2, HEIGHT / 2)
    for number in range(N_FRAMES):
        size = 1.0 / (1.0 - number / (N_FRAMES + 6.0))
        grown = cv2.warpAffine(near, cv2.getRotationMatrix2D(middle, 0, size), (WIDTH, HEIGHT))
        inside = np.clip(8.0 * size + 0.5 - np.hypot(x - middle[0], y - middle[1]), 0.0, 1.0)
        grey = 150.0 + 250.0 * far * (1.0 - inside) + inside * (250.0 * grown - 70.0)
        part = inside[..., None]
        share = part * np.array(tint[::-1]) + (1.0 - part) * np.array(tint)
        frames.append(np.clip(grey[..., None] * share, 0, 255).astype(np.uint8))
    return np.stack(frames)


def encode(path, frames, codec, pixels, matrix, span):
    """Write the frames as such a video."""
    raw = ["-f", "rawvideo", "-pix_fmt", "bgr24", "-s", f"{WIDTH}x{HEIGHT}", "-r", "30", "-i", "-"]
    coded = [
        "-c:v",
        codec,
        "-pix_fmt",
        pixels,
        "-q:v",
        "1",
        "-crf",
        "0" if "10" not in pixels else "4",
    ]
    if matrix:
        out = "bt2020" if matrix == "bt2020nc" else matrix
        coded += ["-vf", f"scale=out_color_matrix={out}:out_range={span}:flags=accurate_rnd"]
        coded += ["-colorspace", matrix, "-color_range", span]
    command = ["ffmpeg", "-v", "error", "-y", *raw, *coded, path]
    subprocess.run(command, input=frames.tobytes(), check=True)


def greys(path, decoder):
    """The frames as models get them, in levels of 255."""
    with open_video(path, decoder=decoder) as video:
        frames = [frame.grey for frame in video.frames()]
    return np.stack([one if one.dtype == np.uint8 else one * 255.0 for one in frames]).astype(float)


def random_sets(count, seed):
    """Parameter sets around set 9: widths, radius, latency, weight and thresholds vary."""
    random = np.random.default_rng(seed)
    for _ in range(count):
        drawn = {
            "sigma_e": random.uniform(0.5, 3.0),
            "sigma_i": random.uniform(3.0, 8.0),
            "r": int(random.integers(1, 9)),
            "alpha": random.uniform(-0.5, 1.0),
            "lam": random.uniform(0.1, 2.0),
            "a": random.uniform(0.5, 2.0),
            "t0": random.uniform(0.0, 0.6),
            "t_mp": random.uniform(0.0, 0.6),
        }
        yield {"model": 9, "param": drawn}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--random", type=int, metavar="N")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    sets = SETS if given.random is None else list(random_sets(given.random, given.seed))
    heads = [one["model"] for one in SETS] if given.random is None else ["median", "greatest"]
    print(f"{'video':30}{'':8}{'mean':>7}{'max':>7}" + "".join(f"{head!s:>9}" for head in heads))
    with tempfile.TemporaryDirectory() as folder:
        for tint_name, tint in (("grey", (1, 1, 1)), ("colours", (0.2, 0.6, 1.0))):
            frames = images(tint)
            for name, *coded in VIDEOS:
                path = Path(folder) / "x.mkv"
                encode(path, frames, *coded)
                far = np.abs(greys(path, "opencv") - greys(path, "pyav"))
                parts = []
                for one in sets:
                    cv, av = (
                        dlgmd_cli.run(path, decoder=decoder, **one).mp
                        for decoder in ("opencv", "pyav")
                    )
                    if (peak := np.nanmax(np.abs(cv))) > 0.0:
                        parts.append(np.nanmax(np.abs(cv - av)) / peak * 100.0)
                if given.random is not None:
                    parts = [np.median(parts), np.max(parts)]
                shares = "".join(f"{part:9.2f}" for part in parts)
                print(f"{name:30}{tint_name:8}{far.mean():7.2f}{far.max():7.1f}{shares}")


if __name__ == "__main__":
    main()
