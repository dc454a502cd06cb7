"""A trial of a custom model: some frames, and what its class gets wrong."""

import difflib
import inspect
import math
from collections.abc import Iterator

import numpy as np

from dlgmd_cli.errors import counted
from dlgmd_cli.models.base import CustomModel, Model, Response, create_model
from dlgmd_cli.models.receptors import Grey
from dlgmd_cli.parameters.keys import Parameters

N_FRAMES = 20
# Large enough that the paper's sets respond.
_HEIGHT, _WIDTH = 270, 480
# Two answers are the same within this share; models may compute in single precision.
_TOLERANCE = 1e-3


def trial(params: Parameters) -> tuple[list[str], list[str]]:
    """Step a custom model over 20 frames of a noisy square that grows, twice in each data type.

    Returns
    -------
    facts, faults : list of str
        Lines about the answers, and about what is probably a mistake.

    Raises
    ------
    ModelError
        If the model fails, or answers with what is no valid response.
    """
    model, frames = create_model(params), _frames()
    first = [*_answers(model, frames)]
    mp = np.array([response.mp for response in first])
    defined = mp[model.first_valid_frame :]
    known = defined[~np.isnan(defined)]
    span = f", mp from {known.min():.4g} to {known.max():.4g}" if known.size else ""
    facts = [f"{counted(N_FRAMES, 'frame')}, the first {model.first_valid_frame} undefined{span}"]
    faults = _unused(model.model) if isinstance(model, CustomModel) else []
    if n_missing := defined.size - known.size:
        faults.append(f"step(): mp is NaN in {counted(n_missing, 'frame')} with a full history")
    if known.size and not known.any():
        faults.append("step(): mp is 0 in all frames, although the square grows")
    if (known < 0.0).any():
        n_below = counted(int((known < 0.0).sum()), "frame")
        faults.append(f"step(): mp is negative in {n_below}, where mp_abs is 0")
    model.reset()
    if not _agree(first, [*_answers(model, frames)], 0.0):
        faults.append("reset(): the same frames give another answer after it")
    floats = [(frame / np.float32(255.0)).astype(np.float32) for frame in frames]
    if not _agree(first, [*_answers(create_model(params), floats)], _TOLERANCE):
        faults.append("step(): uint8 and float32 frames differ; multiply by self.receptors.unit")
    return facts, faults


def _frames() -> list[Grey]:
    """Grey frames, (H, W) uint8, of a square that grows in front of noise."""
    rng, frames = np.random.default_rng(1), []
    back = rng.uniform(80, 120, (_HEIGHT, _WIDTH))
    for number in range(N_FRAMES):
        frame, half = back + rng.normal(0, 1, back.shape), 18 + 6 * number
        y, x = _HEIGHT // 2, _WIDTH // 2
        frame[y - half : y + half, x - half : x + half] = 200
        frames.append(frame.astype(np.uint8))
    return frames


def _answers(model: Model, frames: list[Grey]) -> Iterator[Response]:
    """The model's answers; as in a run, each frame has the memory of the one before."""
    memory = np.empty_like(frames[0])
    for number, frame in enumerate(frames):
        memory[:] = frame
        yield model.step(memory, number / 30)


def _agree(first: list[Response], again: list[Response], tolerance: float) -> bool:
    """Whether the answers have the same numbers."""

    def same(a: float, b: float) -> bool:
        is_nan = math.isnan(a) and math.isnan(b)
        return is_nan or math.isclose(a, b, rel_tol=tolerance, abs_tol=tolerance)

    return all(
        same(one.mp, other.mp) and all(map(same, one.more.values(), other.more.values()))
        for one, other in zip(first, again, strict=True)
    )


def _unused(model: Model) -> list[str]:
    """Public methods of the class that override nothing, and that the class does not call."""
    classes = type(model).__mro__
    ours = next(one for one in classes if one.__module__.startswith("dlgmd_cli."))
    own = [one for one in classes if not one.__module__.startswith("dlgmd_cli.")][:-1]
    known = [name for name in dir(ours) if not name.startswith("_")]
    called = {name for one in own for f in vars(one).values() if inspect.isfunction(f)
              for name in f.__code__.co_names}  # fmt: skip
    found = []
    for one in own:
        for name, value in vars(one).items():
            is_new = inspect.isfunction(value) and not name.startswith("_") and name not in known
            if is_new and name not in called:
                close = difflib.get_close_matches(name, known, 1)
                hint = f"; did you mean {close[0]}()?" if close else ""
                found.append(f"{name}(): it overrides nothing, and nothing calls it{hint}")
    return found
