"""Wrong calls: each is answered by one line with the call that works."""

import os
import shlex

import cv2
import numpy as np
import pytest
from conftest import looming_frames, write_video
from figures import make_result

import dlgmd_cli

# Arguments -> words of the line. The exit code is 2, and nothing is written.
WRONG = [
    # The order of words, and words of other tools.
    ("flight.mp4 run", "Did you mean 'dlgmd run flight.mp4'?"),
    ("--set 9 run flight.mp4", "Did you mean 'dlgmd run --set 9 flight.mp4'?"),
    ("--run flight.mp4", "Did you mean 'dlgmd run flight.mp4'?"),
    ("help", "Did you mean 'dlgmd --help'?"),
    ("help batch", "Did you mean 'dlgmd batch --help'?"),
    ("run help", "Did you mean 'dlgmd run --help'?"),
    ("version", "Did you mean 'dlgmd --version'?"),
    ("--verison", "Did you mean 'dlgmd --version'?"),
    ("analyze flight.mp4", "Did you mean 'dlgmd run flight.mp4'?"),
    ("Run flight.mp4", "Did you mean 'dlgmd run flight.mp4'?"),
    ("webcam 0", "Did you mean 'dlgmd live 0'?"),
    ("0", "Did you mean 'dlgmd live 0'?"),
    ("flights", "Did you mean 'dlgmd batch flights'?"),
    ("analyze", "Write 'dlgmd run flight.mp4'"),
    ("xyzzy", "'dlgmd --help' lists the commands."),
    ("sets chek fast:Fast", "unexpected argument: 'fast:Fast'"),
    ("plot out/flight mp", "Write 'dlgmd plot mp out/flight'."),
    # Names of files.
    ("run my clip.mp4", "Did you mean 'dlgmd run 'my clip.mp4''?"),
    ("batch my clip.mp4", "Did you mean 'dlgmd batch 'my clip.mp4''?"),
    ("run his video.mp4", "A name with spaces needs quotes"),
    ("run Flight.mp4", "Did you mean 'flight.mp4'?"),
    ("run ./flight", "Did you mean 'flight.mp4'?"),
    ("info fligth.mp4", "Did you mean 'flight.mp4'?"),
    ("batch Flights", "Did you mean 'flights'?"),
    ("compare FLIGHTS/A.mp4 --set 9", "Did you mean 'flights/a.mp4'?"),
    ("evaluate Labels.csv", "Did you mean 'labels.csv'?"),
    ("view Out/flight", "Did you mean 'out/flight'?"),
    ("run -dash.mp4", "Did you mean 'dlgmd run ./-dash.mp4'?"),
    # Dashes of word processors.
    ("run flight.mp4 --camera-tilt −10", "'−10' is not a number. Write -10."),
    # Options.
    ("run flight.mp4 --set9", "Did you mean 'dlgmd run flight.mp4 --set 9'?"),
    ("run flight.mp4 --Set 9", "Did you mean 'dlgmd run flight.mp4 --set 9'?"),
    ("run flight.mp4 --output x", "Did you mean 'dlgmd run flight.mp4 --out x'?"),
    ("run flight.mp4 --speed 3", "Did you mean 'dlgmd run flight.mp4 --speed-m-s 3'?"),
    ("sweep --x r=2,4 --y a=1,2 --start 3", "Other commands have it."),
    ("sweep --x r=2..6 --y a=1,2", "Write"),
    ("run flight.mp4 fov=90", "Did you mean 'dlgmd run flight.mp4 --fov=90'?"),
    ("run flight.mp4 set 9", "Did you mean 'dlgmd run flight.mp4 --set 9'?"),
    ("run flight.mp4 9", "Did you mean 'dlgmd run flight.mp4 --set 9'?"),
    ("run", "Missing argument 'INPUT'. Write 'dlgmd run flight.mp4'."),
    ("live --serve 8000", "Write 'dlgmd live 0 --serve 8000'."),
    ("run 0", "Did you mean 'dlgmd live 0'?"),
    ("batch 0", "Did you mean 'dlgmd live 0'?"),
    # One value, several, and ranges.
    ("run flight.mp4 --set 3,9", "'dlgmd compare' and 'dlgmd batch' run several."),
    ("run flight.mp4 --set 3-9", "'dlgmd compare' and 'dlgmd batch' run several."),
    ("compare flight.mp4 --set 3 9", "Did you mean 'dlgmd compare flight.mp4 --set 3 --set 9'?"),
    ("compare --set 3 9 flight.mp4", "Did you mean 'dlgmd compare --set 3 --set 9 flight.mp4'?"),
    ("batch flights --set 3 9", "Did you mean 'dlgmd batch flights --set 3 --set 9'?"),
    ("compare flight.mp4 --model lgmd,emd-lgmd", "flight.mp4 --model lgmd --model emd-lgmd'?"),
    ("run flight.mp4 --format pdf svg", "flight.mp4 --format pdf --format svg'?"),
    (
        "view out/flight --collision-frame 3,5",
        "--collision-frame 3 --collision-frame 5'?",
    ),
    # A value of another form, of another option, or in another unit.
    ("run flight.mp4 --threshold 50%", "is not a number. Write 0.5."),
    ("run flight.mp4 --threshold 0,5", "is not a number. Write 0.5."),
    ("run flight.mp4 --param lam=0,5", "lam = '0,5' is not a number. Write 0.5."),
    ("run flight.mp4 --fov 80°", "is not a number. Write 80."),
    ("run flight.mp4 --speed-m-s 36km/h", "'36km/h' is not a number."),
    ("synth looming-cube --noise 5%", "is not a number. Write 0.05."),
    ("run flight.mp4 --alarm 0.6", "'0.6' is a number. Write --threshold 0.6."),
    ("run flight.mp4 --threshold 80", "is more than 10. Choose 0.01 to 10 1/s."),
    ("run flight.mp4 --alarm ttc --threshold 500", "is more than 100. Choose 0.01 to 100 s."),
    ("run flight.mp4 --fov 300", "300 is more than 170. Choose 1 to 170 degrees."),
    # Options without effect: on this input, ...
    ("run flight.mp4 --bit-depth 12", "--bit-depth has no effect: it is for samples of 16 bits."),
    ("run frames --bit-depth 12", "--bit-depth has no effect"),
    ("run a.npy --bit-depth 12", "--bit-depth has no effect"),
    ("run flight.mp4 --topic /cam", "--topic has no effect: ROS bags alone have topics."),
    ("info frames flight.mp4 --topic /cam", "--topic has no effect"),
    ("run frames --decoder opencv", "--decoder has no effect: video files alone have a choice"),
    ("batch frames --decoder opencv", "--decoder has no effect"),
    ("compare flight.mp4 --size 24x48", "--size has no effect: the input has only 32x24 px."),
    ("batch flights --size 640x480", "--size has no effect"),
    ("sweep flight.mp4 --x r=2,4 --y a=1,2 --size 640x480", "--size has no effect"),
    ("live flight.mp4 --realtime --size 640x480", "--size has no effect"),
    ("run flight.mp4 --mask white.png", "--mask has no effect: none of its pixels is black."),
    # ... and beside another option.
    ("run flight.mp4 --set 9 --param ttc_alarm=1", "ttc_alarm has no effect with the rule spikes"),
    ("batch flights --param ttc_alarm=1", "ttc_alarm has no effect with the rule expansion"),
    ("evaluate labels.csv --tilt 20", "who brakes, and how, has no effect: no contact has a speed"),
    ("calibrate labels.csv --set 9 --fov 90", "--fov has no effect: no rule here uses the expan"),
    ("export --alarm spikes --fov 90", "--fov has no effect"),
    ("synth looming-cube --seed 5", "--seed works only with --noise."),
    ("sets 9 --overwrite", "--overwrite works only with --plot."),
    ("info flight.mp4 --overwrite", "--overwrite works only with --write-mask."),
    ("layers flight.mp4 --video x.mp4 --format pdf", "--format works only with --frames, beside"),
    ("compare flight.mp4 --one-panel --format none", "--one-panel works only with a figure"),
    ("view out/flight --no-film --input flight.mp4", "--input works only with the film"),
    ("live 0 --overwrite", "--overwrite works only with --record."),
    ("live 0 --pixel-format nv12", "--pixel-format works only with a pipe."),
    ("live 0 --mavlink-system 3", "--mavlink-system works only with --mavlink."),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Videos, images and a result, which no wrong call changes."""
    folder = tmp_path_factory.mktemp("mended")
    frames = looming_frames()
    for name in ("flight.mp4", "my clip.mp4", "-dash.mp4", "flights/a.mp4", "flights/b.mp4"):
        (folder / name).parent.mkdir(exist_ok=True)
        write_video(folder / name, frames, fourcc="mp4v")
    for name, factor in (("frames", 1), ("deep", 16)):
        (folder / name).mkdir()
        for number, frame in enumerate(frames):
            kind = np.uint8 if factor == 1 else np.uint16
            cv2.imwrite(str(folder / name / f"{number}.png"), frame.astype(kind) * factor)
    cv2.imwrite(str(folder / "white.png"), np.full((24, 32), 255, np.uint8))
    np.save(folder / "a.npy", np.stack(frames))
    (folder / "labels.csv").write_text("video,collision_frame\nflights/a.mp4,19\nflights/b.mp4,\n")
    make_result().save(folder / "out" / "flight")
    return folder


@pytest.mark.parametrize(("line", "words"), WRONG, ids=[line for line, _ in WRONG])
def test_a_wrong_call_is_answered_with_the_right_one(dlgmd, folder, monkeypatch, line, words):
    monkeypatch.chdir(folder)
    before = sorted(os.listdir("."))
    result = dlgmd(*shlex.split(line))
    *_, error = result.stderr.splitlines()
    assert result.exit_code == 2 and error.startswith("Error: ") and words in error
    assert error.count("Did you mean") < 2 and sorted(os.listdir(".")) == before


def test_python_takes_what_the_command_line_takes(folder, here):
    video = str(folder / "flight.mp4")
    assert dlgmd_cli.load_set("flight").alarm == "expansion"
    assert dlgmd_cli.run(video, start="0:00.4").time_s[0] == pytest.approx(0.4)
    for crop in ("16x12+0+0", (16, 12, 0, 0)):
        assert dlgmd_cli.run(video, 9, crop=crop).record["options"]["crop"] == "16x12+0+0"
    with dlgmd_cli.open_video(video, size_wh="16x12", start_s="0:00.4", crop=(24, 18, 0, 0)) as one:
        assert one.size_wh == (16, 12) and next(iter(one)).time_s == pytest.approx(0.4)
    report = dlgmd_cli.evaluate(
        folder / "labels.csv", threshold=0.6, jobs=1, baselines=False, alarm="expansion"
    )
    assert report.main("flight alarm=expansion")["threshold"] == 0.6


@pytest.mark.parametrize(
    ("call", "why"),
    [
        (lambda v: dlgmd_cli.run(v, start="soon"), "start = 'soon' is not a time"),
        (lambda v: dlgmd_cli.run(v, bit_depth=12), "bit_depth has no effect"),
        (lambda v: dlgmd_cli.run(v, 9, param={"ttc_alarm": 1.0}), "ttc_alarm has no effect"),
        (lambda v: dlgmd_cli.layers(v, 9, fov=90), "fov has no effect"),
        (lambda v: dlgmd_cli.calibrate("l.csv", threshold=0.5), "calibrate finds the threshold"),
        (lambda v: dlgmd_cli.live(0, start=5), "start works only with realtime"),
        (lambda v: dlgmd_cli.run(v.replace("flight", "Flight")), "Did you mean '.*flight.mp4'"),
        (lambda v: dlgmd_cli.run([v, v]), "batch takes several"),
        (lambda v: dlgmd_cli.run(v, set=9), "Name the set second"),
        (lambda v: dlgmd_cli.run(v, alarm=0.6), "Write threshold=0.6."),
        (lambda v: dlgmd_cli.layers(v, frames=3), "frames is not a list"),
        (lambda v: dlgmd_cli.plot("mp", v), "results are no path"),
        (lambda v: dlgmd_cli.Alarm().step(v), "a frame is an array"),
        (lambda v: dlgmd_cli.evaluate("."), "is a folder, not a table"),
        (lambda v: dlgmd_cli.info(v, overwrite=True), "overwrite works only with write_mask"),
        (lambda v: dlgmd_cli.run(v, scale="0,5"), r"scale = '0,5' is not a number. Write 0.5."),
    ],
)
def test_python_says_what_does_not_work(folder, call, why):
    with pytest.raises(dlgmd_cli.DlgmdError, match=why):
        call(str(folder / "flight.mp4"))
