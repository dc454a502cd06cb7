"""Videos and results behind URLs, in a real S3 store."""

import csv
import json
import os
import secrets
import tempfile
from pathlib import Path

import pytest
import yaml

from dlgmd_cli.errors import OutputError, OutputExistsError, ParameterError, SourceError
from dlgmd_cli.results import store
from dlgmd_cli.results.files import names_of
from dlgmd_cli.tasks.batch.find import find_videos, local_copy

pytestmark = pytest.mark.slow
pytest.importorskip("s3fs", reason="s3fs is not installed")
moto = pytest.importorskip("moto.server", reason="moto is not installed")
RESULT = sorted(names_of(store.RUN, ()))


class Bucket:
    """An empty bucket; files by their names."""

    def __init__(self, url):
        import boto3

        self._client = boto3.client("s3", endpoint_url=url)
        self._name = f"bucket-{secrets.token_hex(4)}"  # servers of one process share what they hold
        self._client.create_bucket(Bucket=self._name)
        self.url = f"s3://{self._name}"

    def put(self, name, data):
        self._client.put_object(Bucket=self._name, Key=name, Body=data)

    def delete(self, name):
        self._client.delete_object(Bucket=self._name, Key=name)

    def names(self, beginning=""):
        found = self._client.list_objects_v2(Bucket=self._name, Prefix=beginning)
        return sorted(one["Key"] for one in found.get("Contents", []))


@pytest.fixture
def bucket(monkeypatch):
    import fsspec

    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        monkeypatch.setenv(name, "x")
    monkeypatch.setenv("AWS_DEFAULT_REGION", "us-east-1")
    server = moto.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    url = "http://{}:{}".format(*server.get_host_and_port())
    monkeypatch.setenv("AWS_ENDPOINT_URL", url)
    fsspec.filesystem("s3").clear_instance_cache()  # whose connections are to an earlier server
    yield Bucket(url)
    server.stop()


@pytest.fixture
def scratch(tmp_path, monkeypatch):
    """The folder of temporary files, in which nothing may be left."""
    folder = tmp_path / "scratch"
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    yield folder
    assert list(folder.iterdir()) == []


def test_a_batch_from_urls_to_urls(dlgmd, runs, bucket, clips, scratch, tmp_path):
    data = (clips / "loom.avi").read_bytes()
    for name in ("a.avi", "sub/b.avi", ".hidden/c.avi", "notes.txt", "sub/broken.mp4"):
        bucket.put(f"in/{name}", b"no video" if "broken" in name else data)
    out = f"{bucket.url}/out"
    options = (f"{bucket.url}/in", "--format=none", "--jobs", "1", "--out", out)

    def counts():
        return json.loads(dlgmd("batch", *options, "--json").stdout)

    result = dlgmd("batch", *options)
    assert result.exit_code == 1
    assert f"1 of 3 videos failed; the other 2 results are in {out}. " in result.stderr
    assert result.stdout.splitlines()[-2] == f"{out}/summary.csv"
    expected = [
        *(f"out/a/{name}" for name in RESULT),
        *(f"out/sub/b/{name}" for name in RESULT),
        "out/summary.csv",
    ]
    assert bucket.names("out") == expected
    assert counts()["already_done"] == 2
    bucket.delete("out/a/run.yaml")  # as of a result that was half uploaded
    assert counts()["already_done"] == 1 and bucket.names("out") == expected
    bucket.put("in/a.avi", data[:3000])
    changed = counts()
    assert changed["already_done"] == 1 and changed["status"] == {"done": 1, "failed": 2}
    refused = dlgmd("batch", *options, "--set", "3")
    assert refused.exit_code == 2
    assert f"{out}/a: the result there has other settings (" in refused.stderr
    bucket.delete("in/sub/broken.mp4")
    bucket.put("in/a.avi", data)
    models = ("--set", "3", "--set", "9", "--format=none", "--out", "here")
    runs("batch", f"{bucket.url}/in", *models)
    with (tmp_path / "here/set9/summary.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [(row["video"], row["status"], row["frames"]) for row in rows] == [
        ("a.avi", "done", "20"),
        ("sub/b.avi", "done", "20"),
    ]
    record = yaml.safe_load((tmp_path / "here/set9/sub/b/run.yaml").read_text(encoding="utf-8"))
    assert record["input"]["path"] == f"{bucket.url}/in/sub/b.avi"


