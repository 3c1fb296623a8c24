"""Work that is shared among processes is done as one process does it."""

from __future__ import annotations

import os

import numpy as np
import pytest
from gap_course import Sums, course_of

from cablesense_gap.diagnosis.problem import Course
from cablesense_gap.diagnosis.search import Crew

COURSE = course_of(Sums({}, {}), {})


def sum_and_process(course: Course, times: float) -> tuple[float, int]:
    return times * float(course.readings.sum()), os.getpid()


def fail(course: Course, task: int) -> int:
    if task == 1:
        raise ValueError("the second task fails")
    return task


@pytest.mark.parametrize("workers", [0, 1])
def test_one_worker_is_this_process(workers):
    with Crew(COURSE, workers) as crew:
        done = list(crew.map(sum_and_process, [1.0, 2.0, 3.0]))
    assert {process for _, process in done} == {os.getpid()}
    expected = np.outer([1.0, 2.0, 3.0], COURSE.readings.sum())[:, 0]
    np.testing.assert_allclose([total for total, _ in done], expected)


@pytest.mark.slow  # processes start
def test_several_workers_answer_in_the_order_of_the_tasks():
    tasks = list(np.arange(20.0))
    with Crew(COURSE, 2) as crew:
        shared = list(crew.map(sum_and_process, tasks))
    assert [total for total, _ in shared] == [sum_and_process(COURSE, t)[0] for t in tasks]
    assert os.getpid() not in {process for _, process in shared}


@pytest.mark.slow  # processes start
@pytest.mark.parametrize("workers", [1, 2])
def test_what_goes_wrong_in_a_worker_is_heard(workers):
    with Crew(COURSE, workers) as crew:
        answers = crew.map(fail, range(3))
        assert next(answers) == 0
        with pytest.raises(ValueError, match="the second task"):
            next(answers)
