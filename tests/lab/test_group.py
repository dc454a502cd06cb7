"""`dlgmd lab` without its extra."""

from dlgmd_cli.lab import commands


def test_without_the_extra_one_line_says_what_to_install(dlgmd, monkeypatch):
    monkeypatch.setattr(commands, "find_spec", lambda name: None)
    result = dlgmd("lab", "bench", "x.mp4")
    assert result.exit_code == 1 and result.stderr.count("\n") == 1
    hint = "Install it from the clone: pip install '.[lab]'."
    assert f"'mujoco' is not installed. {hint}" in result.stderr
