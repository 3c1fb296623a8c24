"""What a user takes from `cablesense_training`."""

import pytest

import cablesense_training


@pytest.mark.parametrize("name", cablesense_training.__all__)
def test_every_name_is_there(name):
    assert getattr(cablesense_training, name).__doc__
