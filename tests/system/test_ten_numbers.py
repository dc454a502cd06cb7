"""What a reader computes from the CSVs, rows with `repeat` = 0, is what we print: ten numbers."""

import os
from pathlib import Path

import numpy as np
import pytest

import dlgmd_cli
from dlgmd_cli import read_result, read_results

pandas, stats = pytest.importorskip("pandas"), pytest.importorskip("scipy.stats")
REFERENCE = os.environ.get("DLGMD_REFERENCE", "")
CLIPS = Path(REFERENCE) / "clips"
# A frame far from the collision, at which a van passes.
OTHER = 30

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not (REFERENCE and CLIPS.is_dir()), reason="DLGMD_REFERENCE is not set"),
    pytest.mark.filterwarnings("ignore::dlgmd_cli.DlgmdWarning"),
]


def new_rows(folder):
    """The tables of a result, without the rows of duplicates, side by side."""
    names = ("mp.csv", "attenuation.csv", "spikes.csv")
    tables = [pandas.read_csv(folder / name) for name in names]
    table = pandas.concat(tables, axis=1)
    table = table.loc[:, ~table.columns.duplicated()]
    return table[table["repeat"] == 0].reset_index(drop=True)


def numbers_by_pandas(new):
    db = new.attenuation_db.replace([np.inf, -np.inf], np.nan)
    defined = new[new.attenuation_db.notna()]
    mp, peak = new.mp, new.mp.idxmax()
    near = {at: mp[(new.frame - at).abs() <= 5].mean() for at in (new.frame[peak], OTHER)}
    return {
        "spikes": new.spike.sum(),
        "first_spike_time_s": new.time_s[new.spike == 1].iloc[0],
        "mp_max": mp.max(),
        "mp_max_frame": new.frame[peak],
        "mean_attenuation_db": db.mean(),
        "attenuation_frames": db.count(),
        "median_attenuation_db": defined.attenuation_db.median(),
        "pooled_attenuation_db": 10 * np.log10(defined.s_sum.sum() / defined.p_sum.sum()),
        "sharpness": (mp[3:] / mp[3:].max()).mean(),
        "distinguishability": near[new.frame[peak]] / near[OTHER],
    }


def test_ten_numbers_of_a_video_with_duplicates(tmp_path, capsys):
    dlgmd_cli.run(CLIPS / "c02.mp4", 9, out=tmp_path)
    result = read_result(tmp_path / "c02")
    assert result.is_repeat.sum() == 32 and result.spikes.sum() == 13
    ours = {**result.summary, "sharpness": result.sharpness}
    ours["distinguishability"] = result.distinguishability(OTHER)
    theirs = numbers_by_pandas(new_rows(tmp_path / "c02"))
    with capsys.disabled():
        for name, value in theirs.items():
            print(f"\n{name:24} {value:<14.9g} {ours[name]:.9g}", end="")
    assert len(theirs) == 10
    assert {name: ours[name] for name in theirs} == pytest.approx(theirs, rel=1e-7)


def test_scores_and_the_auc_follow_from_the_tables(tmp_path):
    given = {"model": 9, "out": tmp_path, "jobs": 1}
    dlgmd_cli.batch(CLIPS, **given)
    rows = pandas.DataFrame(read_results(tmp_path)).query("repeat == 0")
    found = dlgmd_cli.evaluate(CLIPS / "labels.csv", baselines=False, model=9, jobs=1)
    windows = pandas.DataFrame(found.window_table)
    sustained = {}
    for video, part in rows.groupby("video"):
        size = read_result(tmp_path / Path(video).stem).record["processed"]
        excitation = part.set_index("time_s").mp / (size["width"] * size["height"])
        sustained[video] = excitation.rolling(2).min()  # n_sp = 2
    scores = [
        sustained[window.video].loc[window.start_s - 1e-6 : window.end_s - 1e-6].max()
        for window in windows.itertuples()
    ]
    np.testing.assert_allclose(windows.score, scores, rtol=1e-6)
    is_hit = windows.collision_frame.notna()
    n_pairs = is_hit.sum() * (~is_hit).sum()
    auc = stats.mannwhitneyu(np.array(scores)[is_hit], np.array(scores)[~is_hit]).statistic
    assert auc / n_pairs == pytest.approx(found.table["auc"][0], abs=1e-9)
