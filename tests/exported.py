"""Exports of models as C, compiled and fed with frames."""

import ctypes
import shutil
import subprocess
from itertools import cycle

import numpy as np
import pytest

from dlgmd_cli import Alarm
from dlgmd_cli.microcontroller.export import C_RULES, NUMBERS, sources
from dlgmd_cli.models.expansion import Expansion
from dlgmd_cli.models.health import UNMEASURED
from dlgmd_cli.models.rules import LEAST_QUALITY
from dlgmd_cli.models.windows import Camera

CAMERA = Camera()
needs_cc = pytest.mark.skipif(
    not (shutil.which("cc") and shutil.which("make")), reason="cc and make are not installed"
)
WARNINGS = "-Wall -Wextra -Wpedantic -Wconversion -Wshadow -Wstrict-prototypes -Werror"
# The fields of `dlgmd_answer`, and where they are in a row of answers.
FLAGS = ("valid", "spike", "alarm", "rule", "has_ttc", "unmeasured")
NAMES = (*FLAGS, *NUMBERS)
ALARM, MP, MP_ABS, EXPANSION = map(NAMES.index, ("alarm", "mp", "mp_abs", "expansion"))
QUALITY, TTC_S, PLACE = EXPANSION + 2, EXPANSION + 3, slice(EXPANSION + 4, None)
G = slice(MP_ABS + 1, EXPANSION)


def write(export, folder):
    """Write the files of an export."""
    export.save(folder)
    return folder


