"""What commands refuse: one line that says why, the exit code, and nothing is written."""

import os
import shlex
import shutil
import sys

import pytest
from figures import make_result

NO_MODEL = "there is no model"
LINK = "live 0 --mavlink udp://127.0.0.1:9"
# Command lines in a folder with videos and a result, and words of the error.
WRONG_USAGE = [
    ("run loom.avi --set 12", "Invalid value for '--set': there is no set 12. Choose 1 to 9"),
    ("run loom.avi --set fligt", "there is no set fligt. Did you mean 'flight'? Choose 1 to 9, f"),
    # Each of the three options takes one kind of name.
    ("run loom.avi --set lgmd", "'--set': 'lgmd' is a model. Write --model lgmd."),
    ("run loom.avi --set my.yaml", "'my.yaml' is a file. Write --config my.yaml."),
    ("compare loom.avi --config flight", "'flight' is a preset. Write --set flight."),
    ("export --model 9", "'--model': '9' is a set. Write --set 9."),
    ("sweep --x a=1 --y r=2 --model my.yaml", "'my.yaml' is a file. Write --config my.yaml."),
    ("run loom.avi --param formulation=released", "not one of default, released-2021"),
    ("sets 9 --plot x.gif", "'x.gif' is no figure. Write kernels.png, .pdf or .svg."),
    ("sets lgmd --plot x.png", "only the D-LGMD model has kernels, not lgmd"),
    ("run loom.avi --set 1 --config x.yaml", "--set and --config exclude each other"),
    ("run loom.avi --config none.yaml", "none.yaml: there is no such file"),
    ("run loom.avi --param sigma_e=-1", "for '--param': sigma_e = -1 is not above 0."),
    ("run loom.avi --param sigma_x=1", "unknown parameter 'sigma_x'. Did you mean 'sigma_e'?"),
    ("run loom.avi --param nonsense", "'nonsense' is not KEY=VALUE"),
    ("run loom.avi --set 1 --param lam=0.7", "make the latency longer than 64 frames"),
    ("run loom.avi --model lgmx", f"{NO_MODEL} 'lgmx'. Did you mean 'lg"),
    ("run loom.avi --model lgmd --set 3", "--set works only with the D-LGMD model"),
    ("run loom.avi --model lgmd --param r=3", "unknown parameter 'r'. See 'dlgmd sets show lgmd'."),
    ("run loom.avi --model lgmd --param p1=0.9 --param p2=0.2", "makes every change grow for ever"),
    ("run loom.avi --scale 1.5", "--scale"),
    ("run loom.avi --size 0x5", "size 0x5"),
    ("run loom.avi --size wide", "'wide' is not WIDTHxHEIGHT"),
    ("run loom.avi --scale 0.5 --size 4x4", "--scale and --size exclude each other"),
    ("run loom.avi --fps -1", "--fps"),
    ("run loom.avi --start soon", "'soon' is not a time"),
    ("run loom.avi --start 2 --end 1", "--end 1 is not after --start 2"),
    ("run loom.avi --decoder vlc", "--decoder"),
    ("run rtsp://drone.local/stream", "live streams are not read"),
    ("run https://example.org/flight.mp4", "URLs are not read here"),
    ("run -", "standard input is not read"),
    ("run ''", "the name of the input is empty"),
    ("run loom.avi --out s3://bucket/x", "--out s3:/bucket/x/loom is a URL. Give a folder."),
    ("run loom.avi --clips s3://bucket/x", "--clips s3:/bucket/x is a URL. Give a folder."),
    ("batch ''", "the name of a folder is empty"),
    ("compare loom.avi --variant weak", "'--variant': 'weak' is not NAME:KEY=VALUE,…."),
    ("compare loom.avi --variant w:b", "'--variant': 'b' is not KEY=VALUE. Write r=4."),
    ("compare loom.avi --variant w:sigmae=1", "w: unknown parameter 'sigmae'. Did you mean"),
    ("compare loom.avi --variant w:a=1 --variant w:a=2", "'--variant': 'w' is given twice."),
    ("compare loom.avi --set 9 --label a --label b", "given 2 times, for 1 model. Give one for"),
    ("compare loom.avi --set 9 --variant w:a=1 --label a", "in this order: set9, w."),
    ("compare loom.avi --set 3 --set 9 --label a --label a", "'--label': 'a' is given twice."),
    ("compare loom.avi --label=", "'--label': must not be empty."),
    ("layers loom.avi --overlay", "--overlay works only with --video. Add --video film.mp4."),
    ("layers loom.avi --npz --video x.mp4", "--npz writes the layers of --frames."),
    ("layers loom.avi --frames 1,,2", "'' is not a frame number. Write 1,50,65."),
    ("layers loom.avi --frames 0,1,2,3,4,5,6,7,8,9,10,11,12", "13 frames are too many for one"),
    ("layers loom.avi --video x.avi", "'x.avi' does not end in .mp4. Write film.mp4."),
    ("sweep --x a=1 --y r", "Invalid value for '--y': 'r' is not an axis"),
    ("sweep --x a=1 --y a=2", "--x and --y are both a"),
    ("sweep --x a=-2:-1:0.5 --y r=4", "--x and --y: a = -2.0 is not at least 0"),
    ("sweep --x a=1 --y r=4 --param a=2", "--param sets a, which is an axis"),
    ("sweep --x a=1 --y r=4 --false-positive-frame 5", "--false-positive-frame works only with an"),
    ("sweep --x a=1 --y r=4 --cube-size 151", "cannot fit into an image of 200x150"),
    ("sweep --x a=1 --y r=4 --size 9x9", "Invalid value for '--size'"),
    ("sweep loom.avi --x a=1 --y r=4 --speed 1", "--speed works only without INPUT"),
    ("plot mp", "Missing argument 'RESULT...'."),
    ("plot x one", "there is no figure 'x'. Choose from mp, attenuation, spikes, ttc, overview."),
    ("plot mp one --mark x", "'x' is not FRAME:TEXT"),
    ("plot mp one one --label a", "--label is given 1 time, for 2 results"),
    ("plot mp one --out a.jpg", "png, pdf, svg, not as jpg. Give a.png"),
    ("plot mp one --xlim 2:1", "'--xlim': '2:1' is not FROM:TO. Write 1.5:2.5."),
    ("plot mp one --xlim 99:100", "--xlim shows no frame: the results are from 0 to "),
    (
        "plot mp one --align collision --collision-frame 1 --xlim 99:100",
        "--xlim shows no frame: the results are from ",
    ),
    ("plot mp one --emphasise two", "--emphasise: no result is called two. Choose from one."),
    ("plot mp one --collisions x.csv --collision-frame 3", "Give --collisions or "),
    ("plot overview one --ylim 0:1", "an overview has several"),
    ("plot spikes one --normalise sequence", "--normalise is for mp and overview"),
    ("plot mp one --mean", "--mean works only with --align collision"),
    *(
        (f"live loom.avi --realtime {option}", "works only with --speed-m-s. Add --speed-m-s.")
        for option in ("--react 0.2", "--brake 4", "--tilt 20", "--jerk 9")
    ),
    ("run loom.avi --bit-depth 7", "7 is not at least 8"),
    ("evaluate l.csv --results x --label a", "--label does not work with --results"),
    ("view bare --out page.pdf", "does not end in .html"),
    ("info loom.avi short.avi --write-mask mask.png", "one INPUT"),
    ("info loom.avi --write-mask mask.jpg", "does not end in .png"),
    ("completion", "Missing argument 'bash|zsh|fish'. Choose from: bash, zsh, fish"),
    ("sets show flght", "or file 'flght'. Did you mean 'flight'? Choose 1 to 9, flight"),
    ("export --model lgmd", "there is no C version of the model lgmd. Only dlgmd can"),
    ("export --physical", "No such option"),
    ("calibrate labels.csv --physical", "No such option"),
    ("export --size 15x40", "'--size': 15x40 is out of range. Choose sides"),
    ("export --size 640x480 --alarm ttc", "at most 262143 cells"),
    ("batch", "Missing argument 'FOLDER...'"),
    ("batch . --jobs 0", "Invalid value for '--jobs'"),
    ("batch . --jobs 2 --scheduler tcp://x:1", "--jobs does not work with --scheduler"),
    ("batch . --out ''", "'--out': must not be empty"),
    ("batch . --out nope://b/x", "there is no kind of URL called nope://"),
    ("run loom.avi --out x.png", "'x.png' is the name of a file. Give a folder for the files, s"),
    ("live - --input-size 0x0", "size 0x0 is not within 1 to 8192 px"),
    ("live - --input-size 9x9 --record x.mp4", "Invalid value for '--record': 'x.mp4' is the name"),
    ("live 0 --events", "works only with --jsonl or --udp"),
    ("live 0 --exec ''", "no program ''"),
    ("live 0 --serve ''", "--serve"),
    ("run loom.avi --sigma-e 2", "Did you mean 'dlgmd run loom.avi --param sigma_e=2'?"),
    ("run loom.avi --n-sp --quiet", "Did you mean 'dlgmd run loom.avi --param n_sp=VALUE'?"),
    ("run x.mp4 --set 9 --set 7", "--set is given 2 times"),
    ("run 'a\0b'", "an argument contains a NUL character."),
    ("run loom.avi --brake 4", "--brake works only with --speed-m-s. Add --speed-m-s."),
    ("batch . --brake 4", "--brake works only with --speed-m-s. Add --speed-m-s."),
    ("run loom.avi --speed-m-s 2 --brake vtol", "'--brake': 'vtol' is not a number. Write arduc"),
    ("evaluate labels.csv --react -1", "'--react': -1 is not at least 0"),
    ("evaluate labels.csv --brake 1e-6", "'--brake': 1e-06 is not at least 0.1"),
    (
        "evaluate labels.csv --brake 5 --jerk 8",
        "--tilt and --jerk exclude --brake 5. ",
    ),
    (
        "evaluate labels.csv --max-false-per-min x",
        "'--max-false-per-min': 'x' is not a number",
    ),
    ("export --prefix 2nd-", "'2nd-' cannot begin a name in C"),
    ("live 0 --lockstep", "--lockstep works only with a pipe"),
    ("live - --input-size 64x48 --input-fps 9", "--input-fps works only with"),
    ("live rtp://127.0.0.1:5004", "Save it as stream.sdp"),
    ("live stream.sdp", "there is no such file"),
    ("live -", "needs --input-size"),
    ("live gopher://x", "no kind of stream called gopher://"),
    ("live nothing.mp4", "there is no such source"),
    ("live loom.avi", "is a file, not a live source"),
    ("live 0 --realtime", "works only with files"),
    ("live rtsp://x --realtime", "works only with files"),
    ("live rtsp://x --input-size 9x9", "only with a pipe or a camera"),
    ("live loom.avi --realtime --keep-video", "--keep-video works only with --record"),
    ("live loom.avi --realtime --keep-last 5", "--keep-last works only with --record"),
    ("live 0 --mavlink-brake", "--mavlink-brake works only with --mavlink and --mavlink-modes"),
    (f"{LINK} --mavlink-modes GUIDED", "--mavlink-modes works only with --mavlink-brake"),
    (f"{LINK} --mavlink-brake --mavlink-modes ''", "works only with"),
    (f"{LINK} --mavlink-brake-mode BRAKE", "--mavlink-brake-mode works only with"),
    (f"{LINK} --mavlink-component 1", "'--mavlink-component': 1 is not at least 2"),
    (f"{LINK} --mavlink-brake --mavlink-modes AUTO --speed-m-s -1", "-1 is "),
    (
        f"{LINK} --mavlink-brake --mavlink-modes AUTO --speed-m-s 2",
        "Add --brake, or give --speed-m-s autopilot.",
    ),
    (
        f"{LINK.replace('live 0', 'live gone.mp4')} --mavlink-brake --mavlink-modes AUTO "
        "--speed-m-s 2 --brake px4",
        "there is no such source",
    ),
    (f"{LINK} --speed-m-s autopilot --set 9", "works only with the rules expansion, corridor"),
    (f"{LINK} --speed-m-s autopilot --record x", "a result has one threshold"),
    (f"{LINK} --speed-m-s 0", "Invalid value for '--speed-m-s'"),
    ("live 0 --speed-m-s autopilot", "autopilot works only with --mavlink"),
    ("run loom.avi --mask no.png", "does not exist"),
    ("run loom.avi --mask loom.avi", "cannot be read as an image"),
    ("run loom.avi --mask pipe", "cannot be read as an image"),
    ("synth", "Missing argument 'SCENE'"),
    ("synth looming-cub", "there is no scene 'looming-cub'. Did you mean 'looming-cube'? Choose"),
    ("synth translating-cubes --distance 3", "--distance: translating-cubes has no such option."),
    ("synth looming-cube --size 9000x48", "size 9000x48 is not within 1 to 8192 px"),
    ("synth looming-cube --fps nan", "nan is not a finite number."),
    ("synth looming-cube --contrast 0.5", "0.5 on a background of 0.8 makes the object brighter"),
    ("synth looming-cube --background 0", "is not above 0. Choose above 0 to 1."),
    ("synth looming-cube --frames 76", "'--frames': contact comes after 75 frames"),
    ("synth looming-cube --speed 0.001", "'--speed': contact comes only after 225000 "),
    ("synth looming-cube --speed 1 --speed 2", "'--speed': the scene takes one value, not 2"),
    ("synth translating-cubes --speed 1 --speed 0", "every square needs a speed other than 0"),
    ("synth translating-cubes --speed 10 --frames 47", "leaves the image after 46 frames"),
    ("synth translating-cubes --object-size 68", "Choose 67 px or less."),
    # What no video can hold.
    ("synth looming-cube --size 64x47", "64x47 is odd, "),
    ("synth looming-cube --size 63x48", "Choose 64x48"),
    ("synth looming-cube --fps 29.97003", "decimals, which this video does not keep"),
    ("synth looming-cube --fps 119.999 --mp4", "MPEG-4 cannot hold 119.999"),
    # Common mistakes, and what to type instead.
    ("loom.avi", "no such command 'loom.avi'. Did you mean 'dlgmd run loom.avi'?"),
    ("run loom.avi -set 9", "Did you mean 'dlgmd run loom.avi --set 9'?"),
    ("batch . -param r=4", "Did you mean 'dlgmd batch . --param r=4'?"),
    ("run loom.avi --param r 4", "Did you mean 'dlgmd run loom.avi --param r=4'?"),
    ("run loom.avi 'b c.mp4'", "'dlgmd batch' takes several videos."),
    ("run loom.avi --threshold high", "'--threshold': 'high' is not a number"),
    ("run loom.avi --threshold -1", "'--threshold': expansion_alarm = -1"),
    ("batch . --set 9 --threshold 2", "'--threshold': t_mp = 2"),
    ("evaluate l.csv --results x --threshold 1", "--threshold does not work with --results"),
    ("run loom.avi --speed-m-s 3 --threshold 1", "--speed-m-s and --threshold exclude each other"),
    ("run loom.avi --speed-m-s 3 --set 9", "works only with the rules expansion, corridor"),
    ("run loom.avi --speed-m-s fast", "'--speed-m-s': 'fast' is not a number"),
    ("run loom.avi 9", "unexpected argument: '9'."),
    ("plot one", "Write 'dlgmd plot mp one'."),
    ("plot one/mp.csv", "Write 'dlgmd plot mp one/mp.csv'."),
    ("evaluate one", "For results, write 'dlgmd evaluate LABELS.csv --results one'."),
    ("calibrate one", "'one' is a folder, not a table of labels."),
    ("run loom.avi --model mymodel.py", "is a file. Write --model mymodel:CLASS."),
    ("run loom.avi --model ./lib/my.py:Mine", "is a file. Write --model lib.my:Mine."),
]
FAILURES = [
    ("run '*.avi'", "cannot be read as an image. A pattern is for images; for several videos"),
    ("run none.mp4", "none.mp4: there is no such file or folder"),
    ("run loom.avi --crop 32x24+1+0", "--crop 32x24+1+0 reaches outside its frames of 32x24."),
    ("run bare", "bare: there is no image in this folder. For the videos in a folder, use 'dl"),
    ("run empty.mp4", "empty.mp4: the file is empty"),
    ("run text.mp4", "text.mp4: no frame could be decoded, damaged file or missing codec."),
    ("run pipe", "pipe: is a pipe or a device; only files are read"),
    ("run /dev/null", "/dev/null: is a pipe or a device"),
    ("run short.avi --set 9", "short.avi: 3 frames, but set9 needs at least 4. Use a longer clip."),
    (
        "run loom.avi --set 9 --start 100",
        "leave fewer than the 4 frames that set9 needs. Its last frame read is at 0.760 s.",
    ),
    ("layers loom.avi --frames 20", "Choose from 0 to 19."),
    (
        "layers loom.avi --frames 2 --start 0.4",
        "--start, --end, --fps and duplicates leave frames out",
    ),
    ("layers loom.avi --video x.mp4 --end 0.05", "--start, --end and --fps leave fewer than"),
    ("plot mp one/mp.csv", "is one file of a result. Give the folder that holds it."),
    ("plot mp loom.avi", "Run 'dlgmd run"),
    ("info loom.avi --write-mask mask.png", "no pixels stay the same"),
    ("batch bare", "bare: there is no video"),
    ("live - --input-size 8x8", "it ended before its first frame"),
    ("live 9999", "the camera cannot be opened"),
    ("live /dev/video9999", "there is no such camera"),
    ("live nothing.mp4 --realtime", "nothing.mp4"),
    ("run loom.avi --log no/a.log", "--log: no/a.log: cannot be written (No such file or dir"),
    ("batch nowhere", "nowhere: cannot be read (No such file"),
]
PAGES = [
    ("view bare", "contains no result (no run.yaml or compare.yaml)"),
    ("view nowhere", "there is no such folder"),
    ("view bare --labels missing.csv", "missing.csv"),
]
# A package that is not there, and the extra that has it.
MISSING = [
    ("run loom.avi --decoder pyav", "av", "fast]', or use"),
    ("view one", "jinja2", "view]'."),
    ("view one", "plotly.offline", "view]'."),
    ("live loom.avi --realtime --serve 0", "uvicorn", "live]'."),
    ("live loom.avi --realtime --mavlink udp://127.0.0.1:9", "pymavlink", "live]'."),
]