def test_a_result_is_replaced_run_yaml_first_and_last(bucket, scratch, monkeypatch):
    place = store.place(f"{bucket.url}/out/v")
    written = {"run.yaml": "a: 1\n", "mp.csv": "x\n", "mp.svg": "<svg/>"}
    files = {name: lambda path, text=text: path.write_text(text) for name, text in written.items()}
    store.ClaimedFolder(place, store.RUN).commit(files)
    bucket.put("out/v/compare.csv", b"of another command")
    old = ("compare.csv", "mp.csv", "mp.svg", "run.yaml")
    assert bucket.names() == [f"out/v/{name}" for name in old]
    del files["mp.svg"]
    order, put_file = [], place.fs.put_file

    def watched(local, remote):
        order.append((remote.rpartition("/")[2], "out/v/run.yaml" in bucket.names()))
        put_file(local, remote)

    monkeypatch.setattr(place.fs, "put_file", watched)
    store.ClaimedFolder(place, store.RUN).commit(files)
    assert order == [("mp.csv", False), ("run.yaml", False)]
    assert bucket.names() == [f"out/v/{name}" for name in ("compare.csv", "mp.csv", "run.yaml")]

    def broken(local, remote):
        if remote.endswith("run.yaml"):
            raise ConnectionError("the line is dead")
        put_file(local, remote)

    monkeypatch.setattr(place.fs, "put_file", broken)
    with pytest.raises(OutputError, match=r"out/v: cannot be written \(the line is dead\)"):
        store.ClaimedFolder(place, store.RUN).commit(files)
    assert bucket.names() == ["out/v/compare.csv", "out/v/mp.csv"]
    assert store.check_place(place, store.RUN, {}, overwrite=False) is False


def test_files_of_others_stay(bucket):
    bucket.put("out/v/thesis.doc", b"mine")
    place = store.place(f"{bucket.url}/out")
    with pytest.raises(OutputExistsError, match=r"other files, such as thesis\.doc"):
        store.check_place(place / "v", store.RUN, {}, overwrite=True)
    assert store.check_place(place / "w", store.RUN, {}, overwrite=False) is False


def test_copies_go(bucket, clips, scratch):
    data = (clips / "loom.avi").read_bytes()
    bucket.put("a.avi", data)
    with local_copy(f"{bucket.url}/a.avi") as path:
        assert Path(path).read_bytes() == data
        assert Path(path).suffix == ".avi" and scratch in Path(path).parents
    missing = pytest.raises(SourceError, match="cannot be copied to this machine")
    with missing, local_copy(f"{bucket.url}/no"):
        pass


def test_what_fails_is_one_line(dlgmd, bucket, monkeypatch, clips, tmp_path):
    import fsspec

    (tmp_path / "a.avi").write_bytes((clips / "loom.avi").read_bytes())
    for arguments, why in (
        (["s3://nobucket/x"], "s3://nobucket/x: cannot be read (The specified bucket does"),
        ([".", "--out", "s3://nobucket/x"], "s3://nobucket/x/summary.csv: cannot be written ("),
        ([f"{bucket.url}/x"], f"{bucket.url}/x: nothing was found there. Check the URL."),
    ):
        result = dlgmd("batch", *arguments)
        assert result.exit_code == 1 and result.stderr.startswith(f"Error: {why}")
        assert result.stderr.count("\n") == 1
    with pytest.raises(ParameterError, match="names no folder"):
        store.place("s3://")
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        monkeypatch.delenv(name)
    monkeypatch.setenv("AWS_EC2_METADATA_DISABLED", "true")
    monkeypatch.setenv("AWS_SHARED_CREDENTIALS_FILE", os.devnull)
    fsspec.filesystem("s3").clear_instance_cache()
    result = dlgmd("batch", f"{bucket.url}/x")
    assert result.exit_code == 1 and f"Error: {bucket.url}/x: cannot be read" in result.stderr


def test_keys_do_not_lead_out(bucket):
    keys = ("../../evil.mp4", "..\\evil.mp4", "/a.mp4", "a.mp4", "b//c.mp4", "b/c.mp4", "d/")
    for key in keys:
        bucket.put(f"in/{key}", b"x")
    bucket.put("in2/other.mp4", b"x")
    found = find_videos([f"{bucket.url}/in"])
    assert {video.name: video.folder for video in found.videos} == {
        "/a.mp4": "video/a",
        "a.mp4": "a",
        "b//c.mp4": "b/video/c",
        "b/c.mp4": "b/c",
    }
    assert all(video.path == f"{bucket.url}/in/{video.name}" for video in found.videos)
    assert all(one.identity["version"] and one.identity["bytes"] == 1 for one in found.videos)
