"""Build the site of the documents without any network: ``python docs/site/build.py [FOLDER]``.

The README is its first page, and the lists under the README's "Pages" are its navigation. An error
is: a warning, a link that leads nowhere, or a page that asks for something from elsewhere.
"""

from __future__ import annotations

import re
import shutil
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path[:0] = [str(ROOT), str(HERE)]

import reference  # noqa: E402
from links import faults  # noqa: E402
from signatures import illustrate  # noqa: E402

_TOCTREE = "\n```{{toctree}}\n:hidden:\n:caption: {}\n\n{}\n```\n"


def stage(source: Path) -> None:
    """Write everything that becomes a page to a new folder."""
    unwanted = shutil.ignore_patterns("__pycache__", "site", "*.py")
    shutil.copytree(ROOT / "docs", source / "docs", ignore=unwanted)
    shutil.copytree(ROOT / "examples", source / "examples")
    for page in ROOT.glob("*.md"):
        shutil.copy(page, source)
    readme = (source / "README.md").read_text(encoding="utf-8")
    (source / "README.md").unlink()
    made = reference.pages()
    for name, text in made.items():
        (source / f"{name}.md").write_text(text, encoding="utf-8")
    tree = navigation(readme, {"Reference": ["docs/commands", "docs/python"]})
    (source / "index.md").write_text(readme + tree, encoding="utf-8")
    for page in source.rglob("*.md"):
        text = page.read_text(encoding="utf-8").replace("(../README.md", "(../index.md")
        page.write_text(text, encoding="utf-8")


def navigation(readme: str, made: Mapping[str, Sequence[str]]) -> str:
    """Trees of contents, one for each list of pages that the README has.

    Args:
        readme: its text.
        made: pages that only the site has, by the heading of the list that they follow.
    """
    lists = readme.partition("\n## Pages\n")[2].partition("\n## ")[0].split("\n### ")[1:]
    trees = []
    for text in lists:
        name = text.partition("\n")[0]
        pages = [*re.findall(r"\]\((\S+)\.md\)", text), *made.get(name, ())]
        trees.append(_TOCTREE.format(name, "\n".join(pages)))
    return "".join(trees)


def build(out: Path) -> int:
    """Build into a folder, which is replaced; 1 where anything is wrong."""
    from sphinx.cmd.build import main as sphinx

    if out.exists() and not (out / "objects.inv").is_file():
        raise SystemExit(f"{out} is there and is no site: name another folder")
    with tempfile.TemporaryDirectory() as folder:
        source, made = Path(folder) / "pages", Path(folder) / "site"
        source.mkdir()
        stage(source)
        illustrate(source / "docs" / "effects.md")
        words = ["-q", "-W", "--keep-going", "-c", str(HERE), "-d", f"{folder}/kept"]
        if sphinx([*words, str(source), str(made)]):
            return 1
        if wrong := faults(made):
            print("\n".join(wrong), file=sys.stderr)
            return 1
        if out.exists():
            shutil.rmtree(out)
        shutil.copytree(made, out)
    print(f"written: {(out / 'index.html').resolve().as_uri()}")
    return 0


if __name__ == "__main__":
    sys.exit(build(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "site-out"))
