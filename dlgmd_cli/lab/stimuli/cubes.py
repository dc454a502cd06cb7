"""The translating cubes of a sweep, [Zhao2023] Fig. 11: one clip for each speed."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

from dlgmd_cli.frame import Frame
from dlgmd_cli.lab.stimuli.flat import Translation, TranslationOptions
from dlgmd_cli.runs.sweep import SweepInput

# The paper's Fig. 11: its parameters, except for those that it varies (no latency, as a comment in
# the paper's source says; a and r are ours); speeds in px/frame, side of the cubes in px, and size.
FIG_11 = {"alpha": 0.0, "beta": 0.0, "lam": 0.0, "a": 1.5, "r": 4}
SPEEDS_PX, SIDE_PX, SIZE_WH = (1.0, 2.0, 3.0, 4.0), 40.0, (200, 150)


def cube_input(
    speeds_px: Sequence[float],
    side_px: float,
    n_frames: int | None,
    size_wh: tuple[int, int],
    reach_px: int,
) -> SweepInput:
    """Black cubes that translate over white; rows farther than `reach_px` from them are cut off.

    By default, all clips are as long as the fastest cube stays in the picture, 75 frames at most.
    """
    scene = Translation("translating-cubes", "", TranslationOptions())
    (width, height), speeds_px = size_wh, tuple(dict.fromkeys(speeds_px))
    flags: dict[str, Any] = {"--size": (height, width), "--frames": n_frames}
    flags |= {"--object-size": side_px, "--contrast": -1.0, "--background": 1.0}
    each = [scene.configure({**flags, "--speed": (speed,)}) for speed in speeds_px]
    if n_frames is None:
        n_frames = min(map(scene.n_frames, each))
        # With an odd number, cubes with whole px/frame stay aligned to pixels.
        n_frames -= 1 - n_frames % 2
    above = max(0, int((height - side_px) / 2) - reach_px - 1)

    def frames(options: TranslationOptions) -> Iterator[Frame]:
        for index, picture in enumerate(scene.frames(options)):
            yield Frame(index, index / options.fps, picture[above : height - above])

    clips = [frames(replace(options, n_frames=n_frames)) for options in each]
    record = {"frames": n_frames, "width": width, "height": height}
    settings = {"cubes": {"speeds_px": list(speeds_px), "side_px": side_px, **record}}
    return SweepInput(scene.name, size_wh, clips, settings, speeds_px)