@pytest.fixture(scope="module")
def stocked(clips, tmp_path_factory):
    """A folder with a few files, which no command changes."""
    folder = tmp_path_factory.mktemp("stocked")
    for name in ("loom.avi", "short.avi"):
        shutil.copy(clips / name, folder)
    (folder / "empty.mp4").touch()
    (folder / "text.mp4").write_text("hello")
    (folder / "bare").mkdir()
    os.mkfifo(folder / "pipe")
    make_result().save(folder / "one")
    return folder


@pytest.fixture
def refused(dlgmd, stocked, monkeypatch):
    """Call a command in that folder: `refused(line)` -> code and error."""
    monkeypatch.chdir(stocked)

    def call(line):
        before = sorted(os.listdir("."))
        result = dlgmd(*shlex.split(line))
        assert sorted(os.listdir(".")) == before
        *rest, error = result.stderr.splitlines()
        assert error.startswith("Error: ")
        usage = f"Usage: dlgmd {line.split()[0]} "
        of_tool = "Usage: dlgmd [OPTIONS] COMMAND"
        assert len(rest) <= 1 or line.startswith("info ")
        assert not rest or rest[0].startswith((usage, of_tool)) or line.startswith("info ")
        return result.exit_code, error

    return call


@pytest.mark.parametrize(("line", "why"), WRONG_USAGE, ids=[line for line, _ in WRONG_USAGE])
def test_wrong_usage_is_exit_2(refused, line, why):
    code, error = refused(line)
    assert code == 2 and why in error and len(error) < 1000


@pytest.mark.parametrize(("line", "why"), FAILURES, ids=[line for line, _ in FAILURES])
def test_a_failure_is_exit_1(refused, line, why):
    code, error = refused(line)
    assert code == 1 and why in error


@pytest.mark.parametrize(("line", "package", "extra"), MISSING)
def test_a_package_that_is_not_installed_is_named_with_its_extra(
    refused, monkeypatch, line, package, extra
):
    if package.startswith("plotly"):
        pytest.importorskip("jinja2", reason="pages need it, too")
    for module in ("serve", "connections"):
        monkeypatch.delitem(sys.modules, f"dlgmd_cli.watch.{module}", raising=False)
    monkeypatch.setitem(sys.modules, package, None)
    code, error = refused(line)
    name = package.removesuffix(".offline")
    hint = f"Install it from the clone: pip install '.[{extra}"
    why = f"the package '{name}' is not installed. {hint}"
    assert code == 1 and why in error


@pytest.mark.parametrize(("line", "why"), PAGES, ids=[line for line, _ in PAGES])
def test_what_is_no_page(refused, line, why):
    for package in ("jinja2", "plotly"):
        pytest.importorskip(package, reason="pages need it")
    code, error = refused(line)
    assert code == 1 and why in error
