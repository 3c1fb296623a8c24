"""Puts into the site what its pages link to outside docs/: README, CONTRIBUTING, results, sources.

In the repository a page under docs/ reaches them by `../`, and they reach docs/ by its name. The
site has docs/ as its root, and the other files under their own paths.
"""

import posixpath
import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parents[1]
FIRST = "README.md"
LINK = re.compile(r"(?<=\]\()(?!\w+:|#)[^)\s#]+")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the README and, page by page, every file of the repository that is linked to."""
    _add(FIRST, files, config)
    todo = list(files.documentation_pages())
    while todo:
        page = todo.pop()
        source = _source(page.src_uri)
        for link in LINK.findall((ROOT / source).read_text(encoding="utf-8")):
            uri = _uri(posixpath.normpath(posixpath.join(posixpath.dirname(source), link)))
            if files.get_file_from_path(uri) is None and (ROOT / _source(uri)).is_file():
                added = _add(uri, files, config)
                todo += [added] * added.is_documentation_page()
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turn the links of the repository into those of the site."""
    source = _source(page.file.src_uri)
    folder = posixpath.dirname(page.file.src_uri)

    def of_site(link: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join(posixpath.dirname(source), link[0]))
        return posixpath.relpath(_uri(target), folder)

    return LINK.sub(of_site, markdown)


def _uri(source: str) -> str:
    """Place in the site of a file of the repository."""
    return source.removeprefix("docs/")


def _source(uri: str) -> str:
    """The file of the repository, from its root, that has this place in the site."""
    return f"docs/{uri}" if (ROOT / "docs" / uri).is_file() else uri


def _add(uri: str, files: Files, config: MkDocsConfig) -> File:
    added = File.generated(config, uri, abs_src_path=str(ROOT / uri))
    files.append(added)
    return added
