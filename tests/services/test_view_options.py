"""What ``zsight view`` refuses, and what it says where an extra is missing."""

from __future__ import annotations

import sys

import pytest

from zsight import cli


class Ended:
    """How the command ended: exit code and what it said."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], *options: str) -> None:
        monkeypatch.setattr("sys.argv", ["zsight", "view", *options])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        self.code, self.words = ended.value.code, capsys.readouterr().err


@pytest.mark.parametrize("name", ["foxglove", "rerun"])
def test_without_the_extra_the_command_names_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.delitem(sys.modules, f"zsight.bridge.{name}_sink", raising=False)
    ended = Ended(monkeypatch, capsys, f"--{name}")
    assert ended.code == 2
    assert f"pip install 'zsight[{name}]'" in ended.words


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--foxglove", "--rerun"], "two viewers"),
        (["--foxglove", "--folder", "x"], "--folder means nothing"),
        (["--foxglove", "--open"], "--open means nothing"),
        (["--to", "x.rrd"], "--to needs --rerun"),
        (["--rerun", "--port", "9"], "--port means nothing"),
    ],
)
def test_options_of_another_viewer_are_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], options: list[str], words: str
) -> None:
    ended = Ended(monkeypatch, capsys, *options)
    assert ended.code == 2
    assert words in ended.words
