"""The guide on the command line is what `--help` says."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from ml_dash_mcap.cli import main, parser

GUIDE = Path(__file__).resolve().parents[2] / "docs/guides/command-line.md"


def words(text: str) -> str:
    """A text with its blanks and the list of formats cut short: lines break elsewhere from one Python to the next."""
    return re.sub(r"one of [\w., ]+", "one of ...", " ".join(text.split()))


def said(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    with pytest.raises(SystemExit) as stopped:
        main([*arguments, "--help"])
    assert stopped.value.code == 0
    return words(capsys.readouterr().out)


def shown(heading: str) -> str:
    """The help in a section of the guide."""
    section = re.search(rf"^{heading}$(.*?)(?=^#|\Z)", GUIDE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    assert section is not None, heading
    (block,) = re.findall(r"^```text\n(.*?)^```$", section[1], re.MULTILINE | re.DOTALL)
    return words(block)


def test_the_guide_shows_the_list_of_commands(capsys: pytest.CaptureFixture[str]) -> None:
    assert shown("# Command line") == said(capsys)


@pytest.mark.parametrize("command", parser.COMMANDS)
def test_the_guide_shows_the_help_of_a_command(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert shown(f"## {command}") == said(capsys, command)


def test_the_guide_has_no_other_commands() -> None:
    headings = re.findall(r"^## (\w+)$", GUIDE.read_text(encoding="utf-8"), re.MULTILINE)
    assert headings == list(parser.COMMANDS)
