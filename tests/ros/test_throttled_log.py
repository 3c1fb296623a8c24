"""A flood of warnings becomes one a second of each kind."""

from cablesense_ros.node_process import ThrottledLog


def test_one_a_second_of_each_kind_with_the_count_of_the_others():
    lines, clock = [], [0.0]
    log = ThrottledLog(lines.append, lambda: clock[0])
    for k in range(25):
        clock[0] = 0.1 * k
        log("nan", "a NaN")
        if k == 3:
            log("names", "wrong names")
    assert lines == [
        "a NaN",
        "wrong names",
        "a NaN (9 more like this)",
        "a NaN (9 more like this)",
    ]
