"""Makes one site of files that lie in several folders: the links in them are those of the repository."""

from pathlib import Path
from typing import Any

from mkdocs.structure.files import File

ROOT = Path(__file__).resolve().parent.parent
RESULTS = "benchmarks/results"
PROJECT = ("CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md")
"""Pages of the repository's root."""


def on_files(files: Any, config: Any) -> Any:
    """Add the pages of the root, and the results of the benchmarks, to which many pages refer."""
    for name in PROJECT:
        files.append(File.generated(config, name.lower(), abs_src_path=str(ROOT / name)))
    for path in sorted((ROOT / RESULTS).iterdir()):
        if path.suffix in (".txt", ".csv", ".md", ".png"):
            files.append(File.generated(config, f"results/{path.name}", abs_src_path=str(path)))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Let links across the repository's folders lead to the places in the site."""
    markdown = markdown.replace("](docs/", "](").replace(f"](../{RESULTS}/", "](results/")
    for name in PROJECT:
        markdown = markdown.replace(f"](../{name}", f"]({name.lower()}")
    return markdown.replace("](../README.md", "](index.md")
