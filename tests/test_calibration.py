"""κ of every set, derived anew from the labelled clips."""

import csv

import numpy as np
import pytest
from reference_data import reference_dir

from dlgmd_cli import DLGMD, load_set, open_source

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
        with open_source(folder / video) as source:
            frames = [frame.luminance for frame in source]
        found.append((frames, int(contact) if contact else None))
    return found


def held(params, frames):
    """Mean excitation per cell that n_sp = 2 frames in a row reach, ending at each frame."""
    model = DLGMD(params)
    mean = np.array([model.step(frame).mp for frame in frames]) / frames[0].size
    return np.concatenate(([np.nan], np.minimum(mean[1:], mean[:-1])))


@pytest.mark.parametrize("number", range(1, 10))
def test_kappa_is_what_the_clips_say(clips, number):
    params = load_set(number)
    without, before_contact = [], []
    for frames, contact in clips:
        strength = held(params, frames)
        if contact is None:
            without.append(np.nanmax(strength))
        else:
            window = strength[contact - SECOND : contact + LABEL_ERROR + 1]
            before_contact.append(np.nanmax(window))
    quiet = max(without)
    loud = min(value for value in before_contact if value > quiet)
    # mp_abs = k / (k + kappa) crosses t_mp at k = kappa t_mp / (1 - t_mp).
    crossing = np.sqrt(quiet * loud)
    kappa = crossing * (1 - params.t_mp) / params.t_mp
    assert params.kappa == pytest.approx(kappa, rel=0.04)  # two digits stand in the file
    missed = sum(value < crossing for value in before_contact)
    assert missed <= 1