def make(folder, *arguments):
    """Call make; what it printed."""
    done = subprocess.run(["make", "-s", *arguments], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"
    return done.stdout


class Answer(ctypes.Structure):
    """`dlgmd_answer`."""

    _fields_ = (
        *((name, ctypes.c_uint8) for name in FLAGS),
        *((name, ctypes.c_float) for name in NUMBERS),
    )


_LIBRARIES = {}


def compiled(export, folder, n_earlier=1):
    """The model and its health as a library; what is compiled already is not compiled again."""
    texts = sources(export)
    names = ("dlgmd.h", "dlgmd.c", "dlgmd_health.c", "dlgmd_model.h")
    key = n_earlier, *(texts[name] for name in names)
    if key not in _LIBRARIES:
        _LIBRARIES[key] = _compiled({name: texts[name] for name in names}, folder, n_earlier)
    return _LIBRARIES[key]


def _compiled(texts, folder, n_earlier):
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    library = folder / f"dlgmd-{len(list(folder.iterdir()))}.so"  # a loaded one stays loaded
    command = ["cc", "-std=c99", "-O1", *WARNINGS.split(), f"-DDLGMD_EARLIER={n_earlier}"]
    command += ["-shared", "-fPIC", "-o", str(library)]
    files = [str(folder / name) for name in ("dlgmd.c", "dlgmd_health.c")]
    subprocess.run([*command, *files], check=True)
    return ctypes.CDLL(str(library))


def answers_of_c(export, folder, frames, steps_ms=(0,), headings=(None,), n_earlier=1):
    """What the compiled model answers: columns as `NAMES`, (n, 16) float64.

    `steps_ms` are the times between frames, again and again, and `headings` the directions of
    flight in degrees, None for what the last one was. It keeps `n_earlier` frames.
    """
    c = compiled(export, folder, n_earlier)
    c.dlgmd_step_us.restype = Answer
    n_bytes = export.state_bytes(expands=True, evens=True, n_earlier=n_earlier)
    state = (ctypes.c_uint64 * (n_bytes // 8 + 1))()
    c.dlgmd_reset(state)
    rows = []
    for frame, step_ms, heading in zip(frames, cycle(steps_ms), cycle(headings), strict=False):
        if heading is not None:
            c.dlgmd_heading(state, *(round(100 * degrees) for degrees in heading))
        answer = c.dlgmd_step_us(state, address(frame), 1000 * step_ms)
        rows.append([getattr(answer, name) for name in NAMES])
    rows = np.array(rows, float)
    has_ttc, ttc_s = rows[:, FLAGS.index("has_ttc")] > 0, rows[:, TTC_S]
    assert np.array_equal(has_ttc, ttc_s < np.inf)
    rows[~has_ttc, TTC_S] = 0.0
    return rows


def address(frame):
    """Where C reads a frame."""
    return np.ascontiguousarray(frame).ctypes.data_as(ctypes.c_void_p)


def answers_of_python(params, frames, steps_ms=(0,), headings=(None,), camera=CAMERA):
    """The same of `Alarm`; 0 where it answers NaN, as C does."""
    alarm = Alarm(
        params,
        resize=False,
        repeats="keep",
        all_frames=True,
        times="capture",
        expansion=Expansion(camera=camera, looks_around=False),
    )
    rows, time_ms = [], 0
    for frame, step_ms, heading in zip(frames, cycle(steps_ms), cycle(headings), strict=False):
        if heading is not None:
            alarm.heading(*heading)
        time_ms += step_ms
        one = alarm.step(frame, time_ms / 1000.0 if step_ms else None)
        flags = one.is_valid, one.spike, one.alarm, C_RULES.index(one.rule), one.ttc_s > 0
        flags += (one.blind == UNMEASURED,)
        rows.append([*flags, *np.nan_to_num([getattr(one, name) for name in NUMBERS])])
    return np.array(rows, float)


def begins(answers):
    """The frames at which an alarm begins."""
    return np.flatnonzero(np.diff(answers[:, ALARM], prepend=0.0) > 0.0).tolist()


def signal(answers):
    """What the rule `expansion` compares."""
    rate = np.minimum(answers[:, EXPANSION], answers[:, EXPANSION + 1])
    return rate * np.minimum(answers[:, QUALITY] / LEAST_QUALITY, 1.0)


def assert_alike(export, answers, right):
    """Alarms begin at the same frames, and the neuron's answers are the same to 1e-5.

    With the rule `expansion`, only an alarm whose signal is within 0.06/s of the threshold, or
    whose quality is low, may differ. Where rates are precise, all are the same to 0.15, relative
    above 1/s, and half of them to 0.01: the last steps of points with little texture are rounded
    otherwise.
    """
    same = [NAMES.index(name) for name in ("valid", "spike", "rule")]
    assert np.array_equal(answers[:, same], right[:, same])
    if export.params.alarm == "expansion":
        differ = answers[:, ALARM] != right[:, ALARM]
        close = np.abs(signal(right) - export.params.expansion_alarm) < 0.06
        assert np.all((close | (right[:, QUALITY] < LEAST_QUALITY))[differ])
        assert np.mean(differ) < 0.1
    else:
        assert begins(answers) == begins(right)
    assert error_of_mp(export, answers, right).max() <= 1e-5
    assert np.abs(answers[:, MP_ABS] - right[:, MP_ABS]).max() <= 1e-5
    assert error_of_place(export, answers, right).max() <= 1e-5
    if not export.expands:
        assert np.array_equal(answers[:, ALARM], right[:, ALARM])
        return
    clear = right[:, QUALITY] >= LEAST_QUALITY
    assert np.abs(answers[clear, QUALITY] - right[clear, QUALITY]).max(initial=0.0) <= 0.1
    error = np.abs(answers[clear, EXPANSION] - right[clear, EXPANSION])
    error /= np.maximum(right[clear, EXPANSION], 1.0)
    assert error.max(initial=0.0) <= 0.15 and np.median([0.0, *error]) <= 0.01


def error_of_mp(export, answers, right):
    """By how much mp is wrong, (n,), as a share of itself and of mp where mp_abs is 1/2."""
    half = export.params.kappa * export.n_cells
    return np.abs(answers[:, MP] - right[:, MP]) / (right[:, MP] + half)


def error_of_place(export, answers, right):
    """By how much the centroid is wrong, times the share of mp in what mp is relative to, (n,)."""
    share = right[:, MP] / (right[:, MP] + export.params.kappa * export.n_cells)
    return share * np.abs(answers[:, G] - right[:, G]).max(axis=1)
