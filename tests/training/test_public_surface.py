"""What a user takes from `cablesense_training`, without what it does not need."""

import subprocess
import sys

import pytest

import cablesense_training


@pytest.mark.parametrize("name", cablesense_training.__all__)
def test_every_name_is_there(name):
    assert getattr(cablesense_training, name).__doc__


@pytest.mark.slow
def test_an_estimator_needs_no_torch_and_no_parquet():
    program = (
        "import sys; from cablesense_training import Dataset, draw_dataset, find_model, "
        "open_estimator; open_estimator(find_model('cdsm'));"
        "print(*(m for m in ('torch', 'pyarrow', 'sklearn') if m in sys.modules))"
    )
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (result.returncode, result.stdout.strip()) == (0, ""), result.stderr
