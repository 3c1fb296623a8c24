"""An option that a run would ignore is refused in one line; a default spelled out is harmless."""

import pytest
import typer
from typer.testing import CliRunner

from cablesense_ros.cli.app import app
from cablesense_ros.cli.options import OptionError, refuse_given


@pytest.mark.parametrize(
    ("arguments", "option"),
    [
        ("demo --headless --port 9000", "--port"),
        ("demo --duration 10", "--duration"),
        ("info cdsm_lab --effects", "FILE"),
        ("info cdsm --load-n 3", "--load-n"),
        ("replay run.mcap --force", "--force"),
        ("gap diagnose r.csv --out d --bandwidth 5", "--bandwidth"),
        ("gap diagnose r.csv --out d --model m.xml --arm my_arm", "--arm"),
        ("gap diagnose r.csv --out d --effort current", "--effort"),
        ("gap predict r.csv --out p.csv --model m.xml --settle 9", "--settle"),
        ("evaluate --table2 --seed 1 --workers 2", "--seed, --workers"),
        ("evaluate --recording loads.csv --model cdsm_anywhere --samples 300", "--samples"),
        ("evaluate --picture errors.png", "--picture"),
        ("evaluate --calibration arm.calibration", "--calibration"),
        ("train --data d.parquet --pose straight --force-high-n 9", "--pose, --force-high-n"),
        ("train --pose straight --pose-range-deg 5", "--pose-range-deg"),
        ("dataset --out d.parquet --pose straight --pose-range-deg 5", "--pose-range-deg"),
        ("dataset --out d.parquet --dask-scheduler tcp://a:1 --workers 3", "--workers"),
        ("sensors check run.csv --seconds 20", "--seconds"),
        ("sensors check run.csv --pull all", "--pull"),
        ("sensors calibrate loads.csv --out c.yaml --arm cdsm_lab", "--arm"),
        ("sensors calibrate loads.csv --out c.yaml --topic /t", "--topic"),
        ("sensors check --topic /t", "--topic"),
        ("evaluate --topic /t", "--topic"),
    ],
)
def test_what_would_be_ignored_is_refused_by_name(arguments, option):
    result = CliRunner().invoke(app, arguments.split())
    assert isinstance(result.exception, OptionError), result.output
    assert str(result.exception).startswith(f"{option} ha")
    assert "no effect" in str(result.exception)


def test_a_default_that_is_spelled_out_is_no_reason_to_refuse():
    small = typer.Typer()

    @small.command()
    def run(context: typer.Context, size: int = 3) -> None:
        refuse_given(context, ["size"], "here")

    assert CliRunner().invoke(small, ["--size", "3"]).exit_code == 0
    assert isinstance(CliRunner().invoke(small, ["--size", "4"]).exception, OptionError)
