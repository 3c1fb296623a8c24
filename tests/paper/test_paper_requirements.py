"""A report that cannot be drawn is refused before anything runs."""

import importlib

import pytest

from cablesense_paper.study import DRAWING, require_drawing


def test_what_is_installed_is_enough():
    require_drawing()


@pytest.mark.parametrize("missing", DRAWING)
def test_a_missing_package_is_named(missing, monkeypatch):
    def import_module(name):
        if name == missing:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

    monkeypatch.setattr(importlib, "import_module", import_module)
    with pytest.raises(ModuleNotFoundError) as caught:
        require_drawing()
    assert caught.value.name == missing
