"""Every study: the files of the folder `studies`."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Sequence

from cablesense_paper import studies
from cablesense_paper.paper_error import PaperError
from cablesense_paper.study import Study


def study_names() -> tuple[str, ...]:
    """Names in the order of the alphabet; loads no study."""
    return tuple(sorted(module.name for module in pkgutil.iter_modules(studies.__path__)))


def all_studies() -> tuple[Study, ...]:
    """Every study, in the order of the paper."""
    found = [importlib.import_module(f"{studies.__name__}.{name}").STUDY for name in study_names()]
    return tuple(sorted(found, key=lambda study: (study.order, study.name)))


def chosen_studies(only: Sequence[str]) -> tuple[Study, ...]:
    """Those named, or all where none is, in the order of the paper.

    Raises:
        PaperError: there is no study of that name.
    """
    known = study_names()
    for name in only:
        if name not in known:
            raise PaperError(f"no study {name!r}; there are {', '.join(known)}")
    return tuple(study for study in all_studies() if not only or study.name in only)
