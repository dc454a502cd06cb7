"""Records of strangers: whatever a key holds, every reader gives a result or one line."""

import os
import random
import time
from copy import deepcopy

import pytest
import yaml
from click.testing import CliRunner

from dlgmd_cli.commands.app import cli
from dlgmd_cli.errors import DlgmdError
from dlgmd_cli.pages.gather import gather
from dlgmd_cli.pages.page import Part, _drawer
from dlgmd_cli.results.labels import read_cases
from dlgmd_cli.results.reading import read_comparison, read_result
from dlgmd_cli.results.record import read_record
from dlgmd_cli.tasks.batch.batch import Batch, plan
from dlgmd_cli.tasks.batch.find import find_videos
from dlgmd_cli.tasks.batch.video import Job
from dlgmd_cli.tasks.call import Request, choose, input_options
from dlgmd_cli.tasks.evaluate.candidates import Candidates, stored_results

pytestmark = pytest.mark.slow
DUMPER = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
THOROUGH = bool(os.environ.get("DLGMD_THOROUGH"))
ABSENT = "…absent"
BAD = {
    "absent": ABSENT,
    **{repr(one): one for one in (None, True, -1, 0, 5, 2.5, 1e300, float("nan"), float("inf"))},
    **{
        repr(one): one
        for one in ("", "x", "abc\x1b[2J", "9" * 5000, [], [[]], [5, "x"], {}, {5: 1})
    },
    "a mapping": {"path": 1, "fps": [], "crop": None, "label": {}, "a": {"b": ["c"]}},
    "400 digits": 10**400,
    "a negative one": -(10**400),
    "a date": yaml.safe_load("2020-01-01"),
    "bytes": b"\xff",
}


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """Results of a run in a batch and of a comparison, as the readers find them."""
    folder = tmp_path_factory.mktemp("strange")
    from conftest import looming_frames, write_video

    write_video(folder / "loom.avi", looming_frames())
    (folder / "labels.csv").write_text("video,collision_frame\nloom.avi,19\n")
    for arguments in (
        ["run", folder / "loom.avi", "--size", "16x12", "--out", folder / "b"],
        ["compare", folder / "loom.avi", "--set", "3", "--set", "9", "--out", folder / "c"],
    ):
        result = CliRunner().invoke(cli, [*map(str, arguments), "--no-plots"])
        assert result.exit_code == 0, result.output
    (folder / "b/summary.csv").touch()  # as of a batch
    return folder


def places(document, above=()):
    """The path of every key and item in a document."""
    items = document.items() if isinstance(document, dict) else enumerate(document)
    for key, value in items:
        yield (*above, key)
        if isinstance(value, dict | list):
            yield from places(value, (*above, key))


def changed(document, place, value):
    """A document with another value, or none, in one place, as YAML."""
    copy = deepcopy(document)
    inner = copy
    for key in place[:-1]:
        inner = inner[key]
    if value is ABSENT:
        del inner[place[-1]]
    else:
        inner[place[-1]] = value
    return yaml.dump(copy, Dumper=DUMPER)


def view(folder):
    """What `dlgmd view` takes from records."""
    for one in gather([folder]).inputs:
        for labelled in one.results:
            _drawer(Part(labelled.label, labelled.result, None, ""))


def batch(folder):
    """What `dlgmd batch` reads and shows again."""
    setup = choose()
    found = find_videos([str(folder / "loom.avi")], [], ())
    options = input_options(setup, {"size": (16, 12)})
    asked = Request((setup,), options)
    job = Job(asked, (str(folder / "b"),), (), 100, overwrite=True)
    tasks, (summary,) = plan(found.videos, job)
    done = Batch(job, str(folder / "b"), found.videos, found.faults, tasks, [summary])
    list(done.shown())
    summary.write()


def evaluate(folder):
    candidates = Candidates()
    for case, found in stored_results(folder / "b", read_cases(folder / "labels.csv")):
        if isinstance(found, DlgmdError):
            raise found
        candidates.add(case, found)


def config(path):
    input_options(choose(path), {})


@pytest.mark.parametrize("name", ["b/loom/run.yaml", "c/loom/compare.yaml"])
def test_a_value_of_any_kind_in_any_place(stored, name):
    path = stored / name
    whole = path.read_text()
    document, readers = yaml.safe_load(whole), {}
    if path.name == "run.yaml":
        document |= {"collision_frame": 19, "warnings": ["x"]}
        readers |= {
            "read_result": lambda: read_result(path.parent).summary,
            "batch": lambda: batch(stored),
            "evaluate": lambda: evaluate(stored),
            "config": lambda: config(path),
        }
    else:
        readers["read_comparison"] = lambda: read_comparison(path.parent)
    readers["view"] = lambda: view(path.parent)
    faults, n_tried, chance = [], 0, random.Random(1)
    try:
        # Without a change, every reader takes it.
        for read in readers.values():
            read()
        for place in places(document):
            for kind, value in BAD.items():
                path.write_text(changed(document, place, value))
                # Each change is read by one of the readers, drawn by chance, or by all.
                for reader in readers if THOROUGH else chance.sample([*readers], 1):
                    read = readers[reader]
                    n_tried += 1
                    try:
                        read()
                    except DlgmdError as error:
                        assert "\n" not in str(error)
                    except Exception as error:
                        faults.append(f"{reader}: {place} = {kind}: {error!r}"[:300])
    finally:
        path.write_text(whole)
    assert not faults, f"{len(faults)} of {n_tried}:\n" + "\n".join(faults[:60])
    assert n_tried > 500


BOMBS = {
    "brackets": "[" * 50_000,
    "braces": "{a: " * 50_000,
    "dashes": "- " * 50_000,
    "keys": "? " * 50_000,
    "indents": "\n".join(" " * n + "a:" for n in range(1300)),
    "references": "a: &a [x,x,x,x,x,x,x,x,x]\n"
    + "".join(
        f"{chr(n + 1)}: &{chr(n + 1)} [{','.join([f'*{chr(n)}'] * 9)}]\n" for n in range(97, 115)
    ),
    "itself": "&a [*a]",
    "digits": "fps: " + "9" * 900_000,
    "many": "a: [" + "1," * 450_000 + "1]",
    "large": "a: " + "x" * 3_000_000,
    "slow": 'a: "\\ud800"\nb: [' + "1," * 450_000 + "1]",
}


@pytest.mark.parametrize("name", BOMBS)
def test_bombs(tmp_path, name):
    (tmp_path / "run.yaml").write_text(BOMBS[name])
    began = time.process_time()
    assert isinstance(read_record(tmp_path / "run.yaml"), dict)
    assert time.process_time() - began < 10.0
