"""Studies are found by their files, in the order of the paper."""

import subprocess
import sys

import pytest

from cablesense_paper.study import PaperError, all_studies, chosen_studies, study_names


def test_every_study_is_named_as_its_file_and_says_where_the_paper_has_it():
    studies = all_studies()
    assert sorted(study.name for study in studies) == list(study_names())
    assert len({study.order for study in studies}) == len(studies)
    for study in studies:
        assert study.title
        assert study.place


def test_studies_come_in_the_order_of_the_paper():
    orders = [study.order for study in all_studies()]
    assert orders == sorted(orders)


def test_those_that_are_named_are_chosen():
    names = study_names()
    assert [study.name for study in chosen_studies(names[:1])] == [names[0]]
    assert chosen_studies(()) == all_studies()


def test_an_unknown_name_is_refused_with_those_there_are():
    with pytest.raises(PaperError, match=r"no study 'fig99'; there are .*displacement"):
        chosen_studies(["displacement", "fig99"])


def test_to_find_the_studies_loads_nothing_heavy():
    code = (
        "import sys; from cablesense_paper.study import all_studies; all_studies();"
        "print(*(m for m in ('rclpy', 'torch', 'mujoco', 'matplotlib', 'onnxruntime', 'jinja2')"
        " if m in sys.modules))"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    assert result.stdout.strip() == ""
