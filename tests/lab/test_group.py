"""`dlgmd lab` without its extra."""

from dlgmd_cli.lab import commands


def test_without_the_extra_one_line_says_what_to_install(dlgmd, monkeypatch):
    def load(name):
        raise ModuleNotFoundError("No module named 'mujoco'", name="mujoco")

    monkeypatch.setattr(commands, "import_module", load)
    result = dlgmd("lab", "fly")
    assert result.exit_code == 1 and result.stderr.count("\n") == 1
    assert "'mujoco' is not installed. Install it with: pip install 'dlgmd[lab]'." in result.stderr
