"""κ of every set and the other models' thresholds, derived anew from the labelled clips."""

import csv

import numpy as np
import pytest
from reference_data import reference_dir

from dlgmd_cli import DLGMD, load_set, open_video
from dlgmd_cli.models.emd_lgmd import EmdLGMD
from dlgmd_cli.models.lgmd import LGMD
from dlgmd_cli.parameters import EmdLgmdParameters, LgmdParameters

pytestmark = pytest.mark.slow

SECOND = 30  # frames
LABEL_ERROR = 2  # frames


@pytest.fixture(scope="module")
def clips():
    """Luminance of every labelled clip, with its contact frame or None."""
    folder = reference_dir() / "clips"
    with (folder / "labels.csv").open(encoding="utf-8") as file:
        labels = [(row["video"], row["collision_frame"]) for row in csv.DictReader(file)]
    found = []
    for video, contact in labels:
        with open_video(folder / video) as source:
            frames = [frame.luminance for frame in source]
        found.append((frames, int(contact) if contact else None))
    return found


def held(model, frames):
    """Mean excitation per cell that n_sp = 2 frames in a row reach, ending at each frame."""
    model.reset()
    mean = np.array([model.step(frame).mp for frame in frames]) / frames[0].size
    return np.concatenate(([np.nan], np.minimum(mean[1:], mean[:-1])))


def sides(clips, model):
    """The strongest excitation without contact, and the strongest before each contact."""
    without, before_contact = [], []
    for frames, contact in clips:
        strength = held(model, frames)
        if contact is None:
            without.append(np.nanmax(strength))
        else:
            window = strength[contact - SECOND : contact + LABEL_ERROR + 1]
            before_contact.append(np.nanmax(window))
    return max(without), before_contact


def crossing(clips, model):
    """Between the strongest excitation without contact and the weakest above it before one.

    Also how many contacts it misses.
    """
    quiet, before_contact = sides(clips, model)
    loud = min(value for value in before_contact if value > quiet)
    middle = np.sqrt(quiet * loud)
    return middle, sum(value < middle for value in before_contact)


def kappa_at(excitation, params):
    """mp_abs = k / (k + kappa) crosses t_mp at k = kappa t_mp / (1 - t_mp)."""
    return excitation * (1 - params.t_mp) / params.t_mp


@pytest.mark.parametrize("number", range(1, 10))
def test_kappa_is_what_the_clips_say(clips, number):
    params = load_set(number)
    excitation, missed = crossing(clips, DLGMD(params))
    # Two digits stand in the file.
    assert params.kappa == pytest.approx(kappa_at(excitation, params), rel=0.04)
    assert missed <= 1


def test_kappa_of_the_emd_lgmd(clips):
    params = EmdLgmdParameters()
    excitation, missed = crossing(clips, EmdLGMD(params))
    assert params.kappa == pytest.approx(kappa_at(excitation, params), rel=0.04)
    assert missed == 3


def test_threshold_of_the_lgmd(clips):
    # It was the middle while T_FFI was 25. Without that, it tells all clips apart still.
    params = LgmdParameters()
    excitation = np.log(params.t_mp / (1 - params.t_mp))  # t_mp = 1 / (1 + exp(-k))
    quiet, before_contact = sides(clips, LGMD(params))
    assert quiet < excitation < min(before_contact)
