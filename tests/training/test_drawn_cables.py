"""Stop operators on commanded cable lengths: hysteresis that commands alone decide."""

import numpy as np
import pytest
import torch

from cablesense_training.networks.temporal import GIVES_M, DrawnCables

CABLES, JOINTS, HIDDEN = 3, 2, 5


@pytest.fixture
def drawn():
    return DrawnCables(CABLES, JOINTS, HIDDEN)


def _shares(drawn, past):
    return drawn.seen(past)[0, : CABLES * len(GIVES_M)].reshape(CABLES, len(GIVES_M))


def _through(drawn, past, lengths_m):
    for length in lengths_m:
        row = torch.tensor([[0.0, length, 0.0]])
        past = drawn.follow(past, row, torch.zeros(1, JOINTS))
    return past


def test_shares_follow_what_is_drawn_and_stop(drawn):
    past = _through(drawn, torch.zeros(1, drawn.size), [0.5, 0.5 + 2e-5])
    torch.testing.assert_close(
        _shares(drawn, past)[1], torch.tensor([1.0, 0.1, 0.01]), atol=5e-3, rtol=0.0
    )
    assert (_shares(drawn, past)[[0, 2]] == 0.0).all()


def test_the_first_length_draws_nothing(drawn):
    past = _through(drawn, torch.zeros(1, drawn.size), [0.8])
    assert (_shares(drawn, past) == 0.0).all()


def test_the_way_there_and_back_is_a_loop(drawn):
    way = np.concatenate([np.linspace(0.0, 1e-3, 50), np.linspace(1e-3, 5e-4, 50)])
    there = _shares(drawn, _through(drawn, torch.zeros(1, drawn.size), way[:26]))[1]
    back = _shares(drawn, _through(drawn, torch.zeros(1, drawn.size), way))[1]
    assert there[0] == 1.0
    assert back[0] == -1.0  # at the same length as on the way there


def test_a_tare_is_remembered_beside_what_goes_on(drawn):
    past = drawn.tared(_through(drawn, torch.zeros(1, drawn.size), [0.0, 1e-3]))
    later = _through(drawn, past, [0.0])
    seen = drawn.seen(later)[0]
    count = CABLES * len(GIVES_M)
    assert seen[:count][len(GIVES_M)] == -1.0
    assert seen[count : 2 * count][len(GIVES_M)] == 1.0
    assert len(seen) == drawn.seen_size
