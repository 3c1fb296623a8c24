"""A study that fails is an outcome, not an end."""

import pytest
from paper_studies import RESULT, ignore, study

from cablesense_paper.study import PaperError, run_study


def raising(error):
    def run(quick, tell):
        raise error

    return study(run)


def test_a_study_hears_the_mode_and_tells_how_far_it_is():
    heard = []

    def run(quick, tell):
        heard.append(quick)
        tell(0.5)
        return RESULT

    told = []
    outcome = run_study(study(run), True, told.append)
    assert (heard, told) == ([True], [0.5])
    assert outcome.result is RESULT
    assert outcome.failure == ""
    assert outcome.seconds >= 0.0


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (PaperError("the cable broke"), "the cable broke"),
        (ModuleNotFoundError("no", name="torch"), "Python package torch"),
        (ZeroDivisionError("by zero"), "ZeroDivisionError: by zero"),
    ],
)
def test_whatever_a_study_raises_is_told(error, words):
    outcome = run_study(raising(error), False, ignore)
    assert outcome.result is None
    assert words in outcome.failure


def test_ctrl_c_is_not_a_finding():
    with pytest.raises(KeyboardInterrupt):
        run_study(raising(KeyboardInterrupt()), False, ignore)
