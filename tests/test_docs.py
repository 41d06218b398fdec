"""What the documentation names is there: files, links, and options of the command line."""

import re
from pathlib import Path

import pytest

from spreadlets.cli.main import cli
from spreadlets.files.conventions import PRESETS

ROOT = Path(__file__).resolve().parent.parent
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])


def page_name(path):
    return str(path.relative_to(ROOT))


@pytest.mark.parametrize("page", PAGES, ids=page_name)
def test_links_lead_to_files_of_the_repository(page):
    for link in re.findall(r"\]\(([^)#\s]+)", page.read_text(encoding="utf-8")):
        assert "://" in link or (page.parent / link).exists(), link


@pytest.mark.parametrize("page", PAGES, ids=page_name)
def test_modules_and_folders_that_are_named_exist(page):
    names = r"`((?:spreadlets|runtime|precompute|benchmarks|tests|docs|psf_db)/[a-z0-9_/]*(?:\.(?:py|txt|h5|md))?)`"
    for name in re.findall(names, page.read_text(encoding="utf-8")):
        assert (ROOT / name).exists(), name


@pytest.mark.parametrize("page", PAGES, ids=page_name)
def test_commands_in_examples_know_the_options_they_are_given(page):
    text = page.read_text(encoding="utf-8").replace("\\\n", " ").replace("spreadlets send ", "spreadlets ")
    for name, rest in re.findall(r"^    spreadlets (\w+)(.*)$", text, re.MULTILINE):
        known = {option for parameter in cli.commands[name].params for option in parameter.opts}
        assert set(re.findall(r"\s(--?[a-z][\w-]*)", rest.split("  #")[0])) <= known, (name, rest)


def test_the_table_of_presets_has_a_row_for_each():
    guide = (ROOT / "docs" / "guide.md").read_text()
    rows = guide.split("| preset | depth | motion |")[1].split("\n\n")[0]
    assert sorted(re.findall(r"^\| `(\w+)` \|", rows, re.MULTILINE)) == sorted(PRESETS)
