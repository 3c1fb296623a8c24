"""Pages that need nothing beside them: made from a template in the common style, written whole."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from importlib import resources
from pathlib import Path
from typing import Any

from cablesense_gap.report.report_error import ReportError


def rendered(
    package: str,
    template: str,
    content: Mapping[str, Any],
    filters: Mapping[str, Callable[..., str]],
) -> str:
    """A package's Jinja template as HTML text; `content` and the common style, `css`, go in."""
    from jinja2 import Environment, StrictUndefined

    source = resources.files(package).joinpath(template).read_text(encoding="utf-8")
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters.update(filters)
    return environment.from_string(source).render({"css": page_css(), **content})


def page_css() -> str:
    """The style sheet that all pages share."""
    return resources.files(__package__).joinpath("page.css").read_text(encoding="utf-8")


def write_whole(path: Path, page: str) -> None:
    """Write a page; whole or not at all.

    Raises:
        ReportError: the place cannot be written to.
    """
    beside = path.parent / f".{path.name}.{os.getpid()}.part"
    try:
        beside.write_text(page, encoding="utf-8")
        beside.replace(path)
    except OSError as error:
        raise ReportError(f"{path}: cannot be written ({error.strerror or error})") from error
    finally:
        beside.unlink(missing_ok=True)
