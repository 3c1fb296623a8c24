"""The ring of tension samples behind the plot."""

import numpy as np

from cablesense_online.page.panel import TraceBuffer


def test_keeps_the_last_window_thinned_evenly():
    buffer = TraceBuffer(3, window_s=2.0, samples=20)
    for tick in range(1000):
        buffer.add(tick * 0.01, np.array([tick, 0.0, -tick], dtype=float))
    times, first, second, third = buffer.columns
    assert len(times) == len(first) == len(second) == len(third) <= 20
    assert times[-1] == 0.0
    assert times[0] >= -2.0
    assert (np.diff(times) > 0.09).all()
    np.testing.assert_array_equal(third, -first)
    assert buffer.peak_n == first.max()


def test_starts_with_a_plot_that_can_be_drawn():
    buffer = TraceBuffer(3)
    assert buffer.peak_n == 0.0
    assert all(len(column) == 2 for column in buffer.columns)


def test_a_clock_that_jumps_back_starts_anew():
    buffer = TraceBuffer(1, window_s=2.0, samples=20)
    buffer.add(100.0, np.array([900.0]))
    buffer.add(1.0, np.array([5.0]))
    buffer.add(2.0, np.array([6.0]))
    np.testing.assert_array_equal(buffer.columns[1], [5.0, 6.0])
    assert buffer.peak_n == 6.0
