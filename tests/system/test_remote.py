"""Videos and results behind URLs: on this disk through fsspec, and in a real S3 store."""

import csv
import json
import os
import secrets
import tempfile
from pathlib import Path

import pytest
import yaml

from dlgmd_cli.batch import remote_place
from dlgmd_cli.batch.events import Ended
from dlgmd_cli.batch.find import find_videos, is_video
from dlgmd_cli.batch.local import LocalPool
from dlgmd_cli.batch.names import result_names
from dlgmd_cli.batch.places import Folder
from dlgmd_cli.batch.remote import at_hand, find_remote, is_url, reason, tidy_scratch
from dlgmd_cli.batch.remote_place import Bucket, place_at
from dlgmd_cli.batch.task import Order, Task, Variant, Video
from dlgmd_cli.errors import OutputError, OutputExistsError, ParameterError, SourceError
from dlgmd_cli.parameters import load_set
from tests.saboteurs import Sabotaged

pytest.importorskip("fsspec", reason="fsspec is not installed")
RESULT = ["attenuation.csv", "mp.csv", "run.yaml", "spikes.csv"]


@pytest.fixture
def scratch(tmp_path, monkeypatch):
    """The folder of temporary files, in which nothing may be left."""
    folder = tmp_path / "scratch"
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    yield folder
    assert list(folder.iterdir()) == []


class Store:
    """A folder behind a URL; files by their names."""

    def __init__(self, url, put, names, delete):
        self.url, self.put, self.names, self.delete = url, put, names, delete


def on_disk(tmp_path):
    root = tmp_path / "store"
    root.mkdir()

    def put(name, data):
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_bytes(data)

    def names():
        return sorted(path.relative_to(root).as_posix() for path in root.rglob("*.*"))

    return Store(f"local://{root}", put, names, lambda name: (root / name).unlink())


def in_s3(monkeypatch):
    pytest.importorskip("s3fs", reason="s3fs is not installed")
    server_module = pytest.importorskip("moto.server", reason="moto is not installed")
    import boto3

    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        monkeypatch.setenv(name, "x")
    monkeypatch.setenv("AWS_DEFAULT_REGION", "us-east-1")
    server = server_module.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    url = "http://{}:{}".format(*server.get_host_and_port())
    monkeypatch.setenv("AWS_ENDPOINT_URL", url)
    client = boto3.client("s3", endpoint_url=url)
    bucket = f"bucket-{secrets.token_hex(4)}"  # servers of one process share what they hold
    client.create_bucket(Bucket=bucket)

    def names():
        return sorted(
            one["Key"] for one in client.list_objects_v2(Bucket=bucket).get("Contents", [])
        )

    store = Store(
        f"s3://{bucket}",
        lambda name, data: client.put_object(Bucket=bucket, Key=name, Body=data),
        names,
        lambda name: client.delete_object(Bucket=bucket, Key=name),
    )
    return store, server


@pytest.fixture(params=["disk", "s3"])
def store(request, tmp_path, monkeypatch):
    """An empty store of either kind."""
    if request.param == "disk":
        yield on_disk(tmp_path)
        return
    import fsspec

    made, server = in_s3(monkeypatch)
    fsspec.filesystem("s3").clear_instance_cache()  # whose connections are to an earlier server
    yield made
    server.stop()


def test_a_batch_from_urls_to_urls(dlgmd, store, clips, scratch, tmp_path):
    data = (clips / "loom.avi").read_bytes()
    for name in ("a.avi", "sub/b.avi", ".hidden/c.avi", "notes.txt", "sub/broken.mp4"):
        store.put(f"in/{name}", b"no video" if "broken" in name else data)
    out = f"{store.url}/out"
    options = (f"{store.url}/in", "--no-plots", "--jobs", "2", "--out", out)
    result = dlgmd("batch", *options)
    assert result.exit_code == 1 and f"1 of 3 videos failed, 2 are in {out}. " in result.stderr
    assert result.stdout.splitlines()[-1] == f"{out}/summary.csv"
    expected = [
        *(f"out/a/{name}" for name in RESULT),
        *(f"out/sub/b/{name}" for name in RESULT),
        "out/summary.csv",
    ]
    assert [name for name in store.names() if name.startswith("out")] == sorted(expected)
    assert json.loads(dlgmd("batch", *options, "--json").stdout)["already_done"] == 2
    store.delete("out/a/run.yaml")  # as of a result that was half uploaded
    assert json.loads(dlgmd("batch", *options, "--json").stdout)["already_done"] == 1
    assert [name for name in store.names() if name.startswith("out")] == sorted(expected)
    store.put("in/a.avi", data[:3000])
    changed = json.loads(dlgmd("batch", *options, "--json").stdout)
    assert changed["already_done"] == 1 and changed["status"] == {"done": 1, "failed": 2}
    refused = dlgmd("batch", *options, "--set", "3")
    assert refused.exit_code == 2
    assert f"{out}/a: a result of other settings stands here" in refused.stderr
    store.delete("in/sub/broken.mp4")
    store.put("in/a.avi", data)
    local = dlgmd("batch", f"{store.url}/in", "--no-plots", "--out", "here")
    assert local.exit_code == 0
    dlgmd("batch", *options)
    with (tmp_path / "here/summary.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [(row["video"], row["status"], row["frames"]) for row in rows] == [
        ("a.avi", "done", "20"),
        ("sub/b.avi", "done", "20"),
    ]
    record = yaml.safe_load((tmp_path / "here/sub/b/run.yaml").read_text(encoding="utf-8"))
    assert record["input"]["path"].endswith("/in/sub/b.avi") and is_url(record["input"]["path"])


