"""The wheel and the sdist: their files, and the command in an environment without any extra.

Usage: package.py UV, in the root of a clean tree; needs `build` and `twine`.
"""

import os
import shlex
import shutil
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from pathlib import Path

ROOT = Path.cwd()
VIDEO = "looming-cube.mp4"
# What needs an extra, and the words that say which; exit code 1, and one line on stderr.
WITHOUT_EXTRAS = {
    "view done/looming-cube --out x.html": ".[view]",
    f"live {VIDEO} --realtime --serve 0": ".[live]",
    f"live {VIDEO} --realtime --mavlink udpout:127.0.0.1:14550": ".[live]",
    "run flight.mcap": ".[ros]",
    **{f"{name} {VIDEO} --decoder pyav": ".[fast]" for name in ("run", "info")},
    **{f"lab {name}": ".[lab]" for name in ("fly", "paper", "bench", "measure")},
    f"batch {VIDEO} --scheduler tcp://127.0.0.1:1": ".[cluster]",
    "batch s3://bucket/x": ".[cluster]",
    f"batch {VIDEO} --out s3://bucket/x": ".[cluster]",
}


def files_below(*folders: str) -> set[str]:
    """The files of the tree below some of its folders, by their paths."""
    return {
        path.relative_to(ROOT).as_posix()
        for folder in folders
        for path in (ROOT / folder).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }


def check_files(wheel: Path, sdist: Path) -> None:
    """The wheel has the package and its configs, and no more; the sdist the tests as well."""
    ours = files_below("dlgmd_cli")
    assert {Path(name).suffix for name in ours} >= {".c", ".yaml", ".j2", ".html", ".typed"}
    expected = ours | {f"dlgmd_cli/{name}" for name in files_below("configs")}
    with zipfile.ZipFile(wheel) as file:
        found = {name for name in file.namelist() if ".dist-info/" not in name}
    assert found == expected, found ^ expected
    with tarfile.open(sdist) as file:
        found = {name.partition("/")[2] for name in file.getnames()}
    expected = files_below("dlgmd_cli", "configs", "tests", "sample_videos", "docs/lab")
    expected |= {f"docs/{path.name}" for path in (ROOT / "docs").glob("*.*")}
    expected |= {"pyproject.toml", "README.md", "LICENSE", "CHANGELOG.md", "CITATION.cff"}
    assert expected <= found, expected - found


def check_commands(dlgmd: Path, folder: Path) -> None:
    """The sample runs, from another folder; what needs an extra says so."""
    shutil.copy(ROOT / "sample_videos" / VIDEO, folder)
    (folder / "flight.mcap").write_bytes(b"\x89MCAP0\r\n")

    def call(line: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [dlgmd, *shlex.split(line)], cwd=folder, capture_output=True, text=True, timeout=120
        )

    done = call(f"run {VIDEO} --out done")
    assert done.returncode == 0 and (folder / "done/looming-cube/mp.png").stat().st_size, done
    assert call("synth receding-cube --size 64x36 --frames 5").returncode == 0
    for line, words in WITHOUT_EXTRAS.items():
        done = call(line)
        one_line = done.stderr.startswith("Error: ") and done.stderr.count("\n") == 1
        assert done.returncode == 1 and one_line and words in done.stderr, (line, done)


def main() -> None:
    """Build, check and install in an empty environment."""
    uv = sys.argv[1]
    with tempfile.TemporaryDirectory() as scratch:
        dist, bare, elsewhere = (Path(scratch, name) for name in ("dist", "bare", "elsewhere"))
        run = lambda *words: subprocess.run([*map(str, words)], check=True)  # noqa: E731
        run(sys.executable, "-m", "build", "--outdir", dist, ".")
        (wheel,), (sdist,) = dist.glob("*.whl"), dist.glob("*.tar.gz")
        run(sys.executable, "-m", "twine", "check", "--strict", wheel, sdist)
        check_files(wheel, sdist)
        run(uv, "venv", "-q", "--python", sys.executable, bare)
        scripts = bare / ("Scripts" if os.name == "nt" else "bin")
        run(uv, "pip", "install", "-q", "--python", scripts / "python", wheel)
        elsewhere.mkdir()
        check_commands(scripts / "dlgmd", elsewhere)
    print(f"{wheel.name} and {sdist.name}: built, checked, installed; the sample runs")


if __name__ == "__main__":
    main()
