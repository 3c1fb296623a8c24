"""The table of a sensor check: bounds above, figures below, what is wrong in red."""

import numpy as np
from rich.console import Console
from sensor_series import EXPECTED, good_tensions_n, series

from cablesense_cli.sensors import check_table
from cablesense_online.commissioning.sensor_check import check_sensors
from cablesense_online.commissioning.tables import Pull, TimeWindow


def shown(tensions_n, pulls=()):
    console = Console(width=120, record=True, force_terminal=True, quiet=False)
    with console.capture() as captured:
        console.print(check_table(check_sensors(series(tensions_n), EXPECTED, pulls), EXPECTED))
    return captured.get()


def row(text, cable):
    return next(line for line in text.splitlines() if f"{cable} " in line)


def test_what_is_right_stands_above_and_only_what_is_wrong_is_red():
    tensions_n = good_tensions_n()
    tensions_n[:, 4] += np.random.default_rng(0).normal(0.0, 1.0, len(tensions_n))
    text = shown(tensions_n)
    assert f"≤ {EXPECTED.noise_n:.3f}" in text
    assert "\x1b[31m" in row(text, "cable_5")
    assert "\x1b[31m" not in row(text, "cable_6")
    assert "pulled" not in text


def test_pulls_have_a_column_of_their_own():
    tensions_n = good_tensions_n()
    tensions_n[400:600, 6] += 25.0
    text = shown(tensions_n, [Pull("cable_7", TimeWindow(3.5, 6.5))])
    assert "cable_7, right" in row(text, "cable_7")