def test_a_result_is_replaced_run_yaml_first_and_last(store, scratch, monkeypatch):
    place = place_at(f"{store.url}/out")
    files = {"run.yaml": "a: 1\n", "mp.csv": "x\n", "mp.svg": "<svg/>"}

    def write(folder):
        for name, text in files.items():
            (folder / name).write_text(text)

    place.save("v", write)
    store.put("out/v/compare.csv", b"of another command")
    assert store.names() == [
        f"out/v/{name}" for name in ("compare.csv", "mp.csv", "mp.svg", "run.yaml")
    ]
    del files["mp.svg"]
    order, put = [], remote_place._put

    def watched(system, data, path):
        order.append((Path(path).name, "out/v/run.yaml" in store.names()))
        put(system, data, path)

    monkeypatch.setattr(remote_place, "_put", watched)
    place.save("v", write)
    assert order == [("mp.csv", False), ("run.yaml", False)]
    assert store.names() == [f"out/v/{name}" for name in ("compare.csv", "mp.csv", "run.yaml")]

    def broken(system, data, path):
        if path.endswith("run.yaml"):
            raise ConnectionError("the line is dead")
        put(system, data, path)

    monkeypatch.setattr(remote_place, "_put", broken)
    with pytest.raises(OutputError, match=r"out/v: it cannot be written \(the line is dead\)"):
        place.save("v", write)
    ((_, standing),) = place.standing(["v", "w"])
    assert standing.record == {} and "mp.csv" in standing.files
    place.check("v")


def test_files_of_others_stay(store):
    store.put("out/v/thesis.doc", b"mine")
    place = place_at(f"{store.url}/out")
    with pytest.raises(OutputExistsError, match=r"other files, such as thesis\.doc"):
        place.check("v")
    place.check("w")
    place.prepare()
    assert store.names() == ["out/v/thesis.doc"]


def test_what_a_killed_process_copied_goes(store, clips, scratch):
    store.put("a.avi", (clips / "loom.avi").read_bytes())
    with at_hand(f"{store.url}/a.avi") as path:
        assert Path(path).read_bytes() == (clips / "loom.avi").read_bytes()
        assert Path(path).suffix == ".avi" and scratch in Path(path).parents
        tidy_scratch()
        assert Path(path).exists()  # it is in use
    with pytest.raises(SourceError, match="it cannot be copied here"), at_hand(f"{store.url}/no"):
        pass


def test_a_child_that_is_killed_leaves_no_copy(clips, tmp_path, scratch):
    place = Folder.named(str(tmp_path / "out"))
    order = Order((Variant("set9", load_set(9), "auto", place),), Sabotaged(decoder="kills"), ())
    task = Task(Video("a.avi", f"local://{clips / 'loom.avi'}", "a"), (0,))
    with LocalPool(order, 1) as pool:
        (ended,) = (one for one in pool.work_on([task]) if isinstance(one, Ended))
    assert ended.outcome[0].status == "killed"


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["nope://b/x"], 2, "nope://b/x: there is no kind of URL called nope://. Check the URL."),
        ([".", "--out", "nope://b"], 2, "nope://b: there is no kind of URL called nope://."),
        (["memory://b/x"], 2, "memory:// is of one process alone. Choose another place."),
        ([".", "--out", "memory://b"], 2, "memory:// is of one process alone."),
        ([".", "--out", "s3://"], 2, "s3://: "),
        (["local:///nowhere/x"], 1, "local:///nowhere/x: there is nothing. Check the URL."),
    ],
)
def test_urls_that_lead_nowhere(dlgmd, clips, tmp_path, arguments, code, message):
    (tmp_path / "a.avi").write_bytes((clips / "loom.avi").read_bytes())
    if "s3://" in arguments:
        pytest.importorskip("s3fs", reason="s3fs is not installed")
    result = dlgmd("batch", *arguments)
    assert result.exit_code == code and message in result.stderr.splitlines()[-1]


def test_s3_that_fails(dlgmd, monkeypatch, clips, tmp_path):
    (tmp_path / "a.avi").write_bytes((clips / "loom.avi").read_bytes())
    made, server = in_s3(monkeypatch)
    import fsspec

    try:
        fsspec.filesystem("s3").clear_instance_cache()
        for arguments, why in (
            (["s3://nobucket/x"], "s3://nobucket/x: it cannot be read (The specified bucket does"),
            ([".", "--out", "s3://nobucket/x"], "s3://nobucket/x: it cannot be written (The spec"),
            ([f"{made.url}/x"], f"{made.url}/x: there is nothing. Check the URL."),
        ):
            result = dlgmd("batch", *arguments)
            assert result.exit_code == 1 and result.stderr.startswith(f"Error: {why}")
            assert result.stderr.count("\n") == 1
        for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
            monkeypatch.delenv(name)
        monkeypatch.setenv("AWS_EC2_METADATA_DISABLED", "true")
        monkeypatch.setenv("AWS_SHARED_CREDENTIALS_FILE", os.devnull)
        fsspec.filesystem("s3").clear_instance_cache()
        result = dlgmd("batch", f"{made.url}/x")
        assert (result.exit_code, result.stderr) == (
            1,
            f"Error: {made.url}/x: it cannot be read (Unable to locate credentials). "
            "Check the URL.\n",
        )
    finally:
        server.stop()


def test_s3_keys_do_not_lead_out(monkeypatch):
    made, server = in_s3(monkeypatch)
    import fsspec

    try:
        fsspec.filesystem("s3").clear_instance_cache()
        keys = ("../../evil.mp4", "..\\evil.mp4", "/a.mp4", "a.mp4", "b//c.mp4", "b/c.mp4", "d/")
        for key in keys:
            made.put(f"in/{key}", b"x")
        made.put("in2/other.mp4", b"x")
        found = find_videos([("", f"{made.url}/in")]).videos
    finally:
        server.stop()
    assert {video.name: video.result for video in found} == {
        "/a.mp4": "video/a",
        "a.mp4": "a",
        "b//c.mp4": "b/video/c",
        "b/c.mp4": "b/c",
    }
    assert all(video.path == f"{made.url}/in/{video.name}" for video in found)
    assert all(video.identity["version"] and video.identity["bytes"] == 1 for video in found)


def test_names_that_meet_are_told_apart():
    names = result_names(["a\\b/x.avi", "a_b/x.avi", "a_b/x.mp4", "/y.avi", "video/y.avi"])
    assert len(set(names.values())) == 5
    assert not any(".." in one or one.startswith("/") or "//" in one for one in names.values())


def test_without_a_version_nothing_is_known_to_be_the_same(monkeypatch):
    class Bare:
        def find(self, base, detail):
            return {"b/a.avi": {"size": 3}, "b/c.avi": {"size": 4}}

        def info(self, path):
            if path == "b/c.avi":
                raise OSError("gone")
            return {"size": 3}

        def unstrip_protocol(self, path):
            return f"x://{path}"

    monkeypatch.setattr("dlgmd_cli.batch.remote.file_system", lambda url: (Bare(), "b"))
    assert [one for _, _, one in find_remote("x://b", is_video)] == [{}, {}]
    monkeypatch.setattr(Bare, "info", lambda self, path: {"size": 3, "ETag": '"1"'})
    assert next(iter(find_remote("x://b", is_video))) == (
        "a.avi",
        "x://b/a.avi",
        {"bytes": 3, "version": '"1"'},
    )


@pytest.mark.parametrize(
    ("text", "expected"),
    [("s3://b/x", True), ("C://x", False), ("a.avi", False), ("a/b://c", False), ("1x://b", False)],
)
def test_what_is_a_url(text, expected):
    assert is_url(text) == expected


def test_places(tmp_path):
    assert place_at(f"file://{tmp_path}/x") == Folder.named(f"{tmp_path}/x")
    assert place_at("x").within("y").show("z") == "x/y/z"
    assert place_at(f"local://{tmp_path}/x/") == Bucket(f"local://{tmp_path}/x")
    with pytest.raises(ParameterError, match="it names no folder"):
        place_at("local:///")


def test_reasons_are_one_line():
    assert reason(OSError(28, "No space left")) == "No space left"
    assert reason(FileNotFoundError("bucket/x")) == "there is no such file"
    assert reason(ValueError("a\n  b.")) == "a b"
    assert reason(ValueError()) == "ValueError"
